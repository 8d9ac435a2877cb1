//! When a scan does not begin, and what is said then.
#![allow(clippy::unwrap_used)]

use trocar_sdk::data::{Distance, OperatingMode, OperatingState, Pose};
use trocar_sdk::testing::Bench;

use crate::rig::{Rig, Setup, ready};
use crate::{BScan, ScanRequest};

#[test]
fn a_scan_does_not_begin_without_robot_surface_or_sense() {
    let mut bench = Bench::<BScan>::new("{}");
    let begin = |bench: &mut Bench<BScan>, request| {
        bench.command::<ScanRequest, ()>("scan/start", request).err().map(|e| e.reason).unwrap_or_default()
    };
    bench.step(1);
    assert!(begin(&mut bench, Rig::request()).contains("the robot does not tell where it is"));
    let stand = |bench: &mut Bench<BScan>, velocity: f64, valid: bool| {
        let stamp = bench.now();
        bench.answer("robot/measured_cp", move |()| Ok(Pose { stamp, ..Pose::default() }));
        bench.answer("robot/operating_state", move |()| Ok(ready()));
        bench.push(
            "distance",
            Distance { stamp, distance: 0.5e-3, velocity, valid: valid.into(), ..Distance::default() },
        );
        bench.step(1);
    };
    stand(&mut bench, 0.0, false);
    assert!(begin(&mut bench, Rig::request()).contains("there is no surface"));
    stand(&mut bench, f64::NAN, true);
    assert!(begin(&mut bench, Rig::request()).contains("the tracker does not know the robot"));
    stand(&mut bench, 0.0, true);
    let stamp = bench.now();
    bench.push(
        "distance",
        Distance { stamp, distance: 0.12e-3, velocity: 0.0, valid: true.into(), ..Distance::default() },
    );
    bench.step(1);
    assert!(begin(&mut bench, Rig::request()).starts_with("the tip is 120 um from the surface"));
    stand(&mut bench, 0.0, true);
    let fast = ScanRequest { speed: 1.0, ..Rig::request() };
    assert_eq!(begin(&mut bench, fast), "speed: 1 is not from 0.000001 to 0.005 (SI units)");
    assert_eq!(begin(&mut bench, Rig::request()), "");
    assert!(begin(&mut bench, Rig::request()).contains("a scan is running"));
    bench.command::<(), ()>("scan/abort", ()).unwrap();
    for not in [
        OperatingState { state: OperatingMode::PAUSED, ..ready() },
        OperatingState { state: OperatingMode::FAULT, ..ready() },
        OperatingState { is_homed: false.into(), ..ready() },
    ] {
        bench.answer("robot/operating_state", move |()| Ok(not));
        bench.step(1);
        assert!(begin(&mut bench, Rig::request()).contains("the robot takes no motion"), "{not:?}");
    }
}

#[test]
fn above_twelve_milliseconds_of_delay_the_loop_is_not_closed() {
    let mut rig = Rig::new(Setup { latency_ns: 12_500_000, ..Setup::new("default", 1) });
    rig.steps(200);
    let refused = rig.bench.command::<ScanRequest, ()>("scan/start", Rig::request()).unwrap_err().reason;
    assert!(refused.starts_with("the loop's delay is 1") && refused.contains("above 12 ms"), "{refused}");
}
