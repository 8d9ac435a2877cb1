//! The component on the bench, with the real robot, tracker and spectra of the simulated eye.
//!
//! Invariant: judged against the true distance, in virtual time, with fixed seeds. All of it is simulation.
#![allow(clippy::unwrap_used)]

use std::cell::Cell;
use std::rc::Rc;

use nalgebra::{Point3, Vector3};
use trocar_oct_core::chain::{Chain, Levels};
use trocar_oct_core::dispersion::Dispersion;
use trocar_oct_core::grid::{Grid, Interpolation};
use trocar_oct_core::tracker::{Settings, Tracker};
use trocar_phantom::spectra::{Optics, Spectrograph};
use trocar_phantom::{Hand, World};
use trocar_sdk::data::{CartesianState, JointState, OperatingMode};
use trocar_sdk::testing::Bench;

use super::*;
use crate::EyeRobot;

const STEP_NS: u64 = 1_000_000;
/// A line in half a millisecond: half of what the OCT gives.
const LINE_NS: u64 = 500_000;
/// From the middle of an exposure to the distance at the component.
const LATE_NS: u64 = 500_000;

/// A robot in a hand over the simulated eye, with OCT, led by the component.
struct Rig {
    world: World,
    hand: Hand,
    /// Beside the force of the hand, N.
    push_n: [f64; 3],
    robot: Bench<EyeRobot>,
    lead: Bench<Cooperative>,
    leads: bool,
    pose: Rc<Cell<Pose>>,
    guard: Rc<Cell<VirtualFixture>>,
    spectrograph: Spectrograph,
    chain: Chain,
    tracker: Tracker,
    /// Nothing is seen.
    dark: bool,
    line: u64,
    before: CartesianState,
    /// Commands that the robot did not take.
    refused: Vec<String>,
    /// From the true tip to the first surface, least of all, m.
    nearest_m: f64,
}

impl Rig {
    fn new(seed: u64, config: &str) -> Rig {
        Rig::with_robot(seed, config, "")
    }

    /// With `robot` in the robot's configuration.
    fn with_robot(seed: u64, config: &str, robot: &str) -> Rig {
        let world = World::named("default", seed).unwrap();
        let optics = Optics::with_samples(1024);
        let grid = Grid::from_wavelengths(1024, [840e-9, 50e-9, 0.0, 0.0]).unwrap();
        let mut chain = Chain::new(grid, Interpolation::Cubic, Levels::default());
        chain.set_dispersion(Dispersion { a2_rad: 18.0, a3_rad: 4.0 });
        let mut rig = Rig {
            world,
            hand: Hand::new(seed),
            push_n: [0.0; 3],
            robot: Bench::new(format!(r#"{{"seed": {seed}, "backlash_m": 1e-6{robot}}}"#)),
            lead: Bench::new(config),
            leads: true,
            pose: Rc::default(),
            guard: Rc::default(),
            spectrograph: Spectrograph::new(optics, world.noise(16)).unwrap(),
            chain,
            tracker: Tracker::new(Settings::default()),
            dark: false,
            line: 0,
            before: CartesianState::default(),
            refused: Vec::new(),
            nearest_m: f64::INFINITY,
        };
        let (pose, guard) = (rig.pose.clone(), rig.guard.clone());
        rig.lead.answer("robot/measured_cp", move |()| Ok(pose.get()));
        rig.lead.answer("fixture/guard", move |()| Ok(guard.get()));
        rig.lead.advance(rig.robot.now().ns() - rig.lead.now().ns());
        rig.chain.background().capture(256);
        let mut ascan = vec![0.0; 512];
        for n in 0..256 {
            let bytes = rig.spectrum(&[], 0.0, u64::MAX - n);
            rig.chain.line(&bytes, &mut ascan).unwrap();
        }
        rig.before = rig.true_tip();
        rig
    }

    fn spectrum(&mut self, echoes: &[trocar_phantom::tissue::Echo], t_s: f64, line: u64) -> Vec<u8> {
        let mut counts = vec![0; 1024];
        self.spectrograph.line(echoes, t_s, line, &mut counts);
        counts.iter().flat_map(|c| c.to_ne_bytes()).collect()
    }

    fn true_tip(&self) -> CartesianState {
        self.robot.read("truth/measured_cs", ()).unwrap()
    }

    /// From the true tip to the first surface, along the tool or straight down, whichever is less, m.
    fn distance_m(&self) -> f64 {
        self.distance_at(self.robot.now().ns() as f64 * 1e-9)
    }

    fn distance_at(&self, t_s: f64) -> f64 {
        let tip = self.true_tip().pose.isometry().unwrap();
        let from = Point3::from(tip.translation.vector);
        let along = |axis| self.world.below(&from, &axis, t_s).unwrap().distance_m;
        along(tip.rotation * Vector3::z_axis()).min(along(Vector3::z_axis()))
    }

    /// One period of the robot; the component steps in each second one.
    fn step(&mut self) {
        let now_ns = self.robot.now().ns() + STEP_NS;
        let t_s = now_ns as f64 * 1e-9;
        let force = self.hand.sensed_n(t_s) + Vector3::from(self.push_n);
        let stamp = self.robot.now();
        let force = self.true_tip().pose.isometry().unwrap().rotation.inverse() * force;
        self.robot.push("handle", Wrench { stamp, force: force.into(), ..Wrench::default() });
        self.robot.step(1);
        self.pose.set(self.robot.read("arm/measured_cp", ()).unwrap());
        self.guard.set(self.robot.read("virtual_fixture/guard", ()).unwrap());
        let pose = self.pose.get();
        self.tracker.tip_at(now_ns, pose.position, &pose.orientation);
        let at = self.true_tip();
        for n in 0..2 {
            self.expose(now_ns - STEP_NS + n * LINE_NS, now_ns, &at);
        }
        self.before = at;
        self.nearest_m = self.distance_m().min(self.nearest_m);
        if (now_ns / STEP_NS).is_multiple_of(2) && self.leads {
            self.lead.advance(now_ns - 2 * STEP_NS - self.lead.now().ns().min(now_ns - 2 * STEP_NS));
            self.lead.step(1);
            self.pass_on();
        }
    }

    fn expose(&mut self, ns: u64, now_ns: u64, after: &CartesianState) {
        let part = 1.0 - (now_ns - ns) as f64 / STEP_NS as f64;
        let (a, b) = (self.before.pose.position, after.pose.position);
        let tip = Point3::from([0, 1, 2].map(|i| a[i] + part * (b[i] - a[i])));
        let t_s = ns as f64 * 1e-9;
        let axis = after.pose.isometry().unwrap().rotation * Vector3::z_axis();
        let below = self.world.below(&tip, &axis, t_s).unwrap();
        let echoes = self.world.echoes(&below);
        let seen = if self.dark { &[] } else { echoes.as_slice() };
        self.line += 1;
        let bytes = self.spectrum(seen, t_s, self.line);
        let mut ascan = vec![0.0; 512];
        self.chain.line(&bytes, &mut ascan).unwrap();
        let reading = self.tracker.see(ns, &ascan, self.chain.grid().bin_m(), 0.0);
        if ns + LATE_NS <= now_ns {
            self.lead.push(
                "distance",
                Distance {
                    stamp: Stamp::from_ns(ns),
                    distance: if reading.valid { reading.distance_m } else { 0.0 },
                    velocity: reading.velocity_m_s,
                    sigma: reading.sigma_m,
                    snr_db: reading.snr_db,
                    valid: reading.valid.into(),
                    reserved: [0; 7],
                },
            );
        }
    }

    fn pass_on(&mut self) {
        let mut done = Vec::new();
        for guard in self.lead.calls::<VirtualFixture>("fixture/set_guard") {
            done.push(self.robot.command::<_, ()>("virtual_fixture/set_guard", guard));
        }
        for wrench in self.lead.calls::<Wrench>("compliance/servo_cf") {
            done.push(self.robot.command::<_, ()>("compliance/servo_cf", wrench));
        }
        for () in self.lead.calls::<()>("robot/hold") {
            done.push(self.robot.command::<_, ()>("arm/hold", ()));
        }
        self.refused.extend(done.into_iter().filter_map(|done| done.err()).map(|why| why.reason));
    }

    fn steps(&mut self, n: usize) {
        (0..n).for_each(|_| self.step());
    }

    fn stop(&mut self) {
        self.lead.stop().unwrap();
        self.pass_on();
        self.leads = false;
    }
}

#[test]
fn whatever_the_hand_does_the_tip_stays_150_micrometres_off_the_moving_retina() {
    keeps_off("{}", "", 0.4e-3..0.6e-3);
}

#[test]
fn whatever_the_hand_does_a_tool_from_the_side_stays_150_micrometres_off_the_moving_retina() {
    let robot = r#", "rest_roll_rad": -0.785, "rest_tilt_rad": 0.48, "port_m": 0.022"#;
    keeps_off("{}", robot, 0.3e-3..0.6e-3);
}

fn keeps_off(config: &str, robot: &str, led: std::ops::Range<f64>) {
    for seed in 0..20 {
        let mut rig = Rig::with_robot(seed, config, robot);
        // Down into the retina, and aside.
        let angle = seed as f64;
        rig.push_n = [0.8 * angle.cos(), 0.8 * angle.sin(), 1.5];
        rig.steps(1_400);
        let reached_m = rig.nearest_m;
        assert!(led.contains(&reached_m), "seed {seed}: it came to {reached_m:e} m");
        // Nothing is seen for a while; then everything again.
        rig.dark = true;
        rig.steps(300);
        rig.dark = false;
        rig.steps(300);
        assert!(rig.refused.is_empty(), "seed {seed}: {:?}", rig.refused);
        // The hand lets go while the retina is high or low, and the robot is not led any more: it stands, and
        // the eye swings on.
        rig.push_n = [0.0; 3];
        rig.steps(37 * seed as usize);
        rig.stop();
        rig.robot.step(200);
        let from_s = rig.robot.now().ns() as f64 * 1e-9;
        for n in 0..1_000 {
            rig.nearest_m = rig.distance_at(from_s + 5e-3 * f64::from(n)).min(rig.nearest_m);
        }
        println!("seed {seed}: {reached_m:.3e} m while led, {:.3e} m at last", rig.nearest_m);
        assert!(rig.nearest_m >= 150e-6, "seed {seed}: {:e} m", rig.nearest_m);
        let left: VirtualFixture = rig.robot.read("virtual_fixture/guard", ()).unwrap();
        assert_eq!(left, VirtualFixture::default(), "it takes its guard away");
    }
}

#[test]
fn each_cycle_asks_the_robot_once_behind_the_guard_and_stop_holds_it() {
    let mut rig = Rig::new(1, "{}");
    rig.lead.answer("hand/measured_cf", |()| {
        Ok(Wrench { stamp: Stamp::from_ns(1), force: [3.0, 0.0, 4.0], torque: [0.0; 3] })
    });
    rig.steps(101);
    let state = rig.lead.state();
    // In the first cycle the robot had no guard.
    assert_eq!((state.sent + state.unguarded, state.unguarded, state.rejected), (50, 1, 0));
    assert_eq!((state.force, state.surface), (5.0, Flag::TRUE));
    assert!((0.3e-3..0.9e-3).contains(&state.room), "{}", state.room);
    let guard: VirtualFixture = rig.robot.read("virtual_fixture/guard", ()).unwrap();
    assert_eq!((guard.kind, guard.stiffness), (FixtureKind::PLANE, 30.0));
    rig.lead.stop().unwrap();
    assert_eq!(rig.lead.calls::<()>("robot/hold").len(), 1);
}

#[test]
fn a_robot_that_comes_back_without_its_guard_is_led_only_when_it_has_one_again() {
    let mut rig = Rig::new(2, "{}");
    rig.push_n = [0.0, 0.0, 1.0];
    rig.steps(500);
    let before = rig.lead.state();
    rig.robot = Bench::new(r#"{"seed": 2}"#);
    rig.robot.advance(rig.lead.now().ns() - rig.robot.now().ns());
    rig.before = rig.true_tip();
    // The first cycle sends the guard alone.
    rig.steps(2);
    assert_eq!(
        rig.robot.read::<(), VirtualFixture>("virtual_fixture/guard", ()).unwrap().kind,
        FixtureKind::PLANE
    );
    assert_eq!(rig.lead.state().unguarded, before.unguarded + 1);
    rig.steps(2_000);
    assert!(rig.lead.state().sent > before.sent + 900);
    assert!(rig.nearest_m > 0.4e-3, "{:e}", rig.nearest_m);
    let state: trocar_sdk::data::OperatingState = rig.robot.read("arm/operating_state", ()).unwrap();
    assert_eq!(state.state, OperatingMode::ENABLED);
}

#[test]
fn without_a_distance_the_tip_stays_above_the_configured_plane_and_below_it_nothing_is_led() {
    let mut rig = Rig::new(3, r#"{"lowest_z_m": 0.1203}"#);
    rig.lead.connect_input("distance", false);
    rig.push_n = [0.0, 0.0, 1.5];
    rig.steps(2_000);
    let z = rig.pose.get().position[2];
    assert!((0.12028..0.12031).contains(&z) && rig.lead.state().surface == Flag::FALSE, "{z}");
    rig.stop();
    let goal = JointState { position: List::of(&[0.0, 0.0, 0.6e-3, 0.0, 0.0]), ..JointState::default() };
    rig.robot.command::<_, ()>("arm/move_jp", goal).unwrap();
    rig.robot.step(1_000);
    let mut late = Rig::new(3, r#"{"lowest_z_m": 0.1203}"#);
    late.robot = rig.robot;
    late.lead.advance(late.robot.now().ns() - late.lead.now().ns());
    late.before = late.true_tip();
    late.lead.connect_input("distance", false);
    late.push_n = [1.0, 0.0, -1.0];
    late.steps(500);
    let state = late.lead.state();
    assert_eq!((state.sent, state.unguarded), (0, 250), "nothing says where the retina is");
    assert!((late.pose.get().position[2] - 0.1206).abs() < 5e-6);
}

#[test]
fn a_deeper_layer_in_the_place_of_the_surface_does_not_open_the_way() {
    let mut guard = Guard::default();
    let bounds = Bounds { min_distance_m: 0.5e-3, lowest_z_m: 0.12 };
    let mut room_m = 0.0;
    for n in 1..=200u64 {
        let now = Stamp::from_ns(n * 2 * STEP_NS);
        let pose = Pose { stamp: now, position: [0.0, 0.0, 0.1204], orientation: [0.0, 0.0, 0.0, 1.0] };
        guard.tip_at(&pose);
        // For 40 ms the surface seems to be 180 µm deeper.
        let deeper = if (100..120).contains(&n) { 180e-6 } else { 0.0 };
        let told =
            Distance { stamp: now, distance: 0.6e-3 + deeper, valid: Flag::TRUE, ..Distance::default() };
        guard.distance(&told);
        let (_, now_m) = guard.plane(now, &bounds).unwrap();
        assert!(now_m < 0.1e-3 + 41e-6, "cycle {n}: {now_m}");
        room_m = now_m;
    }
    assert!((room_m - 0.1e-3).abs() < 1e-9, "{room_m}");
}

#[test]
fn a_robot_that_does_not_tell_where_it_is_is_not_led() {
    let mut bench = Bench::<Cooperative>::new("{}");
    bench.answer("fixture/guard", |()| Ok(VirtualFixture { kind: FixtureKind::PLANE, ..Default::default() }));
    bench.step(3);
    // Poses of long ago, and of a clock that is a second ahead: their time is unknown.
    let ahead = Stamp::from_ns(bench.now().ns() + 1_000_000_000);
    for stamp in [Stamp::from_ns(1), ahead] {
        bench.answer("robot/measured_cp", move |()| Ok(Pose { stamp, ..Pose::default() }));
        bench.step(3);
    }
    assert_eq!((bench.state().sent, bench.state().unguarded), (0, 9));
    assert_eq!(bench.calls::<Wrench>("compliance/servo_cf").len(), 0);
}

#[test]
fn a_robot_that_is_not_there_is_counted_and_a_handle_nobody_feels_has_no_force() {
    let mut rig = Rig::new(1, "{}");
    rig.steps(10);
    rig.lead.connect_function("compliance/servo_cf", false);
    rig.lead.answer("hand/measured_cf", |()| Ok(Wrench { force: [1.0; 3], ..Wrench::default() }));
    rig.steps(6);
    assert_eq!((rig.lead.state().rejected, rig.lead.state().force), (3, 0.0));
}

#[test]
fn a_step_allocates_nothing() {
    let mut rig = Rig::new(1, "{}");
    rig.lead.answer("hand/measured_cf", |()| Ok(Wrench::default()));
    rig.steps(20);
    let pose = rig.pose.get();
    let at = Rc::new(Cell::new(pose));
    let told = at.clone();
    rig.lead.answer("robot/measured_cp", move |()| Ok(told.get()));
    rig.lead.assert_no_alloc(|bench| {
        for _ in 0..100 {
            let stamp = bench.now();
            at.set(Pose { stamp, ..pose });
            let distance = Distance { stamp, distance: 1e-3, valid: Flag::TRUE, ..Distance::default() };
            bench.push("distance", distance);
            bench.step(1);
        }
    });
    assert!(rig.lead.state().sent > 100);
}
