//! Behaviour of an arm: the rules of `contracts::ARM`, tried one after the other on the bench.
//!
//! Invariant: every rule has its check, in the order of the contract. Setpoints and events are watched in all
//! of them, so a jump or an event too many is seen wherever it happens.

mod means;

use super::super::bench::{Bench, Life};
use crate::class::Class;
use crate::crtk::STATE_COMMANDS;
use crate::data::{JointConfiguration, JointState, OperatingMode, OperatingState, Pose};
use crate::values::{List, Stamp};
use means::same;
use trocar_plugin_api::contracts::ARM;

/// Fails the test, with the broken rule and the last events, unless the arm behind `interface` behaves as the
/// contract of arms says (`docs/INTERFACES.md`). The arm is ACTIVE, and free to move by a tenth of its range;
/// in the end it is ENABLED, somewhere else.
///
/// ```no_run
/// use trocar_sdk::testing::{Bench, assert_behaves_as_arm};
/// # use trocar_sdk::prelude::*;
/// # #[derive(Component)] struct EyeRobot {}
/// # impl Component for EyeRobot {}
/// assert_behaves_as_arm(&mut Bench::<EyeRobot>::new("{}"), "arm");
/// ```
pub fn assert_behaves_as_arm<C: Class>(bench: &mut Bench<C>, interface: &str) {
    const { assert!(ARM.rules.len() == 8, "every rule has its check") };
    let told = OperatingState::default();
    let limits = JointConfiguration::default();
    let arm = &mut Arm { bench, interface, rule: ARM.threads, limits, told, before: None };
    arm.begins();
    arm.rule = ARM.frames;
    arm.measures();
    arm.check(0, Arm::refuses_motions_until_it_is_ready);
    arm.check(1, Arm::refuses_bad_goals_whole);
    arm.check(2, Arm::pre_empts_without_a_jump);
    arm.check(3, Arm::holds_when_a_velocity_is_not_repeated);
    arm.check(4, Arm::tells_each_change_once);
    arm.check(5, Arm::takes_no_word_for_a_fault);
    arm.check(6, Arm::brakes_when_made_safe);
    arm.check(7, Arm::leaves_what_lay_in_wait);
}

/// Age of a servo command that no arm takes, ns.
const AGE_NS: u64 = 1_000_000_000;

struct Arm<'b, C: Class> {
    bench: &'b mut Bench<C>,
    interface: &'b str,
    /// Rule that is tried now, in the words of the contract.
    rule: &'static str,
    limits: JointConfiguration,
    /// The last event.
    told: OperatingState,
    /// Setpoint and time (ns) after the last step in which the arm was ENABLED.
    before: Option<(Vec<f64>, u64)>,
}

impl<C: Class> Arm<'_, C> {
    fn begins(&mut self) {
        self.expect(self.bench.life() == Life::Active, || {
            "it is not ACTIVE: give what `Bench::new` made".into()
        });
        self.bench.events::<OperatingState>(&self.path("operating_state"));
        self.told = self.operating();
        self.limits = self.read("configuration_js");
        let (n, of) = (self.joints(), &self.limits);
        let lists = [of.kinds.len(), of.lower.len(), of.upper.len(), of.speed.len()];
        self.expect(n > 0 && lists == [n; 4], || {
            format!("configuration_js names {n} joints, and its kinds, lower, upper and speed have {lists:?} items")
        });
    }

    fn measures(&mut self) {
        self.step();
        let (joints, tip): (JointState, Pose) = (self.read("measured_js"), self.read("measured_cp"));
        self.expect(joints.stamp.is_valid() && joints.position.len() == self.joints(), || {
            format!("measured_js after a step is {joints:?}")
        });
        self.expect(tip.stamp == joints.stamp, || {
            format!("measured_cp has stamp {} and measured_js {}", tip.stamp.ns(), joints.stamp.ns())
        });
        let length = tip.orientation.iter().map(|q| q * q).sum::<f64>().sqrt();
        self.expect((length - 1.0).abs() < 1e-3, || {
            format!("the orientation of measured_cp is {length} long")
        });
    }

    fn refuses_motions_until_it_is_ready(&mut self) {
        self.tell("disable");
        self.stands(OperatingMode::DISABLED);
        self.refuses_motions("enable");
        self.tell("unhome");
        self.tell("enable");
        self.stands(OperatingMode::ENABLED);
        self.refuses_motions("home");
        self.ready();
        self.moves("servo_jp", &self.setpoint());
    }

    fn refuses_bad_goals_whole(&mut self) {
        self.ready();
        let (start, goal) = (self.setpoint(), self.away());
        self.moves("move_jp", &goal);
        self.under_way(&start, 0.2);
        let (mut beyond, mut nothing, mut longer) = (goal.clone(), goal.clone(), goal.clone());
        beyond[0] = self.limits.upper[0] + (self.limits.upper[0] - self.limits.lower[0]).max(1.0);
        nothing[0] = f64::NAN;
        longer.push(0.0);
        let bad =
            [(beyond, "outside its limits"), (nothing, "that is no number"), (longer, "of one joint more")];
        for member in ["servo_jp", "move_jp"] {
            for (goal, what) in &bad {
                let done = self.go(member, goal);
                self.expect(done.is_err(), || format!("{member} took a goal {what}: {goal:?}"));
                self.expect(self.operating().is_busy.get(), || {
                    format!("a goal {what}, refused by {member}, ended the running motion")
                });
            }
        }
        self.until("the running motion to end", |arm| !arm.operating().is_busy.get());
        self.expect(self.is_at(&goal), || format!("it went to {:?} instead of {goal:?}", self.setpoint()));
    }

    fn pre_empts_without_a_jump(&mut self) {
        self.ready();
        let (start, goal) = (self.setpoint(), self.away());
        self.moves("move_jp", &goal);
        self.under_way(&start, 0.2);
        self.moves("servo_jp", &start);
        self.steps(20);
        self.expect(!self.operating().is_busy.get(), || {
            "it is busy with a motion that was pre-empted".into()
        });
        let start = self.setpoint();
        self.moves("move_jp", &goal);
        self.under_way(&start, 0.2);
        self.send("hold", ());
        self.until("`hold` to end the motion", |arm| !arm.operating().is_busy.get());
        self.comes_to_rest();
        self.expect(!self.is_at(&goal), || "it went on to its goal after `hold`".into());
    }

    fn holds_when_a_velocity_is_not_repeated(&mut self) {
        if !self.offers("servo_jv") {
            return;
        }
        self.ready();
        let (start, way) = (self.setpoint(), self.way());
        let mut velocity = vec![0.0; start.len()];
        velocity[0] = self.limits.speed[0].copysign(way) / 4.0;
        let goal = JointState { velocity: List::of(&velocity), ..JointState::default() };
        self.send("servo_jv", goal);
        self.under_way(&start, 1e-6);
        self.comes_to_rest();
        let (at, ends) = (self.setpoint()[0], [self.limits.lower[0], self.limits.upper[0]]);
        self.expect(ends.iter().all(|end| (end - at).abs() > 1e-6), || {
            format!("one servo_jv took joint 0 to the end of its range, {at}")
        });
        self.stands(OperatingMode::ENABLED);
    }

    fn tells_each_change_once(&mut self) {
        self.ready();
        // Each entry compares the events with the read.
        for word in ["pause", "pause", "resume"] {
            self.tell(word);
            self.steps(5);
        }
        self.moves("move_jp", &self.away());
        self.expect(self.told.is_busy.get(), || "a move that sets off is not told as `is_busy`".into());
        self.until("the motion to end", |arm| !arm.operating().is_busy.get());
        self.expect(!self.told.is_busy.get(), || "the end of a motion was not told".into());
    }

    fn takes_no_word_for_a_fault(&mut self) {
        for mode in [OperatingMode::DISABLED, OperatingMode::ENABLED, OperatingMode::PAUSED] {
            for word in STATE_COMMANDS.map(|(word, _)| word).into_iter().chain(["fly", ""]) {
                self.bring_to(mode);
                let before = self.operating();
                let done = self.say(word);
                let after = self.operating();
                self.expect(after.state != OperatingMode::FAULT, || {
                    format!("`{word}` in {mode:?} led to FAULT")
                });
                if let Err(refused) = done {
                    // `enable` or `disable` is allowed in every state.
                    self.expect(same(&before, &after), || {
                        format!("`{word}`, refused in {mode:?}, changed it")
                    });
                    self.expect(refused.reason.contains("able"), || {
                        format!("the refusal of `{word}` in {mode:?} does not say what is allowed: {refused}")
                    });
                } else {
                    let known = !["fly", ""].contains(&word);
                    self.expect(known, || format!("`{word}` is no state command and was taken"));
                }
            }
            self.bring_to(mode);
            self.send("hold", ());
        }
    }

    fn brakes_when_made_safe(&mut self) {
        self.ready();
        let start = self.setpoint();
        self.moves("move_jp", &self.away());
        self.under_way(&start, 0.2);
        let (at, speed) = (self.measured(), self.limits.speed[0]);
        let done = self.bench.make_safe();
        self.expect(done.is_ok(), || format!("make_safe is refused: {done:?}"));
        self.before = None;
        self.watch();
        self.stands(OperatingMode::PAUSED);
        self.refuses_motions("resume");
        let half = self.steps_in(0.5);
        self.steps(half);
        let braked = (self.measured()[0] - at[0]).abs();
        self.expect(braked <= 0.05 * speed, || format!("joint 0 went on for {braked} after make_safe"));
        let stood = self.measured()[0];
        self.steps(half);
        let crept = (self.measured()[0] - stood).abs();
        self.expect(crept <= 0.005 * speed, || {
            format!("joint 0 crept on by {crept} in half a second after that")
        });
        self.tell("resume");
        self.stands(OperatingMode::ENABLED);
        let rests = self.setpoint();
        self.steps(20);
        self.expect(self.is_at(&rests), || "`resume` took up the motion that make_safe ended".into());
    }

    fn leaves_what_lay_in_wait(&mut self) {
        self.ready();
        let (rests, goal, sent) = (self.setpoint(), self.away(), self.bench.now());
        self.bench.advance(AGE_NS);
        self.steps(1);
        let ahead = Stamp::from_ns(self.bench.now().ns() + AGE_NS);
        for (stamp, what) in [(sent, "sent more than a second ago"), (ahead, "stamped a second ahead")] {
            let goal = JointState { stamp, position: List::of(&goal), ..JointState::default() };
            let done = self.command("servo_jp", goal);
            self.expect(done.is_err(), || format!("it took a servo_jp {what}"));
        }
        self.steps(20);
        self.expect(self.is_at(&rests), || "it went where a servo_jp sent it that it had refused".into());
        for stamp in [self.bench.now(), Stamp::INVALID] {
            let goal = JointState { stamp, position: List::of(&rests), ..JointState::default() };
            self.send("servo_jp", goal);
        }
    }
}
