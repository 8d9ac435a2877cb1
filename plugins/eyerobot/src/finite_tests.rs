//! Finite numbers in, finite numbers out: of every class of the plugin, by every execution it is made for.
//!
//! Invariant: peers and sensors say any number of any time. Commands to the arm are in
//! `arm/anything_tests.rs`.
#![allow(clippy::unwrap_used)]

use std::cell::Cell;
use std::rc::Rc;

use proptest::prelude::*;
use trocar_sdk::Class;
use trocar_sdk::data::{ArmState, CartesianState, Distance, JointState, Pose, Wrench};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::{Bench, numbers};

use crate::*;

/// A cycle and the sample it finds.
#[derive(Clone, Debug)]
struct Cycle {
    /// Its lateness, or the time since the one before, ns.
    late_ns: u64,
    /// Age of the sample, negative from ahead, ns; none without a stamp.
    age_ns: Option<i64>,
    numbers: [f64; 6],
    /// x, y, z, w of an orientation.
    turn: [f64; 4],
}

impl Cycle {
    fn stamp(&self, now: Stamp) -> Stamp {
        self.age_ns.map_or(Stamp::INVALID, |age| Stamp::from_ns(now.ns().saturating_add_signed(-age)))
    }

    fn pose(&self, now: Stamp) -> Pose {
        let [x, y, z, ..] = self.numbers;
        Pose { stamp: self.stamp(now), position: [x, y, z], orientation: self.turn }
    }

    fn wrench(&self, now: Stamp) -> Wrench {
        let [a, b, c, d, e, f] = self.numbers;
        Wrench { stamp: self.stamp(now), force: [a, b, c], torque: [d, e, f] }
    }

    /// Steps on the grid, or without one where the class can.
    fn step<C: Class>(&self, bench: &mut Bench<C>) {
        if C::DESC.limits.models.is_empty() && self.late_ns.is_multiple_of(2) {
            bench.step_after(self.late_ns).unwrap();
        } else {
            bench.late_step(self.late_ns).unwrap();
        }
    }
}

fn cycles() -> impl Strategy<Value = Vec<Cycle>> {
    let size = prop_oneof![
        4 => -3.0..2.0f64,
        2 => -300.0..308.2f64,
        1 => Just(308.0),
        1 => Just(154.5),
    ];
    let number = || {
        prop_oneof![
            1 => Just(0.0),
            6 => (size.clone(), any::<bool>()).prop_map(|(e, below)| 10f64.powf(e) * if below { -1.0 } else { 1.0 }),
        ]
    };
    let turn = prop_oneof![
        6 => prop::array::uniform4(-1.0..1.0f64).prop_map(|q| {
            let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
            if norm > 0.01 { q.map(|x| x / norm) } else { [0.0, 0.0, 0.0, 1.0] }
        }),
        1 => prop::array::uniform4(number()),
    ];
    let late_ns = prop_oneof![Just(0), 0..2_000_000u64, (0..11u32).prop_map(|e| 10u64.pow(e))];
    let age_ns = prop_oneof![
        4 => Just(Some(0i64)),
        2 => (-3_000_000..30_000_000i64).prop_map(Some),
        1 => (-18..18i32).prop_map(|e| Some(i64::from(e.signum()) * 10i64.pow(e.unsigned_abs()))),
        1 => Just(None),
    ];
    let cycle = (late_ns, age_ns, prop::array::uniform6(number()), turn);
    let cycle = cycle.prop_map(|(late_ns, age_ns, numbers, turn)| Cycle { late_ns, age_ns, numbers, turn });
    prop::collection::vec(cycle, 1..12)
}

fn all_finite(what: &str, told: &[f64]) -> Result<(), TestCaseError> {
    prop_assert!(told.iter().all(|n| n.is_finite()), "{what} is {told:?}");
    Ok(())
}

/// All numbers an output gave.
fn outputs<C: Class, T: Payload>(bench: &mut Bench<C>, output: &str) -> Vec<f64> {
    bench.outputs::<T>(output).iter().flat_map(numbers).collect()
}

proptest! {
    #[test]
    fn an_arm_says_numbers_whatever_is_felt_at_its_handle(
        cycles in cycles(), tip in prop::sample::select(vec!["free", "hold"]),
    ) {
        let mut bench = Bench::<EyeRobot>::new("{}");
        bench.command::<(), ()>(tip, ()).unwrap();
        for cycle in &cycles {
            let wrench = cycle.wrench(bench.now());
            bench.push("handle", wrench);
            cycle.step(&mut bench);
            all_finite("state", &outputs::<_, ArmState>(&mut bench, "state"))?;
            all_finite("measured_cp", &outputs::<_, Pose>(&mut bench, "measured_cp"))?;
            all_finite("hand_cf", &outputs::<_, Wrench>(&mut bench, "hand_cf"))?;
            all_finite("tip", &outputs::<_, CartesianState>(&mut bench, "tip"))?;
            all_finite("the state row", &numbers(&bench.state()))?;
        }
    }

    #[test]
    fn cooperative_control_asks_for_numbers_whatever_robot_and_tracker_say(cycles in cycles(), seen: u8) {
        let mut bench = Bench::<Cooperative>::new("{}");
        let (pose, felt): (Rc<Cell<Pose>>, Rc<Cell<Wrench>>) = Default::default();
        let (said, told) = (pose.clone(), felt.clone());
        bench.answer("robot/measured_cp", move |()| Ok(said.get()));
        bench.answer("hand/measured_cf", move |()| Ok(told.get()));
        bench.answer("fixture/guard", |()| {
            Ok(VirtualFixture { kind: FixtureKind::PLANE, ..VirtualFixture::default() })
        });
        for (n, cycle) in cycles.iter().enumerate() {
            let now = bench.now();
            pose.set(cycle.pose(now));
            felt.set(cycle.wrench(now));
            if seen >> (n % 8) & 1 == 1 {
                let [_, _, distance, velocity, sigma, snr_db] = cycle.numbers;
                let stamp = cycle.stamp(now);
                let valid = Flag::TRUE;
                bench.push("distance", Distance { stamp, distance, velocity, sigma, snr_db, valid, reserved: [0; 7] });
            }
            cycle.step(&mut bench);
            let guards: Vec<f64> = bench.calls::<VirtualFixture>("set_guard").iter().flat_map(numbers).collect();
            all_finite("the guard", &guards)?;
            let asked: Vec<f64> = bench.calls::<Wrench>("servo_cf").iter().flat_map(numbers).collect();
            all_finite("the wrench", &asked)?;
            all_finite("the state row", &numbers(&bench.state()))?;
        }
    }

    #[test]
    fn a_mover_asks_for_numbers_at_any_pace_and_settings(
        cycles in cycles(), amplitude in 0.0..=0.05f64, hz in 0.0..=10.0f64, joint in 0..3usize,
    ) {
        let mut bench = Bench::<JointMover>::new("{}");
        let at: Rc<Cell<JointState>> = Rc::default();
        let said = at.clone();
        bench.answer("measured_js", move |()| Ok(said.get()));
        for (n, cycle) in cycles.iter().enumerate() {
            if n == 5 {
                let set = format!(r#"{{"amplitude_m": {amplitude}, "frequency_hz": {hz}, "joint": {joint}}}"#);
                bench.configure(set).unwrap();
            }
            at.set(JointState { position: List::of(&cycle.numbers), ..JointState::default() });
            cycle.step(&mut bench);
            let goals: Vec<f64> = bench.calls::<JointState>("servo_jp").iter().flat_map(numbers).collect();
            prop_assert!(goals.iter().all(|goal| goal.abs() <= 0.05), "{goals:?}");
            all_finite("the state row", &numbers(&bench.state()))?;
        }
    }

    #[test]
    fn a_free_hand_is_somewhere_at_any_pace_and_settings(
        cycles in cycles(), line in 0.0..=0.02f64, tremor in 0.0..=10.0f64,
    ) {
        let mut bench = Bench::<FreeHand>::new("{}");
        for (n, cycle) in cycles.iter().enumerate() {
            if n == 5 {
                bench.configure(format!(r#"{{"line_m": {line}, "tremor": {tremor}}}"#)).unwrap();
            }
            cycle.step(&mut bench);
            all_finite("tip", &outputs::<_, CartesianState>(&mut bench, "tip"))?;
        }
    }
}

#[test]
fn a_robot_or_a_surface_further_away_than_anything_is_none() {
    let mut bench = Bench::<Cooperative>::new("{}");
    let height = Rc::new(Cell::new(0.1));
    let (said, now) = (height.clone(), Rc::new(Cell::new(Stamp::INVALID)));
    let stamp = now.clone();
    bench.answer("robot/measured_cp", move |()| {
        Ok(Pose { stamp: stamp.get(), position: [0.0, 0.0, said.get()], ..Pose::default() })
    });
    bench.answer("fixture/guard", |()| {
        Ok(VirtualFixture { kind: FixtureKind::PLANE, ..VirtualFixture::default() })
    });
    for (z, distance, guarded) in [(0.1, 1e308, true), (1e308, 0.1, false), (0.1, 0.1, true)] {
        height.set(z);
        now.set(bench.now());
        let seen = Distance { stamp: bench.now(), distance, valid: Flag::TRUE, ..Distance::default() };
        bench.push("distance", seen);
        bench.step(1);
        assert_eq!(
            bench.calls::<VirtualFixture>("set_guard").len(),
            usize::from(guarded),
            "{z} m, {distance} m"
        );
        assert_eq!(bench.state().surface.get(), distance < 1.0 && guarded, "{z} m, {distance} m");
    }
}
