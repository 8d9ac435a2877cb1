//! Panics and errors of an author's code, as the host sees them.
#![allow(clippy::unwrap_used)]
#![forbid(unsafe_code)]

use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

#[derive(Component)]
#[component(rate_hz = 1000, provides("ctl"))]
struct Fragile {
    #[output]
    image: Out<Frame<trocar_sdk::data::ImageHeader>>,
    #[state]
    steps: u32,
    #[config]
    cfg: Cfg,
}

#[derive(Config)]
struct Cfg {
    /// Which step is the first
    #[config(default = 0)]
    first: u32,
}

#[provides("ctl")]
impl Fragile {
    #[command]
    fn fail(&mut self) -> Result {
        let cause = "x".parse::<u32>()?;
        self.steps = cause;
        Ok(())
    }
    #[command]
    fn burst(&mut self) {
        let found = [1, 2].into_iter().find(|n| *n > 2);
        self.steps = found.expect("nothing there");
    }
    #[read]
    fn bad(s: &FragileState) -> u32 {
        1 / s.steps
    }
}

impl Component for Fragile {
    fn start(&mut self) -> Result {
        self.steps = self.cfg.first;
        Ok(())
    }
    fn step(&mut self, _: &Tick) -> Result {
        self.steps += 1;
        match self.steps {
            1 => Ok(()),
            2 => Err(std::io::Error::other("the sensor is silent").into()),
            3 => panic!("boom {}", self.steps),
            _ => {
                self.image.loan()?.commit(0, Stamp::INVALID);
                self.steps = 100;
                Ok(())
            }
        }
    }
}

#[test]
fn an_error_from_step_is_a_sentence() {
    let mut bench = Bench::<Fragile>::new("{}");
    bench.step(1);
    let e = bench.try_step().unwrap_err();
    assert_eq!((e.reason.as_str(), e.panicked()), ("the sensor is silent", false));
}

#[test]
fn a_panic_is_a_status_with_its_place_and_the_component_can_still_be_made_safe() {
    let mut bench = Bench::<Fragile>::new(r#"{"first": 2}"#);
    let e = bench.try_step().unwrap_err();
    assert!(e.panicked(), "{e}");
    let (place, message) = e.reason.rsplit_once(": ").unwrap();
    assert!(place.starts_with("panicked at ") && place.contains("tests/guard.rs:"), "{place}");
    assert_eq!(message, "boom 3");
    bench.make_safe().unwrap();
}

#[test]
fn a_missing_frame_ends_the_cycle_quietly() {
    let mut bench = Bench::<Fragile>::new(r#"{"first": 3}"#);
    bench.step(1);
    assert_eq!(bench.state().steps, 4, "the loan had no frame, so the rest of the step did not run");
}

#[test]
fn a_command_that_fails_with_any_error_says_it() {
    let mut bench = Bench::<Fragile>::new("{}");
    assert_eq!(bench.command::<(), ()>("fail", ()).unwrap_err().reason, "invalid digit found in string");
}

#[test]
fn a_command_or_read_that_panics_is_caught() {
    let mut bench = Bench::<Fragile>::new("{}");
    assert!(bench.command::<(), ()>("burst", ()).unwrap_err().panicked());
    let e = bench.read::<(), u32>("bad", ()).unwrap_err();
    assert!(e.panicked() && e.reason.ends_with("attempt to divide by zero"), "{e}");
}

#[test]
fn panics_of_several_threads_are_not_mixed_up() {
    let threads: Vec<_> = (0..4)
        .map(|_| {
            std::thread::spawn(|| {
                let mut bench = Bench::<Fragile>::new("{}");
                for _ in 0..50 {
                    bench.reset().unwrap();
                    bench.start().unwrap();
                    let burst = bench.command::<(), ()>("burst", ()).unwrap_err().reason;
                    assert!(burst.ends_with("nothing there"), "{burst}");
                    let bad = bench.read::<(), u32>("bad", ()).unwrap_err().reason;
                    assert!(bad.ends_with("divide by zero"), "{bad}");
                }
            })
        })
        .collect();
    for thread in threads {
        thread.join().unwrap();
    }
}
