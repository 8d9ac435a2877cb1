//! Untyped ports: the parts of a recorder or a bridge.
#![allow(clippy::unwrap_used)]
#![forbid(unsafe_code)]

use trocar_plugin_api::desc::PortType;
use trocar_sdk::data::{ImageHeader, Scalar};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

/// Counts what comes and passes it on.
#[derive(Component)]
#[component(model = "stream")]
struct Recorder {
    #[input(fifo = 8)]
    any: In<trocar_sdk::Any>,
    #[output]
    same: AnyOut,
    #[required(optional)]
    command: AnyFunction,
    #[state]
    samples: u64,
    #[state]
    bytes: u64,
}

impl Component for Recorder {
    fn step(&mut self, _: &Tick) -> Result {
        while let Some(sample) = self.any.next() {
            assert!(!sample.value().is_empty() && sample.stamp().is_valid());
            self.samples += 1;
            self.bytes += sample.bytes().len() as u64;
            self.same.forward(&sample);
        }
        Ok(())
    }
}

#[test]
fn an_untyped_input_takes_samples_and_frames_alike() {
    let mut bench = Bench::<Recorder>::new("{}");
    bench.push("any", Scalar::default());
    bench.step(1);
    bench.push_frame("any", ImageHeader::default(), &[1, 2, 3]);
    bench.step(1);
    assert_eq!((bench.state().samples, bench.state().bytes), (2, 3));
}

#[test]
fn untyped_ports_say_any_in_the_manifest() {
    let class = Recorder::DESC;
    assert!(matches!(class.inputs[0].ty, PortType::Any) && matches!(class.outputs[0].ty, PortType::Any));
    let required = &class.required[0];
    assert!(required.functions[0].any && required.functions[0].arg.is_none() && required.optional);
}

#[test]
fn an_unconnected_port_has_no_type_yet() {
    assert_eq!(AnyIn::default().type_json(), None);
    assert_eq!(AnyFunction::default().type_json(), None);
    assert!(AnyOut::default().ty().is_none() && AnyFunction::default().command().is_none());
    assert_eq!(AnyOut::default().write_bytes(&[0; 8], Stamp::INVALID), Outcome::Unbound);
    assert_eq!(AnyFunction::default().send_bytes(&[]), Outcome::Unbound);
    let unbound = AnyFunction::default().call_json(&trocar_sdk::serde_json::Value::Null).unwrap_err();
    assert_eq!(unbound.outcome, Outcome::Unbound);
}

/// Calls what it is connected to with what it is told.
#[derive(Component)]
#[component(model = "on_signal", provides("ctl"))]
struct Caller {
    #[required(interface = "peer", optional)]
    sum: AnyFunction,
    #[state]
    asked: u64,
}

#[provides("ctl")]
impl Caller {
    /// Calls with 2.5, so many bytes off an aligned place, with room for the result.
    #[command]
    fn ask(&mut self, off: u64) -> Result<f64, String> {
        self.ask_for::<8>(off).map(f64::from_ne_bytes)
    }
    /// The same with room for another result.
    #[command]
    fn ask_short(&mut self, off: u64) -> Result<f64, String> {
        self.ask_for::<7>(off).map(|_| 0.0)
    }
}

impl Caller {
    fn ask_for<const N: usize>(&mut self, off: u64) -> Result<[u8; N], String> {
        self.asked += 1;
        let (off, mut bytes) = (off as usize, [0; 40]);
        let (arg, ret) = bytes.split_at_mut(20);
        arg[off..off + 8].copy_from_slice(&2.5_f64.to_ne_bytes());
        let ret = &mut ret[off..off + N];
        self.sum.call_into(&arg[off..off + 8], ret).map_err(|why| why.to_string())?;
        (&*ret).try_into().map_err(|_| "of another length".to_string())
    }
}

impl Component for Caller {}

#[test]
fn an_untyped_function_calls_with_bytes_wherever_they_lie_and_room_of_the_results_size() {
    let mut bench = Bench::<Caller>::new("{}");
    let unbound = bench.command::<u64, f64>("ask", 0).unwrap_err();
    assert!(unbound.reason.contains("no peer is connected"), "{unbound}");
    bench.answer("sum", |value: f64| Ok(value + 1.0));
    for off in 0..8 {
        assert_eq!(bench.command::<u64, f64>("ask", off).unwrap(), 3.5, "{off} bytes off");
        let refused = bench.command::<u64, f64>("ask_short", off).unwrap_err();
        assert!(refused.reason.contains("outside its limits"), "{off} bytes off: {refused}");
    }
    bench.answer("sum", |_: f64| Err::<f64, _>("it is closed".to_string()));
    let refused = bench.command::<u64, f64>("ask", 3).unwrap_err();
    assert!(refused.reason.contains("it is closed"), "{refused}");
}
