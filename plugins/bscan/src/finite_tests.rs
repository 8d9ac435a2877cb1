//! Finite numbers in, finite numbers out: whatever robot and tracker say, on every grid a scan is made for.
//!
//! Invariant: a scan is begun whenever it can be; most of what is said is near to what lets it go on.
#![allow(clippy::unwrap_used)]

use std::cell::Cell;
use std::rc::Rc;

use proptest::prelude::*;
use trocar_sdk::data::{Distance, Pose, Retreat, Twist, VirtualFixture};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::{Bench, numbers};

use crate::rig::{Rig, ready};
use crate::{BScan, ScanRequest};

/// A number about `usual`, or one of any size.
fn about(usual: f64, off: f64) -> impl Strategy<Value = f64> {
    let size = prop_oneof![-300.0..308.2f64, Just(308.0), Just(154.5)];
    let any = (size, any::<bool>()).prop_map(|(e, below)| 10f64.powf(e) * if below { -1.0 } else { 1.0 });
    prop_oneof![40 => usual - off..=usual + off, 1 => any]
}

/// Live settings.
fn settings() -> impl Strategy<Value = String> {
    (0.0..=100.0f64, 0.0..=2000.0f64, 0.0..=0.1f64, 1e-5..=0.01f64, 1e-5..=0.005f64).prop_map(
        |(kp, ki, lag, speed, approach)| {
            let gains = format!(r#""kp_per_s": {kp}, "ki_per_s2": {ki}, "robot_lag_s": {lag}"#);
            format!(r#"{{{gains}, "max_speed_m_s": {speed}, "approach_m_s": {approach}}}"#)
        },
    )
}

proptest! {
    #[test]
    fn a_scan_asks_for_numbers_whatever_robot_and_tracker_say_and_settings_become(
        parts in prop::collection::vec(
            (
                settings(),
                prop::collection::vec(
                    (
                        prop::array::uniform3(about(0.0, 1e-7)),
                        (about(500e-6, 1e-6), about(0.0, 1e-4)),
                        prop_oneof![20 => Just((0, 0i64)), 1 => (0..20_000_000u64, -6_000_000..6_000_000i64)],
                    ),
                    1..60,
                ),
            ),
            1..4,
        ),
    ) {
        let mut bench = Bench::<BScan>::new(&parts[0].0);
        let pose: Rc<Cell<Pose>> = Rc::default();
        let said = pose.clone();
        bench.answer("robot/measured_cp", move |()| Ok(said.get()));
        bench.answer("robot/operating_state", |()| Ok(ready()));
        for (settings, steps) in &parts {
            // Settings that leave a scan that runs no room are refused.
            let _ = bench.configure(settings);
            for (position, (distance, velocity), (late_ns, age_ns)) in steps {
                let stamp = Stamp::from_ns(bench.now().ns().saturating_add_signed(-age_ns));
                pose.set(Pose { stamp, position: *position, ..Pose::default() });
                let valid = Flag::TRUE;
                let seen = Distance { stamp, distance: *distance, velocity: *velocity, valid, ..Distance::default() };
                bench.push("distance", seen);
                bench.late_step(*late_ns).unwrap();
                let _ = bench.command::<ScanRequest, ()>("scan/start", Rig::request());
                let told = [
                    bench.calls::<Twist>("axis/servo_cv").iter().flat_map(numbers).collect(),
                    bench.calls::<Twist>("robot/servo_cv").iter().flat_map(numbers).collect(),
                    bench.calls::<Pose>("robot/move_cr").iter().flat_map(numbers).collect(),
                    bench.calls::<Retreat>("axis/set_retreat").iter().flat_map(numbers).collect(),
                    bench.calls::<VirtualFixture>("fixture/set_guard").iter().flat_map(numbers).collect(),
                    numbers(&bench.state()),
                ];
                for (what, told) in ["along", "across", "back", "retreat", "guard", "state"].iter().zip(&told) {
                    let told: &Vec<f64> = told;
                    prop_assert!(told.iter().all(|n| n.is_finite()), "{what}: {told:?}, {seen:?}, {position:?}");
                }
            }
        }
    }
}
