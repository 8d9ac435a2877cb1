//! The checks of contracts take a device that keeps the rules, and name the rule that another one breaks.
#![allow(clippy::unwrap_used)]
#![forbid(unsafe_code)]

use trocar_sdk::crtk::{OperatingStateMachine, StateCommand, require_in_time};
use trocar_sdk::data::*;
use trocar_sdk::prelude::*;
use trocar_sdk::testing::{
    Bench, assert_behaves_as_arm, assert_behaves_as_camera, assert_implements, contracts,
};

#[derive(Config)]
struct Flawed {
    /// Deviation from its contract; nothing by default
    #[config(default = "")]
    flaw: String,
}

impl Flawed {
    fn has(&self, flaw: &str) -> bool {
        self.flaw == flaw
    }
}

#[derive(Default)]
enum Motion {
    #[default]
    Hold,
    To {
        goal: [f64; 2],
        homing: bool,
    },
    Velocity {
        m_s: f64,
        left_s: f64,
    },
}

/// Highest speed of both joints, m/s and rad/s.
const SPEED: f64 = 0.1;

/// Two joints that are where they are sent.
#[derive(Component)]
#[component(rate_hz = 100, safety = "actuator", provides("left"))]
struct Toy {
    #[event("left", name = "operating_state")]
    changed: Event<OperatingState>,
    #[state]
    at: JointState,
    #[state]
    now: OperatingState,
    #[config]
    cfg: Flawed,
    #[host]
    host: Host,
    operating: OperatingStateMachine,
    joints: [f64; 2],
    motion: Motion,
}

#[provides("left")]
impl Toy {
    #[read]
    fn measured_js(s: &ToyState) -> JointState {
        s.at
    }
    #[read]
    fn measured_cp(s: &ToyState) -> Pose {
        Pose { stamp: s.at.stamp, orientation: [0.0, 0.0, 0.0, 1.0], ..Pose::default() }
    }
    #[read]
    fn setpoint_js(s: &ToyState) -> JointState {
        s.at
    }
    #[read]
    fn configuration_js(_: &ToyState) -> JointConfiguration {
        JointConfiguration {
            names: List::of(&["slide".into(), "roll".into()]),
            kinds: List::of(&[JointKind::PRISMATIC, JointKind::REVOLUTE]),
            lower: List::of(&[-0.2, -1.0]),
            upper: List::of(&[0.2, 1.0]),
            speed: List::of(&[SPEED, SPEED]),
            ..JointConfiguration::default()
        }
    }
    #[read]
    fn operating_state(s: &ToyState) -> OperatingState {
        s.now
    }
    #[command(overflow = "latest_wins")]
    fn servo_jp(&mut self, goal: &JointState) -> Result {
        if !self.cfg.has("takes old goals") {
            require_in_time(goal.stamp, self.host.now(), 0.1)?;
        }
        let goal = self.allowed(goal)?;
        self.operating.move_ends();
        self.motion = Motion::To { goal, homing: false };
        if self.cfg.has("jumps") {
            self.joints = goal;
        }
        self.publish();
        Ok(())
    }
    #[command(overflow = "latest_wins")]
    fn servo_jv(&mut self, goal: &JointState) -> Result {
        self.operating.require_ready()?;
        let left_s = if self.cfg.has("runs on") { f64::INFINITY } else { 0.1 };
        self.motion = Motion::Velocity { m_s: goal.velocity[0], left_s };
        Ok(())
    }
    #[command]
    fn move_jp(&mut self, goal: &JointState) -> Result {
        let goal = self.allowed(goal)?;
        self.operating.move_begins();
        self.motion = Motion::To { goal, homing: false };
        self.publish();
        Ok(())
    }
    #[command]
    fn hold(&mut self) {
        self.operating.move_ends();
        self.motion = Motion::Hold;
        self.publish();
    }
    #[command]
    fn state_command(&mut self, word: &Text<32>) -> Result {
        let taken = self.operating.command(word);
        if taken.is_err() && self.cfg.has("a word is a fault") {
            self.operating.fault();
        }
        match taken.map_err(|why| {
            if self.cfg.has("refuses in silence") { "no".to_string() } else { why.to_string() }
        }) {
            Ok(StateCommand::Home) => {
                self.operating.move_begins();
                self.motion = Motion::To { goal: [0.0; 2], homing: true };
            }
            Ok(StateCommand::Resume) if self.cfg.has("resumes its motion") => {}
            Ok(_) => {
                self.operating.move_ends();
                self.motion = Motion::Hold;
            }
            Err(why) => {
                self.publish();
                return Err(why.into());
            }
        }
        self.publish();
        Ok(())
    }
}

impl Toy {
    fn allowed(&mut self, goal: &JointState) -> Result<[f64; 2]> {
        if !self.cfg.has("moves unhomed") {
            self.operating.require_ready().map_err(|why| {
                if self.cfg.has("does not say what first") { "not now".to_string() } else { why.to_string() }
            })?;
        }
        let within = |q: &f64| q.abs() <= 0.2;
        let bad = goal.position.len() != 2 || !goal.position.iter().all(within);
        if bad && self.cfg.has("stops at a bad goal") {
            self.hold();
        }
        if bad && !self.cfg.has("takes any goal") {
            return Err("two positions within their limits, please".into());
        }
        Ok([goal.position[0], goal.position[1]])
    }

    fn publish(&mut self) {
        let stamp = self.host.now();
        self.at = JointState { stamp, position: List::of(&self.joints), ..JointState::default() };
        let before = self.now;
        self.now = self.operating.payload(stamp, None);
        let changed = (OperatingState { stamp, ..before }) != self.now;
        if changed && !self.cfg.has("tells nothing") {
            self.changed.emit(self.now);
        }
        if changed && self.cfg.has("tells twice") {
            self.changed.emit(self.now);
        }
    }
}

impl Component for Toy {
    fn step(&mut self, tick: &Tick) -> Result {
        let most = SPEED * tick.period_s();
        let moves = self.operating.mode() == OperatingMode::ENABLED;
        match &mut self.motion {
            Motion::To { goal, homing } if moves || self.cfg.has("coasts") => {
                for (at, goal) in self.joints.iter_mut().zip(&*goal) {
                    *at += (goal - *at).clamp(-most, most);
                }
                if self.joints == *goal {
                    if *homing {
                        self.operating.homed();
                    }
                    self.operating.move_ends();
                }
            }
            Motion::Velocity { m_s, left_s } if moves && *left_s > 0.0 => {
                *left_s -= tick.period_s();
                self.joints[0] = (self.joints[0] + *m_s * tick.period_s()).clamp(-0.2, 0.2);
            }
            _ => {}
        }
        self.publish();
        Ok(())
    }
    fn make_safe(&mut self) -> Result {
        if !self.cfg.has("ignores make_safe") {
            self.operating.made_safe();
        }
        if !self.cfg.has("coasts") && !self.cfg.has("resumes its motion") {
            self.motion = Motion::Hold;
        }
        self.publish();
        Ok(())
    }
}

/// Sends a small image in each step.
#[derive(Component)]
#[component(model = "stream", rate_hz = 50, safety = "sensor", provides("camera"))]
struct ToyCamera {
    #[output]
    image: Out<Frame<ImageHeader>>,
    #[event("camera")]
    frame_dropped: Event<u64>,
    #[state]
    sent: u64,
    #[state]
    left_out: u64,
    index: u64,
    #[config]
    cfg: Flawed,
}

#[provides("camera")]
impl ToyCamera {
    #[read]
    fn camera_geometry(_: &ToyCameraState) -> CameraGeometry {
        CameraGeometry { width: 4, height: 2, fps: 50.0 }
    }
    #[read]
    fn emitted(s: &ToyCameraState) -> u64 {
        s.sent
    }
}

impl Component for ToyCamera {
    fn configure(&mut self) -> Result {
        self.image.reserve(64, 4)
    }
    fn start(&mut self) -> Result {
        if !self.cfg.has("counts on") {
            (self.sent, self.left_out, self.index) = (0, 0, 0);
        }
        Ok(())
    }
    fn step(&mut self, tick: &Tick) -> Result {
        let index = self.index;
        let Ok(mut loan) = self.image.loan() else {
            self.left_out += 1;
            self.index += u64::from(!self.cfg.has("keeps the index"));
            let told = if self.cfg.has("tells each alone") { 1 } else { self.left_out };
            if !self.cfg.has("tells no loss") {
                self.frame_dropped.emit(told);
            }
            return Ok(());
        };
        let width = if self.cfg.has("grows") && index > 0 { 5 } else { 4 };
        let stride = if self.cfg.has("reaches beyond") { 40 } else { 8 };
        let format = PixelFormat::GRAY8;
        *loan.header_mut() = ImageHeader { stamp: tick.now(), index, width, height: 2, stride, format };
        loan.commit(16, tick.now());
        (self.index, self.sent) = (index + 1, self.sent + 1);
        Ok(())
    }
}

fn config(flaw: &str) -> String {
    json!({ "flaw": flaw }).to_string()
}

/// The sentence of a test that has to fail.
fn told(test: impl FnOnce() + std::panic::UnwindSafe) -> String {
    let failed = std::panic::catch_unwind(test).expect_err("the check let it pass");
    failed.downcast_ref::<String>().unwrap().clone()
}

fn names_the_rule(told: &str, rule: &str, flaw: &str) {
    assert!(
        told.contains(&format!("the rule (docs/INTERFACES.md): {rule}")),
        "`{flaw}` was told as:\n{told}"
    );
}

#[test]
fn an_arm_that_keeps_the_rules_passes() {
    let mut bench = Bench::<Toy>::new("{}");
    bench.assert_implements_as(&contracts::ARM, "left");
    assert_behaves_as_arm(&mut bench, "left");
}

#[test]
fn each_rule_of_arms_that_is_broken_is_named() {
    let flaws = [
        (0, "moves unhomed"),
        (0, "does not say what first"),
        (1, "takes any goal"),
        (1, "stops at a bad goal"),
        (2, "jumps"),
        (3, "runs on"),
        (4, "tells nothing"),
        (4, "tells twice"),
        (5, "a word is a fault"),
        (5, "refuses in silence"),
        (6, "ignores make_safe"),
        (6, "coasts"),
        (6, "resumes its motion"),
        (7, "takes old goals"),
    ];
    for (rule, flaw) in flaws {
        let told = told(|| assert_behaves_as_arm(&mut Bench::<Toy>::new(config(flaw)), "left"));
        assert!(told.starts_with("`left` does not behave as an arm: "), "{told}");
        names_the_rule(&told, contracts::ARM.rules[rule], flaw);
    }
}

#[test]
fn an_arm_that_is_not_active_is_not_judged() {
    let told = told(|| assert_behaves_as_arm(&mut Bench::<Toy>::ready("{}"), "left"));
    assert!(told.contains("it is not ACTIVE: give what `Bench::new` made"), "{told}");
}

#[test]
fn a_camera_that_keeps_the_rules_passes_also_after_it_ran() {
    assert_implements::<ToyCamera>(&contracts::CAMERA);
    let mut bench = Bench::<ToyCamera>::new("{}");
    assert_behaves_as_camera(&mut bench, "camera");
    bench.exhaust("image", true);
    bench.step(7);
    bench.exhaust("image", false);
    assert_behaves_as_camera(&mut bench, "camera");
}

#[test]
fn each_rule_of_cameras_that_is_broken_is_named() {
    let flaws = [
        (0, "keeps the index"),
        (0, "tells each alone"),
        (0, "tells no loss"),
        (0, "counts on"),
        (1, "grows"),
        (2, "reaches beyond"),
    ];
    for (rule, flaw) in flaws {
        let told = told(|| assert_behaves_as_camera(&mut Bench::<ToyCamera>::new(config(flaw)), "camera"));
        assert!(told.starts_with("`camera` does not behave as a camera: "), "{told}");
        names_the_rule(&told, contracts::CAMERA.rules[rule], flaw);
    }
}

#[test]
fn the_page_names_the_checks_there_are() {
    for contract in contracts::CONTRACTS {
        let there = match contract.name {
            "arm" => "assert_behaves_as_arm",
            "camera" => "assert_behaves_as_camera",
            _ => "",
        };
        assert_eq!(contract.tried_by, there, "{}", contract.name);
    }
}
