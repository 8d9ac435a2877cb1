//! Cases in which a scan does not begin, and the reasons that are given.
#![allow(clippy::unwrap_used)]

use trocar_sdk::data::{Distance, OperatingMode, OperatingState, Pose, Retreat};
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
    assert!(begin(&mut bench, Rig::request()).starts_with("the tip is 120 µm from the surface"));
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
    assert!(refused.starts_with("the measured delay is 1") && refused.contains("above 12 ms"), "{refused}");
}

#[test]
fn an_offset_that_leaves_a_moving_eye_no_room_is_refused_where_the_robot_does_not_go_back_by_itself() {
    let mut rig = Rig::new(Setup::new("default", 1));
    rig.steps(60);
    let start = |rig: &mut Rig, offset: f64| {
        let request = ScanRequest { offset, ..Rig::request() };
        let refused = rig.bench.command::<ScanRequest, ()>("scan/start", request).err();
        rig.step();
        refused.map(|refused| refused.reason).unwrap_or_default()
    };
    rig.retreats(false);
    assert_eq!(
        start(&mut rig, 300e-6),
        "offset: 300 µm leaves no room for an eye that comes up by 350 µm: give 500 µm or more; for less, connect axis to a \
         robot that goes back by itself (set_retreat) when this component dies"
    );
    assert_eq!(start(&mut rig, 500e-6), "");
    rig.bench.command::<(), ()>("scan/abort", ()).unwrap();
    rig.retreats(true);
    rig.bench.configure(r#"{"rows": 8, "range_db": [40, 100], "retract_m": 0.0001}"#).unwrap();
    let refused = start(&mut rig, 300e-6);
    assert!(refused.ends_with("give 400 µm or more; retract_m is too short for less"), "{refused}");
    assert_eq!(rig.retreat(), Retreat::default(), "what is refused leaves nothing behind");
    rig.bench.configure(r#"{"rows": 8, "range_db": [40, 100]}"#).unwrap();
    assert_eq!(start(&mut rig, 300e-6), "");
    assert_eq!(rig.retreat().distance, 0.4e-3);
}
