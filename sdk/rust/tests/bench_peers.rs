//! The bench as the world around a component: untyped peers, limits of arguments, callbacks of a device, log
//! lines.
#![allow(clippy::unwrap_used)]

use trocar_plugin_api::abi::STATUS_INVALID;
use trocar_sdk::HeldFrame;
use trocar_sdk::data::{ImageHeader, Pose, Scalar};
use trocar_sdk::prelude::*;
use trocar_sdk::serde_json::json;
use trocar_sdk::testing::Bench;

/// Passes on its inputs, and calls the peer it is connected to.
#[derive(Component)]
#[component(rate_hz = 100, provides("ctl"))]
struct Bridge {
    #[input(fifo = 4)]
    from: AnyIn,
    #[output]
    to: AnyOut,
    #[required(optional)]
    ask: AnyFunction,
    #[state]
    answer: f64,
    #[state]
    sources: u64,
    source: u64,
    last: Option<Outcome>,
}

#[provides("ctl")]
impl Bridge {
    #[command]
    fn last(&mut self) -> Text<32> {
        Text::new(&format!("{:?}", self.last))
    }
    #[command]
    fn write_eight(&mut self) {
        self.last = Some(self.to.write_bytes(&[0; 8], Stamp::INVALID));
    }
    #[command]
    fn types(&mut self) -> Text<64> {
        let text =
            |json: Option<String>| json.map_or("none".to_string(), |json| json.len().min(1).to_string());
        let ask = self.ask.command().map_or("none".to_string(), |c| format!("{} {}", c.kind, c.arg_size()));
        Text::new(&format!("{} {} {ask}", text(self.from.type_json()), text(self.to.type_json())))
    }
}

impl Component for Bridge {
    fn step(&mut self, _: &Tick) -> Result {
        while let Some(sample) = self.from.next() {
            if sample.source() != self.source {
                (self.source, self.sources) = (sample.source(), self.sources + 1);
            }
            self.last = Some(self.to.forward(&sample));
        }
        if let Ok(answer) = self.ask.call_json(&json!(2.0)) {
            self.answer = answer.as_f64().unwrap_or(f64::NAN);
        }
        Ok(())
    }
}

fn last(bench: &mut Bench<Bridge>) -> String {
    bench.command::<(), Text<32>>("last", ()).unwrap().as_str().to_string()
}

#[test]
fn untyped_ports_are_unconnected_until_a_peer_gives_them_a_type() {
    let mut bench = Bench::<Bridge>::new("{}");
    let types = bench.command::<(), Text<64>>("types", ()).unwrap();
    assert_eq!(types.as_str(), "none none none");
    bench.push("from", 1.5);
    bench.step(1);
    assert_eq!(last(&mut bench), "Some(Unbound)");
    assert!(bench.outputs::<f64>("to").is_empty(), "nobody is there to take it");

    bench.connect_as::<f64>("to");
    bench.connect_as_command::<f64, f64>("ask");
    bench.push("from", 2.5);
    bench.step(1);
    bench.expect_outputs("to", &[2.5]);
    let types = bench.command::<(), Text<64>>("types", ()).unwrap();
    assert_eq!(types.as_str(), "1 1 write_return 8");
    bench.connect_input("from", false);
    bench.connect_output("to", false);
    bench.connect_function("ask", false);
    let types = bench.command::<(), Text<64>>("types", ()).unwrap();
    assert_eq!(types.as_str(), "none none none");
}

#[test]
fn an_untyped_function_calls_the_command_a_test_plays() {
    let mut bench = Bench::<Bridge>::new("{}");
    bench.answer("ask", |x: f64| Ok(x + 40.0));
    bench.step(1);
    assert_eq!(bench.state().answer, 42.0);
    bench.expect_calls("ask", &[2.0]);
}

#[test]
fn a_sample_of_another_type_is_another_peer_and_fits_no_output_of_the_first() {
    let mut bench = Bench::<Bridge>::new("{}");
    bench.connect_as::<f64>("to");
    bench.push("from", 1.0);
    bench.push("from", 2.0);
    bench.step(1);
    bench.push("from", Pose::default());
    bench.step(1);
    assert_eq!((bench.state().sources, last(&mut bench).as_str()), (2, "Some(InvalidArgument)"));
    bench.expect_outputs("to", &[1.0, 2.0]);
    bench.connect_as::<Pose>("to");
    bench.command::<(), ()>("write_eight", ()).unwrap();
    assert_eq!(last(&mut bench), "Some(InvalidArgument)");
}

#[test]
fn frames_pass_untyped_ports_with_header_and_bytes() {
    let mut bench = Bench::<Bridge>::new("{}");
    bench.connect_as_frames::<ImageHeader>("to");
    bench.push_frame("from", ImageHeader { stride: 3, ..ImageHeader::default() }, &[1, 2, 3]);
    bench.step(1);
    let frames = bench.frames::<ImageHeader>("to");
    assert_eq!((frames[0].0.stride, frames[0].1.as_slice()), (3, &[1u8, 2, 3][..]));
}

/// Keeps every other frame, and reads the last it kept in another thread.
#[derive(Component)]
#[component(rate_hz = 100)]
struct Keeper {
    #[input(fifo = 4)]
    from: AnyIn,
    #[state]
    first: f64,
    #[state]
    none: u64,
    kept: Option<HeldFrame>,
}

impl Component for Keeper {
    fn step(&mut self, _: &Tick) -> Result {
        while let Some(sample) = self.from.next() {
            match sample.hold() {
                Some(frame) if sample.seq() % 2 == 1 => self.kept = Some(frame),
                Some(_) => {}
                None => self.none += 1,
            }
        }
        let kept = self.kept.as_ref();
        let first = || kept.and_then(|frame| frame.bytes().first().copied()).map_or(f64::NAN, f64::from);
        self.first = std::thread::scope(|scope| scope.spawn(first).join().unwrap());
        Ok(())
    }
}

#[test]
fn a_frame_that_is_held_outlives_those_that_come_behind_it() {
    let mut bench = Bench::<Keeper>::new("{}");
    for (n, first) in [(1u8, 1.0), (2, 1.0), (3, 3.0), (4, 3.0)] {
        bench.push_frame("from", ImageHeader::default(), &[n, 0, 0]);
        bench.step(1);
        assert_eq!((bench.state().first, bench.state().none), (first, 0));
    }
    bench.push("from", 1.5);
    bench.step(1);
    assert_eq!((bench.state().first, bench.state().none), (3.0, 1), "a plain sample is no frame");
}

#[test]
#[should_panic(expected = "is connected to a peer with the fields")]
fn asking_an_untyped_output_for_another_type_than_its_peers_fails() {
    let mut bench = Bench::<Bridge>::new("{}");
    bench.connect_as::<f64>("to");
    let _ = bench.outputs::<Scalar>("to");
}

#[test]
#[should_panic(expected = "has a type of its own")]
fn a_typed_port_takes_no_other_type() {
    Bench::<Device>::new("{}").connect_as::<f64>("x");
}

/// A device whose library calls back.
#[derive(Component)]
#[component(model = "on_callback", provides("ctl"))]
struct Device {
    #[input(optional)]
    x: In<f64>,
    #[host]
    host: Host,
    #[state]
    set: f64,
}

#[provides("ctl")]
impl Device {
    #[command]
    fn set(&mut self, #[arg(unit = "mm", min = -1, max = 100)] value: f64) {
        self.set = value;
    }
    #[command]
    fn set_all(&mut self, #[arg(max = 9)] values: [u8; 3]) {
        self.set = values.iter().map(|v| f64::from(*v)).sum();
    }
    #[command]
    fn set_some(&mut self, #[arg(min = 0)] values: List<i32, 4>) {
        self.set = values.iter().map(|v| f64::from(*v)).sum();
    }
    #[read]
    fn times(s: &DeviceState, #[arg(max = 10)] factor: u32) -> f64 {
        s.set * f64::from(factor)
    }
    /// Comes in from within, which the device's library must not do.
    #[command]
    fn calls_within(&mut self) {
        let refused = self.host.callback(|| ()).err();
        log::warn!("the sample is lost: {refused:?}");
    }
}

thread_local! {
    /// Host that the library of the device holds on to.
    static LIBRARY: std::cell::RefCell<Option<Host>> = const { std::cell::RefCell::new(None) };
}

/// Plays the device's library when a sample is there. Returns how the callback ended, and how one ended that
/// overlaps with it.
fn device_calls() -> (Result<(), Outcome>, Option<Result<(), Outcome>>) {
    let host = LIBRARY.with_borrow(|host| host.clone().unwrap());
    let mut overlapping = None;
    let outcome = host.callback(|| {
        overlapping = Some(std::thread::scope(|s| s.spawn(|| host.callback(|| ())).join().unwrap()));
    });
    (outcome, overlapping)
}

impl Component for Device {
    fn configure(&mut self) -> Result {
        LIBRARY.set(Some(self.host.clone()));
        Ok(())
    }
    fn step(&mut self, _: &Tick) -> Result {
        let _ = self.x.latest();
        Ok(())
    }
}

#[test]
fn an_argument_beyond_its_limits_never_reaches_the_component() {
    let mut bench = Bench::<Device>::new("{}");
    for (value, told) in [
        (100.5, "value 100.5 is above maximum 100 mm"),
        (-2.0, "value -2 is below minimum -1 mm"),
        (f64::NAN, "value NaN is not a number; the limits are -1 to 100 mm"),
    ] {
        let refused = bench.command::<f64, ()>("set", value).unwrap_err();
        assert_eq!((refused.status, refused.reason.as_str()), (STATUS_INVALID, told));
    }
    assert_eq!(bench.state().set, 0.0);
    bench.command::<f64, ()>("set", 100.0).unwrap();
    let refused = bench.command::<[u8; 3], ()>("set_all", [9, 9, 10]).unwrap_err();
    assert_eq!(refused.reason, "values[2] 10 is above maximum 9");
    let mut some = List::<i32, 4>::default();
    assert!(some.push(3));
    assert!(some.push(-1));
    let refused = bench.command::<_, ()>("set_some", some).unwrap_err();
    assert_eq!(refused.reason, "values[1] -1 is below minimum 0");
    assert_eq!(bench.read::<u32, f64>("times", 10), Ok(1000.0));
    assert!(bench.read::<u32, f64>("times", 11).unwrap_err().reason.contains("above maximum 10"));
}

#[test]
fn callbacks_come_in_one_at_a_time_and_only_while_started() {
    let mut bench = Bench::<Device>::ready("{}");
    assert_eq!(device_calls(), (Err(Outcome::NotActive), None));
    bench.start().unwrap();
    assert_eq!(device_calls(), (Ok(()), Some(Err(Outcome::WouldBlock))));
    bench.refuse_callbacks(Outcome::WouldBlock);
    assert_eq!(device_calls(), (Err(Outcome::WouldBlock), None));
    bench.refuse_callbacks(Outcome::Executed);
    assert_eq!(device_calls(), (Ok(()), Some(Err(Outcome::WouldBlock))));
    assert_eq!(bench.callbacks(), (2, 4));
    bench.stop().unwrap();
    assert_eq!(device_calls(), (Err(Outcome::NotActive), None));
}

#[test]
fn what_a_component_logs_is_there_for_the_test() {
    let mut bench = Bench::<Device>::new("{}");
    bench.command::<(), ()>("calls_within", ()).unwrap();
    bench.expect_log(log::Level::Warn, "the sample is lost: Some(WouldBlock)");
    assert!(bench.logs().is_empty(), "they were taken");
}

#[test]
#[should_panic(expected = "logged was\n  WARN the sample is lost")]
fn a_line_that_did_not_come_is_told_with_those_that_did() {
    let mut bench = Bench::<Device>::new("{}");
    bench.command::<(), ()>("calls_within", ()).unwrap();
    bench.expect_log(log::Level::Error, "lost");
}
