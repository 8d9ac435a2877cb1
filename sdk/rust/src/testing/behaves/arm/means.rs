//! Tools for the checks of an arm: commands that must be taken, steps that are watched, and the sentence of a
//! failure.
//!
//! Invariant: after every command and step the events told are compared with the read, and setpoints with the
//! step before.

use super::super::super::bench::{Failure, Life};
use super::super::super::shape::Of;
use super::Arm;
use crate::call::Value;
use crate::class::Class;
use crate::data::{JointState, OperatingMode, OperatingState, Pose};
use crate::values::{List, Text};
use trocar_plugin_api::contracts::ARM;

/// Virtual time within which a motion has to end, ns.
const PATIENCE_NS: u64 = 120_000_000_000;
/// Part of the range, or of ten seconds' way, that a motion of a check goes.
const FAR: f64 = 0.1;
/// Rules that are watched in every check.
const NO_JUMP: &str = ARM.rules[2];
const TOLD_ONCE: &str = ARM.rules[4];

impl<C: Class> Arm<'_, C> {
    pub(super) fn check(&mut self, rule: usize, check: impl FnOnce(&mut Self)) {
        self.rule = ARM.rules[rule];
        check(self);
        self.expect(self.bench.life() == Life::Active, || format!("it is {} after that", self.bench.life()));
    }

    #[track_caller]
    pub(super) fn expect(&self, holds: bool, what: impl FnOnce() -> String) {
        if !holds {
            self.breaks(self.rule, &what());
        }
    }

    #[track_caller]
    pub(super) fn breaks(&self, rule: &str, what: &str) -> ! {
        let history = self.bench.history.text(&self.bench.shape);
        panic!(
            "`{}` does not behave as an arm: {what}\nthe rule (docs/INTERFACES.md): {rule}{history}",
            self.interface
        )
    }

    pub(super) fn path(&self, member: &str) -> String {
        format!("{}/{member}", self.interface)
    }

    pub(super) fn offers(&self, member: &str) -> bool {
        let path = self.path(member);
        self.bench.shape.members(Of::Commands).iter().any(|m| m.path == path)
    }

    pub(super) fn read<R: Value>(&self, member: &str) -> R {
        match self.bench.read(&self.path(member), ()) {
            Ok(value) => value,
            Err(why) => self.breaks(ARM.threads, &format!("{member} is refused: {why}")),
        }
    }

    pub(super) fn command<A: Value>(&mut self, member: &str, arg: A) -> Result<(), Failure> {
        let done = self.bench.command(&self.path(member), arg);
        self.watch();
        done
    }

    /// A command that must be taken.
    pub(super) fn send<A: Value>(&mut self, member: &str, arg: A) {
        let done = self.command(member, arg);
        self.expect(done.is_ok(), || format!("{member} is refused: {done:?}"));
    }

    pub(super) fn say(&mut self, word: &str) -> Result<(), Failure> {
        self.command::<Text<32>>("state_command", word.into())
    }

    /// A word that must be taken.
    pub(super) fn tell(&mut self, word: &str) {
        let done = self.say(word);
        self.expect(done.is_ok(), || format!("state_command `{word}` is refused: {done:?}"));
    }

    pub(super) fn go(&mut self, member: &str, goal: &[f64]) -> Result<(), Failure> {
        self.command(member, JointState { position: List::of(goal), ..JointState::default() })
    }

    /// A goal that must be taken.
    pub(super) fn moves(&mut self, member: &str, goal: &[f64]) {
        let done = self.go(member, goal);
        self.expect(done.is_ok(), || format!("{member} to {goal:?} is refused: {done:?}"));
    }

    /// Checks that every kind of motion is refused, with the command to send first.
    pub(super) fn refuses_motions(&mut self, first: &str) {
        let (at, tip) = (self.setpoint(), self.read::<Pose>("measured_cp"));
        let still = JointState { velocity: List::of(&vec![0.0; at.len()]), ..JointState::default() };
        let mut refused = vec![("servo_jp", self.go("servo_jp", &at)), ("move_jp", self.go("move_jp", &at))];
        if self.offers("servo_jv") {
            refused.push(("servo_jv", self.command("servo_jv", still)));
        }
        for member in ["servo_cp", "move_cp"] {
            if self.offers(member) {
                refused.push((member, self.command(member, tip)));
            }
        }
        let state = self.operating();
        for (member, done) in refused {
            let told = match done {
                Ok(()) => "it was taken".to_string(),
                Err(why) if why.reason.contains(first) => continue,
                Err(why) => format!("its refusal does not say `{first}`: {}", why.reason),
            };
            let homed = if state.is_homed.get() { "homed" } else { "not homed" };
            self.breaks(self.rule, &format!("{member} while it is {:?} and {homed}: {told}", state.state));
        }
    }

    pub(super) fn operating(&self) -> OperatingState {
        self.read("operating_state")
    }

    pub(super) fn stands(&self, mode: OperatingMode) {
        let state = self.operating().state;
        self.expect(state == mode, || format!("it is {state:?} and should be {mode:?}"));
    }

    pub(super) fn joints(&self) -> usize {
        self.limits.names.len()
    }

    pub(super) fn setpoint(&self) -> Vec<f64> {
        self.positions("setpoint_js")
    }

    pub(super) fn measured(&self) -> Vec<f64> {
        self.positions("measured_js")
    }

    pub(super) fn positions(&self, of: &str) -> Vec<f64> {
        let at = self.read::<JointState>(of).position.to_vec();
        let (n, have) = (self.joints(), at.len());
        self.expect(have == n, || format!("{of} has {have} positions of {n} joints"));
        at
    }

    /// Returns how far joint 0 goes in a check, with its sign: to the side with more room.
    pub(super) fn way(&self) -> f64 {
        let (lower, upper, at) = (self.limits.lower[0], self.limits.upper[0], self.setpoint()[0]);
        let far = (FAR * (upper - lower)).min(FAR * 10.0 * self.limits.speed[0]);
        if upper - at > at - lower { far } else { -far }
    }

    pub(super) fn away(&self) -> Vec<f64> {
        let mut goal = self.setpoint();
        goal[0] += self.way();
        goal
    }

    pub(super) fn is_at(&self, goal: &[f64]) -> bool {
        self.setpoint().iter().zip(goal).all(|(at, goal)| (at - goal).abs() < 1e-6)
    }

    pub(super) fn step(&mut self) {
        let done = self.bench.try_step();
        self.expect(done.is_ok(), || format!("its step failed: {done:?}"));
        self.watch();
        self.watch_setpoint();
    }

    pub(super) fn steps(&mut self, n: u64) {
        (0..n).for_each(|_| self.step());
    }

    /// Steps in so many seconds.
    pub(super) fn steps_in(&mut self, seconds: f64) -> u64 {
        let before = self.bench.now().ns();
        self.step();
        let period_ns = (self.bench.now().ns() - before).max(1);
        (seconds * 1e9 / period_ns as f64).ceil() as u64
    }

    pub(super) fn until(&mut self, what: &str, holds: impl Fn(&Self) -> bool) {
        let begin = self.bench.now().ns();
        while !holds(self) {
            self.step();
            let waited = self.bench.now().ns() - begin;
            self.expect(waited < PATIENCE_NS, || format!("two minutes were not enough for {what}"));
        }
    }

    /// Steps until joint 0 has gone this part of its way.
    pub(super) fn under_way(&mut self, start: &[f64], part: f64) {
        let (some, from) = ((part * self.way()).abs(), start[0]);
        self.until("a motion to set off", |arm| (arm.setpoint()[0] - from).abs() > some);
    }

    pub(super) fn comes_to_rest(&mut self) {
        let begin = self.bench.now().ns();
        loop {
            let at = self.setpoint();
            self.steps(5);
            if self.is_at(&at) {
                return;
            }
            let waited = self.bench.now().ns() - begin;
            self.expect(waited < PATIENCE_NS, || "it does not come to rest within two minutes".into());
        }
    }

    /// ENABLED, homed, and at rest.
    pub(super) fn ready(&mut self) {
        match self.operating().state {
            OperatingMode::ENABLED => {}
            OperatingMode::PAUSED => self.tell("resume"),
            _ => self.tell("enable"),
        }
        if !self.operating().is_homed.get() {
            self.tell("home");
        }
        self.until("homing", |arm| arm.operating().is_homed.get() && !arm.operating().is_busy.get());
        self.comes_to_rest();
    }

    pub(super) fn bring_to(&mut self, mode: OperatingMode) {
        self.tell("disable");
        if mode != OperatingMode::DISABLED {
            self.tell("enable");
        }
        if mode == OperatingMode::PAUSED {
            self.tell("pause");
        }
        self.stands(mode);
    }

    /// Checks that each event is a change, and that the last one equals the read.
    pub(super) fn watch(&mut self) {
        for event in self.bench.events::<OperatingState>(&self.path("operating_state")) {
            if same(&event, &self.told) {
                self.breaks(TOLD_ONCE, &format!("`operating_state` was told twice: {}", text(&event)));
            }
            self.told = event;
        }
        let now = self.operating();
        if now.state != OperatingMode::ENABLED {
            self.before = None;
        }
        if !same(&now, &self.told) {
            let (now, told) = (text(&now), text(&self.told));
            self.breaks(
                TOLD_ONCE,
                &format!("the read `operating_state` gives {now}, the last event said {told}"),
            );
        }
    }

    /// Checks that no joint's setpoint goes further in a step than its speed allows.
    pub(super) fn watch_setpoint(&mut self) {
        if self.operating().state != OperatingMode::ENABLED {
            self.before = None;
            return;
        }
        let (now, now_ns) = (self.setpoint(), self.bench.now().ns());
        if let Some((before, before_ns)) = &self.before {
            let dt_s = (now_ns - before_ns) as f64 * 1e-9;
            for (joint, (a, b)) in before.iter().zip(&now).enumerate() {
                let (way, most) = ((a - b).abs(), 1.01 * self.limits.speed[joint] * dt_s + 1e-9);
                if way > most {
                    let what =
                        format!("setpoint_js of joint {joint} went {way} in a step, its speed allows {most}");
                    self.breaks(NO_JUMP, &what);
                }
            }
        }
        self.before = Some((now, now_ns));
    }
}

/// Tells whether two states are equal in what is told when it changes.
pub(super) fn same(a: &OperatingState, b: &OperatingState) -> bool {
    (a.state, a.is_homed, a.is_busy) == (b.state, b.is_homed, b.is_busy)
}

fn text(state: &OperatingState) -> String {
    format!("{:?}, homed {}, busy {}", state.state, state.is_homed.get(), state.is_busy.get())
}
