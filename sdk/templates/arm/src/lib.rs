//! An arm behind the standard interface (docs/INTERFACES.md#arm): change joints and kinematics here,
//! the motors in `drive.rs`.
#![forbid(unsafe_code)]

mod drive;

use drive::Drive;
use trocar_sdk::crtk::{self, OperatingStateMachine, StateCommand};
use trocar_sdk::data::{ArmState, JointConfiguration, JointKind, JointState, OperatingState, Pose};
use trocar_sdk::prelude::*;

/// CHANGE THIS: three slides along x, y and z.
const NAMES: [&str; 3] = ["x", "y", "z"];
type Joints = [f64; NAMES.len()];

/// A servo command that is older by its stamp lay in wait, and is refused, s.
const OLDEST_S: f64 = 0.1;

/// The settings.
#[derive(Config)]
struct Settings {
    /// End of each slide's travel, to both sides
    #[config(min = 0.001, max = 1.0, unit = "m", default = 0.05)]
    travel_m: f64,
    /// Highest speed of each slide
    #[config(min = 0.0001, max = 1.0, unit = "m/s", default = 0.02)]
    speed_m_s: f64,
}

/// A simulated arm with three slides.
#[derive(Component)]
#[component(
    name = "{{crate}}",
    rate_hz = 1000,
    safety = "actuator",
    models("periodic"),
    rates_hz(100, 8000)
)]
struct {{Name}} {
    #[output]
    state: Out<ArmState>,
    #[event("arm", name = "operating_state")]
    changed: Event<OperatingState>,
    #[state]
    measured_js: JointState,
    #[state]
    measured_cp: Pose,
    #[state]
    setpoint_js: JointState,
    #[state]
    configuration_js: JointConfiguration,
    #[state]
    operating_state: OperatingState,
    #[config]
    settings: Settings,
    #[host]
    host: Host,
    drive: Drive,
    operating: OperatingStateMachine,
    setpoint: Joints,
    goal: Joints,
}

/// The names of the Collaborative Robotics Toolkit (CRTK); reads are answered from the row of the last step.
#[provides("arm")]
impl {{Name}} {
    #[read]
    fn measured_js(s: &{{Name}}State) -> JointState {
        s.measured_js
    }
    #[read]
    fn measured_cp(s: &{{Name}}State) -> Pose {
        s.measured_cp
    }
    #[read]
    fn setpoint_js(s: &{{Name}}State) -> JointState {
        s.setpoint_js
    }
    #[read]
    fn configuration_js(s: &{{Name}}State) -> JointConfiguration {
        s.configuration_js
    }
    #[read]
    fn operating_state(s: &{{Name}}State) -> OperatingState {
        s.operating_state
    }

    /// Goes to joint positions now; the next one takes its place.
    #[command(overflow = "latest_wins")]
    fn servo_jp(&mut self, goal: &JointState) -> Result {
        crtk::require_in_time(goal.stamp, self.host.now(), OLDEST_S)?;
        self.goal = self.checked(goal)?;
        self.operating.move_ends(); // The move that ran is pre-empted.
        self.tell();
        Ok(())
    }

    /// Goes to joint positions; busy until it is there.
    #[command]
    fn move_jp(&mut self, goal: &JointState) -> Result {
        self.goal = self.checked(goal)?;
        self.operating.move_begins();
        self.tell();
        Ok(())
    }

    /// Brakes and stays.
    #[command]
    fn hold(&mut self) {
        self.goal = self.setpoint;
        self.operating.move_ends();
        self.tell();
    }

    /// `enable`, `disable`, `pause`, `resume`, `home`, `unhome`; each of them ends a motion.
    #[command]
    fn state_command(&mut self, word: &Text<32>) -> Result {
        if self.operating.command(word)? == StateCommand::Home {
            self.operating.homed(); // Absolute encoders; an arm without them finds its home in `step`.
        }
        self.hold();
        Ok(())
    }
}

impl {{Name}} {
    /// A goal that may be gone to; a refused one leaves everything as it is.
    fn checked(&self, goal: &JointState) -> Result<Joints> {
        self.operating.require_ready()?; // The refusal says what to send first.
        let (have, travel) = (goal.position.len(), self.settings.travel_m);
        let goal = Joints::try_from(&goal.position[..]).map_err(|_| {
            format!(
                "position needs {} items, one per joint: it has {have}",
                NAMES.len()
            )
        })?;
        // A number that is none is in no range.
        match goal.iter().position(|q| !(-travel..=travel).contains(q)) {
            Some(i) => Err(format!(
                "{}: {} m is not within -{travel} to {travel} m",
                NAMES[i], goal[i]
            )
            .into()),
            None => Ok(goal),
        }
    }

    /// Tells the operating state, once for each change.
    fn tell(&mut self) {
        let now = self.operating.payload(self.host.now(), None);
        let same = OperatingState {
            stamp: now.stamp,
            ..self.operating_state
        } == now;
        self.operating_state = now;
        if !same {
            self.changed.emit(now);
        }
    }
}

impl Component for {{Name}} {
    fn configure(&mut self) -> Result {
        let Settings {
            travel_m,
            speed_m_s,
        } = self.settings;
        self.configuration_js = JointConfiguration {
            stamp: self.host.now(),
            names: List::of(&NAMES.map(Text::new)),
            kinds: List::of(&NAMES.map(|_| JointKind::PRISMATIC)),
            lower: List::of(&NAMES.map(|_| -travel_m)),
            upper: List::of(&NAMES.map(|_| travel_m)),
            speed: List::of(&NAMES.map(|_| speed_m_s)),
            ..JointConfiguration::default()
        };
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let most = self.settings.speed_m_s * tick.period_s();
        for (at, goal) in self.setpoint.iter_mut().zip(self.goal) {
            *at += (goal - *at).clamp(-most, most);
        }
        if self.operating.is_busy() && self.setpoint == self.goal {
            self.operating.move_ends();
        }
        let (stamp, measured) = (tick.now(), self.drive.exchange(&self.setpoint));
        let joints = |q: &Joints| JointState {
            stamp,
            position: List::of(q),
            ..JointState::default()
        };
        (self.setpoint_js, self.measured_js) = (joints(&self.setpoint), joints(&measured));
        self.measured_cp = Pose {
            stamp,
            position: measured,
            ..Pose::default()
        };
        let (measured_js, measured_cp) = (self.measured_js, self.measured_cp);
        self.state.write(&ArmState {
            stamp,
            measured_js,
            measured_cp,
            ..ArmState::default()
        });
        self.tell();
        Ok(())
    }

    /// Called on every way out: Stop, a fault, a lost peer. It is short, waits for nothing, may come twice.
    fn make_safe(&mut self) -> Result {
        self.goal = self.setpoint;
        self.drive.brake();
        self.operating.made_safe();
        self.tell();
        Ok(())
    }
}

trocar_plugin!({{Name}});

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_sdk::testing::{Bench, assert_behaves_as_arm, assert_implements, contracts};

    trocar_sdk::testing::count_allocations!();

    fn ready() -> Bench<{{Name}}> {
        let mut bench = Bench::<{{Name}}>::new("{}");
        for word in ["enable", "home"] {
            bench
                .command::<Text<32>, ()>("state_command", word.into())
                .unwrap();
        }
        bench
    }

    fn to(position: &[f64]) -> JointState {
        JointState {
            position: List::of(position),
            ..JointState::default()
        }
    }

    #[test]
    fn it_has_what_the_contract_of_arms_asks_for_and_does_what_it_says() {
        assert_implements::<{{Name}}>(&contracts::ARM);
        assert_behaves_as_arm(&mut Bench::<{{Name}}>::new("{}"), "arm");
    }

    #[test]
    fn a_move_keeps_to_the_speed_and_ends_at_its_goal() {
        let mut bench = ready();
        bench
            .command::<_, ()>("move_jp", to(&[0.01, 0.0, -0.02]))
            .unwrap();
        bench.step(100);
        let half: JointState = bench.read("setpoint_js", ()).unwrap();
        bench.expect(
            (half.position[0] - 0.002).abs() < 1e-9,
            "20 mm/s for 0.1 s are 2 mm",
        );
        bench.step(1000);
        let tip: Pose = bench.read("measured_cp", ()).unwrap();
        bench.expect(
            (tip.position[2] + 0.02).abs() < 1e-6,
            "the tip is where the joints are",
        );
    }

    #[test]
    fn a_goal_out_of_reach_is_refused_with_the_joint_and_what_is_within() {
        let mut bench = ready();
        let refused = bench
            .command::<_, ()>("servo_jp", to(&[0.0, 0.06, 0.0]))
            .unwrap_err();
        assert_eq!(refused.reason, "y: 0.06 m is not within -0.05 to 0.05 m");
        let refused = bench.command::<_, ()>("servo_jp", to(&[0.0])).unwrap_err();
        assert_eq!(
            refused.reason,
            "position needs 3 items, one per joint: it has 1"
        );
    }

    #[test]
    fn a_step_and_a_servo_command_allocate_nothing() {
        let mut bench = ready();
        bench.assert_no_alloc(|bench| {
            bench.command::<_, ()>("servo_jp", to(&[0.001; 3])).unwrap();
            bench.step(100);
        });
    }
}
