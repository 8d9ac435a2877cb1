//! Readings of robot and tracker with times that cannot be.
#![allow(clippy::unwrap_used)]

use std::cell::Cell;
use std::rc::Rc;

use trocar_sdk::data::{Distance, Pose, Twist};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use crate::rig::{Rig, Setup, ready};
use crate::{BScan, Phase, ScanRequest};

/// Times that no distance and no pose can have at `now`.
fn lies(now: Stamp) -> [Stamp; 3] {
    [
        Stamp::from_ns(now.ns() + 8_000_000),
        Stamp::from_ns(now.ns() + 10_000_000_000),
        Stamp::from_ns(u64::MAX),
    ]
}

fn distance(stamp: Stamp) -> Distance {
    Distance { stamp, distance: 0.5e-3, velocity: 0.0, valid: true.into(), ..Distance::default() }
}

#[test]
fn distances_from_ahead_or_without_a_time_are_counted_and_leave_delay_and_scan_as_they_were() {
    let mut rig = Rig::new(Setup::new("default", 1));
    rig.begin();
    rig.until_scanning();
    rig.steps(100);
    let before = rig.progress();
    for stamp in lies(rig.bench.now()).into_iter().chain([Stamp::INVALID]) {
        rig.last_word = Some(distance(stamp));
        rig.step();
    }
    rig.steps(100);
    let after = rig.progress();
    assert_eq!((rig.bench.state().refused_distances, after.phase), (4, Phase::SCAN));
    assert!((after.delay - before.delay).abs() < 10e-6, "{:e} s for {:e}", after.delay, before.delay);
    assert!((after.loop_delay - before.loop_delay).abs() < 10e-6);
    assert!(after.error.abs() < 15e-6, "{:e} m", after.error);
}

#[test]
fn distances_from_ahead_do_not_open_the_gate_of_twelve_milliseconds() {
    for ahead_ns in [7_000_000, 1_000_000_000] {
        let mut rig = Rig::new(Setup { latency_ns: 13_500_000, ..Setup::new("default", 1) });
        for n in 0..200 {
            if n % 4 == 3 {
                rig.last_word = Some(distance(Stamp::from_ns(rig.bench.now().ns() + ahead_ns)));
            }
            rig.step();
        }
        // In time, so that it is the delay that is judged.
        rig.step();
        let refused = rig.bench.command::<ScanRequest, ()>("scan/start", Rig::request()).unwrap_err().reason;
        assert!(refused.contains("above 12 ms"), "{ahead_ns} ns ahead: {refused}");
    }
}

#[test]
fn a_distance_a_little_ahead_is_on_time_and_no_delay_is_less_than_none() {
    let mut bench = Bench::<BScan>::new("{}");
    let stamp = Stamp::from_ns(bench.now().ns() + 4_000_000);
    bench.push("distance", distance(stamp));
    bench.step(1);
    let state = bench.state();
    assert_eq!((state.progress.delay, state.refused_distances), (0.0, 0));
}

#[test]
fn a_pose_from_ahead_is_counted_and_those_that_follow_are_taken() {
    let mut bench = Bench::<BScan>::new("{}");
    bench.answer("robot/operating_state", |()| Ok(ready()));
    let tell = |bench: &mut Bench<BScan>, stamp: Stamp| {
        bench.answer("robot/measured_cp", move |()| Ok(Pose { stamp, ..Pose::default() }));
        bench.push("distance", distance(bench.now()));
        bench.step(1);
    };
    let begin = |bench: &mut Bench<BScan>| {
        let refused = bench.command::<ScanRequest, ()>("scan/start", Rig::request()).err();
        refused.map(|refused| refused.reason).unwrap_or_default()
    };
    for (n, lie) in lies(bench.now()).into_iter().enumerate() {
        tell(&mut bench, Stamp::from_ns(lie.ns().saturating_add(1_000_000 * n as u64)));
        assert_eq!(bench.state().refused_poses, n as u64 + 1, "{lie:?}");
        assert!(begin(&mut bench).contains("the robot does not tell where it is"), "{lie:?}");
    }
    let now = bench.now();
    tell(&mut bench, now);
    assert_eq!((begin(&mut bench).as_str(), bench.state().refused_poses), ("", 3));
    // A robot that does not measure yet tells nothing wrong.
    tell(&mut bench, Stamp::INVALID);
    assert_eq!(bench.state().refused_poses, 3);
}

#[test]
fn tips_and_surfaces_that_are_further_away_than_anything_are_counted_and_move_nothing() {
    let mut bench = Bench::<BScan>::new("{}");
    let pose: Rc<Cell<Pose>> = Rc::default();
    let said = pose.clone();
    bench.answer("robot/measured_cp", move |()| Ok(said.get()));
    bench.answer("robot/operating_state", |()| Ok(ready()));
    for n in 0..60 {
        let stamp = bench.now();
        let far = if n % 4 == 3 { 1e308 } else { 0.0 };
        pose.set(Pose { stamp, position: [0.0, 0.0, far], ..Pose::default() });
        bench.push("distance", Distance { distance: 0.5e-3 + far, ..distance(stamp) });
        bench.step(1);
        if n == 20 {
            bench.command::<ScanRequest, ()>("scan/start", Rig::request()).unwrap();
        }
    }
    let sent = bench.calls::<Twist>("axis/servo_cv");
    assert!(sent.len() > 30 && sent.iter().all(|t| t.linear.iter().all(|v| v.abs() < 1e-2)), "{sent:?}");
    assert_eq!((bench.state().refused_poses, bench.state().refused_distances), (15, 15));
}
