//! Untyped ports: what a recorder or a bridge is made of.
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
