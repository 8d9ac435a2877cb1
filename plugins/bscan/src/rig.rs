//! A closed loop in virtual time for tests: phantom, spectra, the whole processing chain, tracker, the
//! component `bscan` and the component `eyerobot`, each on its bench.
//!
//! Invariant: a run is a function of its setup. Control sees encoders and spectra only; truth goes into
//! `Record`.

mod judging;

use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_eyerobot::EyeRobot;
use trocar_oct_core::chain::{Chain, Levels};
use trocar_oct_core::dispersion::Dispersion;
use trocar_oct_core::grid::{Grid, Interpolation};
use trocar_oct_core::tracker::{Settings, Tracker};
use trocar_phantom::World;
use trocar_phantom::spectra::{Optics, Spectrograph};
use trocar_sdk::data::{
    AScanHeader, CartesianState, Distance, OperatingMode, OperatingState, Pose, Retreat, SampleFormat, Twist,
    VirtualFixture,
};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

use crate::{BScan, Phase, Progress, ScanRequest};

trocar_sdk::testing::count_allocations!();

const STEP_NS: u64 = 1_000_000;
const LINE_NS: u64 = 250_000;
pub(crate) const OFFSET_M: f64 = 500e-6;
/// The tip is never nearer to the surface than this, in no run, m.
pub(crate) const NEAREST_M: f64 = 150e-6;
/// Number of worlds that differ in their random parts.
const SEEDS: u64 = 4;
/// With all joints zero the robot's tip stands so far above the world's origin, m.
const STANDOFF_M: f64 = 1e-3;
/// Stance of the demo's robot: roll and tilt at home, rad, and from the tip to the wall of the eye, m.
pub(crate) const FROM_THE_SIDE: [f64; 3] = [-0.785, 0.48, 22e-3];
/// Height of the world's origin in the robot's base frame, m.
pub(crate) const APEX_Z_M: f64 = 0.12 + STANDOFF_M;
/// Periods in which the robot is brought over the eye.
const PLACING: u64 = 400;

/// The seeds of these worlds. `TROCAR_SEEDS=5` gives five times as many, as `./tests/run --all` does.
pub(crate) fn seeds() -> std::ops::RangeInclusive<u64> {
    let times = std::env::var("TROCAR_SEEDS")
        .map_or(1, |times| times.parse().unwrap_or_else(|e| panic!("TROCAR_SEEDS={times}: {e}")));
    1..=SEEDS * times
}

#[derive(Clone, Copy)]
pub(crate) struct Setup {
    pub(crate) world: World,
    /// From the end of an exposure to the distance, ns.
    pub(crate) latency_ns: u64,
    /// Light from the tissue from the begin of the scan on, beside the usual.
    pub(crate) signal: f64,
    /// A-scans go into the component, too.
    pub(crate) images: bool,
    /// Over which place of the eye (x, y) the tip begins, and how high above the surface, m.
    pub(crate) place_m: [f64; 3],
    pub(crate) offset_m: f64,
    /// End of the line, along x, m.
    pub(crate) end_m: f64,
    /// Roll and tilt of the tool at home, rad, and the distance from the tip back to the wall of the eye that
    /// holds it, m; 0 is no wall.
    pub(crate) stand: [f64; 3],
}

impl Setup {
    pub(crate) fn new(world: &str, seed: u64) -> Setup {
        let world = World::named(world, seed).expect("a name");
        Setup {
            world,
            latency_ns: 250_000,
            signal: 1.0,
            images: false,
            place_m: [-1.5e-3, 0.0, 600e-6],
            offset_m: OFFSET_M,
            end_m: 1.5e-3,
            stand: [0.0; 3],
        }
    }

    /// Both ways in which a tool stands: upright, and from the side.
    pub(crate) fn both(world: &str, seed: u64) -> [Setup; 2] {
        [Setup::new(world, seed), Setup::from_the_side(world, seed)]
    }

    /// The same at the nearest offset that each of them may keep.
    pub(crate) fn near(world: &str, seed: u64) -> [Setup; 2] {
        let [upright, aside] = Setup::both(world, seed);
        [Setup { offset_m: 200e-6, ..upright }, Setup { offset_m: 240e-6, ..aside }]
    }

    /// The part of a way along the tool that leads along the axis of the eye.
    pub(crate) fn upright(&self) -> f64 {
        self.stand[1].cos()
    }

    /// The same with a tool that comes from the side through the wall of the eye, as in the demo.
    pub(crate) fn from_the_side(world: &str, seed: u64) -> Setup {
        Setup { stand: FROM_THE_SIDE, ..Setup::new(world, seed) }
    }
}

/// Truth at one line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Truth {
    pub(crate) ns: u64,
    pub(crate) scanning: bool,
    /// Along the line, from the middle of the usual one.
    pub(crate) x_m: f64,
    pub(crate) tip_z_m: f64,
    /// To the first surface along the tool.
    pub(crate) distance_m: f64,
    /// The same, or straight down, whichever is less.
    pub(crate) nearest_m: f64,
    pub(crate) ilm_m: f64,
    pub(crate) epithelium_m: f64,
    /// Reading of the tracker.
    pub(crate) measured: Distance,
}

pub(crate) struct Rig {
    pub(crate) setup: Setup,
    pub(crate) bench: Bench<BScan>,
    spectrograph: Spectrograph,
    chain: Chain,
    tracker: Tracker,
    pub(crate) robot: Bench<EyeRobot>,
    /// Position and velocity of the true tip at the end of the last two periods.
    tips: [CartesianState; 2],
    /// The robot's base in the world.
    world_from_base: Isometry3<f64>,
    /// The tool when the scan was asked for: a line goes across it.
    across: Vector3<f64>,
    pose: Rc<Cell<Pose>>,
    told: Rc<Cell<OperatingState>>,
    /// Operating state that the robot tells instead of its true one.
    pub(crate) pretends: Option<OperatingState>,
    /// Age of the pose that the robot tells, periods.
    pub(crate) pose_late: usize,
    past: VecDeque<Pose>,
    /// The robot tells a turn that is none.
    pub(crate) turnless: bool,
    /// Something holds the tip back along x.
    pub(crate) stuck: bool,
    waiting: Vec<(u64, Distance, Vec<f32>)>,
    line: u64,
    /// Lines up to this one see nothing.
    pub(crate) dark_until_ns: u64,
    /// Lines up to this one see the deepest layer alone.
    pub(crate) deep_until_ns: u64,
    pub(crate) truth: Vec<Truth>,
    /// Place at which the shaft goes through the wall of the eye, in the world, and its distance from the
    /// shaft after each period, m.
    port: Point3<f64>,
    pub(crate) beside_port_m: Vec<f64>,
    pub(crate) held: usize,
    /// Commands that the robot did not take.
    pub(crate) refused: Vec<String>,
    /// Commands that the arm does not take now.
    refuses: &'static [&'static str],
    /// A distance that comes after all others of the next period.
    pub(crate) last_word: Option<Distance>,
    /// Steps must not allocate.
    pub(crate) watched: bool,
}

/// Returns the state of a robot that takes motions.
pub(crate) fn ready() -> OperatingState {
    OperatingState { state: OperatingMode::ENABLED, is_homed: true.into(), ..OperatingState::default() }
}

impl Rig {
    pub(crate) fn new(setup: Setup) -> Rig {
        let rows = if setup.images { 512 } else { 8 };
        let mut bench = Bench::<BScan>::new(format!(r#"{{"rows": {rows}, "range_db": [40, 100]}}"#));
        let pose = Rc::new(Cell::new(Pose::default()));
        let at = pose.clone();
        bench.answer("robot/measured_cp", move |()| Ok(at.get()));
        let told = Rc::new(Cell::new(ready()));
        let state = told.clone();
        bench.answer("robot/operating_state", move |()| Ok(state.get()));
        let seed = setup.world.seed;
        let [roll, tilt, port] = setup.stand;
        let robot = Bench::<EyeRobot>::new(format!(
            r#"{{"seed": {seed}, "standoff_m": {STANDOFF_M}, "rest_roll_rad": {roll}, "rest_tilt_rad": {tilt}, "port_m": {port}}}"#
        ));
        let optics = Optics::with_samples(1024);
        let spectrograph = Spectrograph::new(optics, setup.world.noise(16)).expect("usual optics");
        let grid = Grid::from_wavelengths(1024, [840e-9, 50e-9, 0.0, 0.0]).expect("a grid");
        let mut chain = Chain::new(grid, Interpolation::Cubic, Levels::default());
        chain.set_dispersion(Dispersion { a2_rad: 18.0, a3_rad: 4.0 });
        let mut rig = Rig {
            setup,
            bench,
            spectrograph,
            chain,
            tracker: Tracker::new(Settings::default()),
            robot,
            tips: [CartesianState::default(); 2],
            world_from_base: Isometry3::identity(),
            across: Vector3::z(),
            pose,
            told,
            pretends: None,
            pose_late: 0,
            past: VecDeque::new(),
            turnless: false,
            stuck: false,
            waiting: Vec::new(),
            line: 0,
            dark_until_ns: 0,
            deep_until_ns: 0,
            truth: Vec::new(),
            port: Point3::origin(),
            beside_port_m: Vec::new(),
            held: 0,
            refused: Vec::new(),
            refuses: &[],
            last_word: None,
            watched: false,
        };
        rig.capture();
        rig.place();
        rig
    }

    /// The background of the reference arm alone.
    fn capture(&mut self) {
        self.chain.background().capture(256);
        let (mut counts, mut ascan) = (vec![0; 1024], vec![0.0; 512]);
        for n in 0..256 {
            self.spectrograph.line(&[], 0.0, u64::MAX - n, &mut counts);
            let bytes: Vec<u8> = counts.iter().flat_map(|c| c.to_ne_bytes()).collect();
            self.chain.line(&bytes, &mut ascan).expect("lengths fit");
        }
    }

    /// Brings the tip over the eye, and both benches to the same time.
    fn place(&mut self) {
        let base: Pose = self.robot.read("arm/measured_cp", ()).expect("a read");
        let home = self.true_tip().pose.isometry().expect("a pose");
        self.world_from_base = home * base.isometry().expect("a pose").inverse();
        let [x, y, height_m] = self.setup.place_m;
        let t_s = (self.robot.now().ns() + PLACING * STEP_NS) as f64 * 1e-9;
        let over = Point3::new(x, y, self.setup.world.surface_z(x, y, t_s));
        let [.., port_m] = self.setup.stand;
        self.port = home * Point3::new(0.0, 0.0, -port_m);
        let axis = if port_m > 0.0 { (over - self.port).normalize() } else { home.rotation * Vector3::z() };
        let tip = over - axis * height_m;
        let lean =
            UnitQuaternion::rotation_between(&(home.rotation * Vector3::z()), &axis).unwrap_or_default();
        let goal = Isometry3::from_parts(tip.into(), lean * home.rotation);
        let goal: Pose = (self.world_from_base.inverse() * goal).into();
        self.robot.command::<_, ()>("arm/move_cp", goal).expect("in reach");
        self.robot.step(PLACING);
        self.bench.advance(self.robot.now().ns() - self.bench.now().ns());
        self.tips = [self.true_tip(); 2];
    }

    fn true_tip(&self) -> CartesianState {
        self.robot.read("truth/measured_cs", ()).expect("a read")
    }

    /// The usual scan: 3 mm along x through the fovea and two patches.
    pub(crate) fn request() -> ScanRequest {
        ScanRequest {
            from: [-1.5e-3, 0.0, APEX_Z_M],
            to: [1.5e-3, 0.0, APEX_Z_M],
            speed: 0.5e-3,
            offset: OFFSET_M,
            pitch: 6e-6,
            ..ScanRequest::default()
        }
    }

    /// One period: exposures, processing, control, motion.
    pub(crate) fn step(&mut self) {
        let now_ns = self.bench.now().ns() + STEP_NS;
        self.robot.step(1);
        assert_eq!(self.robot.now().ns(), now_ns, "one time for both");
        self.tips = [self.tips[1], self.true_tip()];
        let tip = self.tips[1].pose.isometry().expect("a pose");
        let off = tip.inverse_transform_point(&self.port);
        self.beside_port_m.push(off.x.hypot(off.y));
        let pose: Pose = self.robot.read("arm/measured_cp", ()).expect("a read");
        self.past.push_front(pose);
        self.past.truncate(16);
        let mut told = self.past[self.pose_late.min(self.past.len() - 1)];
        if self.turnless {
            told.orientation = [0.0; 4];
        }
        self.pose.set(told);
        let state = self.robot.read("arm/operating_state", ()).expect("a read");
        self.told.set(self.pretends.unwrap_or(state));
        self.tracker.tip_at(now_ns, pose.position, &pose.orientation);
        for n in 0..4 {
            self.expose(now_ns - STEP_NS + n * LINE_NS + LINE_NS / 2, now_ns);
        }
        let due = |(arrives, ..): &(u64, Distance, Vec<f32>)| *arrives <= now_ns;
        let here = self.waiting.iter().take_while(|w| due(w)).count();
        for (_, distance, ascan) in self.waiting.drain(..here) {
            self.bench.push("distance", distance);
            if self.setup.images {
                let bytes: Vec<u8> = ascan.iter().flat_map(|db| db.to_ne_bytes()).collect();
                let header = AScanHeader {
                    stamp: distance.stamp,
                    lines: 1,
                    samples: 512,
                    format: SampleFormat::F32,
                    line_period: 250e-6,
                    bin: self.chain.grid().bin_m(),
                    ..AScanHeader::default()
                };
                self.bench.push_frame("ascan", header, &bytes);
            }
        }
        if let Some(distance) = self.last_word.take() {
            self.bench.push("distance", distance);
        }
        if self.watched {
            self.bench.assert_no_alloc(|bench| bench.step(1));
        } else {
            self.bench.step(1);
        }
        self.pass_on();
    }

    /// Brings what the component has sent to the robot.
    fn pass_on(&mut self) {
        let mut done = Vec::new();
        self.drop_refused();
        for (from, to) in [("axis/servo_cv", "axis/servo_cv"), ("robot/servo_cv", "arm/servo_cv")] {
            if let Some(mut twist) = self.bench.calls::<Twist>(from).pop() {
                if self.stuck {
                    twist.linear[0] = 0.0;
                }
                done.push(self.robot.command::<_, ()>(to, twist));
            }
        }
        for retreat in self.bench.calls::<Retreat>("axis/set_retreat") {
            done.push(self.robot.command::<_, ()>("axis/set_retreat", retreat));
        }
        for () in self.bench.calls::<()>("robot/hold") {
            self.held += 1;
            done.push(self.robot.command::<_, ()>("arm/hold", ()));
        }
        for away in self.bench.calls::<Pose>("robot/move_cr") {
            done.push(self.robot.command::<_, ()>("arm/move_cr", away));
        }
        if let Some(guard) = self.bench.calls::<VirtualFixture>("fixture/set_guard").pop() {
            done.push(self.robot.command::<_, ()>("virtual_fixture/set_guard", guard));
        }
        self.refused.extend(done.into_iter().filter_map(|done| done.err()).map(|why| why.reason));
    }

    fn expose(&mut self, ns: u64, now_ns: u64) {
        // The tip moved from the first to the second place in the period that has just gone by.
        let part = 1.0 - (now_ns - ns) as f64 / STEP_NS as f64;
        let [before, after] = self.tips.map(|tip| tip.pose.position);
        let tip = Point3::from([0, 1, 2].map(|i| before[i] + part * (after[i] - before[i])));
        let t_s = ns as f64 * 1e-9;
        let axis = self.tips[1].pose.isometry().expect("a pose").rotation * Vector3::z_axis();
        let below = self.setup.world.below(&tip, &axis, t_s).expect("over the retina");
        let echoes = self.setup.world.echoes(&below);
        let all = echoes.as_slice();
        let from = if ns < self.deep_until_ns { all.len() - 1 } else { 0 };
        let seen = if ns < self.dark_until_ns { &[] } else { &all[from..] };
        let mut counts = [0; 1024];
        self.line += 1;
        self.spectrograph.line(seen, t_s, self.line, &mut counts);
        let mut bytes = [0; 2048];
        for (count, bytes) in counts.iter().zip(bytes.as_chunks_mut::<2>().0) {
            *bytes = count.to_ne_bytes();
        }
        let mut ascan = vec![0.0; 512];
        self.chain.line(&bytes, &mut ascan).expect("lengths fit");
        let reading = self.tracker.see(ns, &ascan, self.chain.grid().bin_m(), 0.0);
        let measured = Distance {
            stamp: Stamp::from_ns(ns),
            distance: if reading.valid { reading.distance_m } else { 0.0 },
            velocity: reading.velocity_m_s,
            sigma: reading.sigma_m,
            snr_db: reading.snr_db,
            valid: reading.valid.into(),
            reserved: [0; 7],
        };
        self.truth.push(Truth {
            ns,
            scanning: self.progress().phase == Phase::SCAN,
            x_m: self.along_m(&tip),
            tip_z_m: tip.z,
            distance_m: below.distance_m,
            nearest_m: self.straight_down(&tip, t_s).min(below.distance_m),
            ilm_m: below.ilm_m,
            epithelium_m: below.epithelium_m,
            measured,
        });
        self.waiting.push((ns + LINE_NS / 2 + self.setup.latency_ns, measured, ascan));
    }

    pub(crate) fn progress(&self) -> Progress {
        self.bench.state().progress
    }

    pub(crate) fn steps(&mut self, count: usize) {
        (0..count).for_each(|_| self.step());
    }

    /// From a tip (m, world) to the first surface below it, m.
    fn straight_down(&self, tip: &Point3<f64>, t_s: f64) -> f64 {
        self.setup.world.below(tip, &Vector3::z_axis(), t_s).expect("over the retina").distance_m
    }

    /// Returns the way of a tip (m, world) along the line, from the middle of the usual line, m.
    fn along_m(&self, tip: &Point3<f64>) -> f64 {
        let way = Vector3::x() - self.across * self.across.x;
        let from_apex = self.world_from_base.inverse_transform_point(tip) - Point3::new(0.0, 0.0, APEX_Z_M);
        from_apex.dot(&way.normalize())
    }

    /// Returns the length of a line across the tool as a part of the requested one.
    pub(crate) fn part_across(&self) -> f64 {
        (1.0 - self.across.x * self.across.x).sqrt()
    }

    /// Looks for a while and begins the usual scan.
    pub(crate) fn begin(&mut self) {
        self.steps(60);
        self.across = self.true_tip().pose.isometry().expect("a pose").rotation * Vector3::z();
        let Setup { offset_m: offset, end_m, .. } = self.setup;
        let request = ScanRequest { offset, to: [end_m, 0.0, APEX_Z_M], ..Rig::request() };
        self.bench.command::<ScanRequest, ()>("scan/start", request).expect("a scan");
    }

    /// The arm does not take these commands, `robot/hold` or `robot/move_cr`, but answers this.
    pub(crate) fn refuse(&mut self, commands: &'static [&'static str], outcome: Outcome) {
        commands.iter().for_each(|command| self.bench.fail(command, outcome));
        self.refuses = commands;
    }

    /// The arm takes all commands again.
    pub(crate) fn take_again(&mut self) {
        self.drop_refused();
        std::mem::take(&mut self.refuses)
            .iter()
            .for_each(|command| self.bench.fail(command, Outcome::Queued));
    }

    /// Drops commands that the arm has not taken: they never come to it.
    fn drop_refused(&mut self) {
        for command in self.refuses {
            match *command {
                "robot/hold" => _ = self.bench.calls::<()>(command),
                _ => _ = self.bench.calls::<Pose>(command),
            }
        }
    }

    /// A robot that goes back by itself, or one that cannot.
    pub(crate) fn retreats(&mut self, can: bool) {
        self.bench.connect_function("axis/set_retreat", can);
    }

    /// Goes on until the tip is on its way along the line.
    pub(crate) fn until_scanning(&mut self) {
        for _ in 0..5000 {
            if self.progress().phase == Phase::SCAN {
                return;
            }
            self.step();
        }
        panic!("the scan does not set off: {:?}", self.progress());
    }

    /// Goes on until the scan has ended.
    pub(crate) fn until_idle(&mut self) {
        for _ in 0..8000 {
            if self.progress().phase == Phase::IDLE {
                return;
            }
            self.step();
        }
        panic!("the scan does not end: {:?}", self.progress());
    }

    /// The whole scan.
    pub(crate) fn run(setup: Setup) -> Rig {
        let mut rig = Rig::new(setup);
        rig.begin();
        rig.until_scanning();
        rig.spectrograph.set_light(1.0, Optics::GAIN * setup.signal, 0.55);
        rig.until_idle();
        assert!(rig.refused.is_empty(), "the robot refused: {:?}", rig.refused);
        rig
    }
}
