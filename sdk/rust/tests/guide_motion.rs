//! The component the plugin guide shows for motion: nalgebra's types, CRTK's names and its operating state.
#![cfg(feature = "nalgebra")]
#![allow(clippy::unwrap_used)]

use nalgebra::{Isometry3, Vector2, Vector3};
use trocar_sdk::crtk::{self, OperatingStateMachine, StateCommand};
use trocar_sdk::data::{JointState, Pose, Transform};
use trocar_sdk::prelude::*;
use trocar_sdk::testing::Bench;

/// Two joints behind CRTK names, and a tool that a tracker sees, as the arm's base sees it.
#[derive(Component)]
#[component(rate_hz = 200, provides("arm"))]
struct Table {
    #[input]
    tracked: In<Pose>,
    #[output]
    tool: Out<Transform>,
    #[state]
    measured_js: JointState,
    #[host]
    host: Host,
    joints: Vector2<f64>,
    operating: OperatingStateMachine,
    base_from_tracker: Isometry3<f64>,
}

#[provides("arm")]
impl Table {
    #[command(overflow = "latest_wins")]
    fn servo_jp(&mut self, goal: &JointState) -> Result {
        self.operating.require_ready()?; // The refusal says what to send first.
        crtk::require_in_time(goal.stamp, self.host.now(), 0.02)?; // A goal that lay in wait is none.
        self.joints = goal.positions()?; // Two finite numbers, or what is wrong.
        Ok(())
    }
    #[command]
    fn state_command(&mut self, word: &Text<32>) -> Result {
        if self.operating.command(word)? == StateCommand::Home {
            self.operating.homed();
        }
        Ok(())
    }
    #[read]
    fn measured_js(s: &TableState) -> JointState {
        s.measured_js
    }
}

impl Component for Table {
    fn step(&mut self, t: &Tick) -> Result {
        self.measured_js =
            JointState { stamp: t.now(), ..JointState::default() }.with_positions(&self.joints);
        let Some(Ok(tracked)) = self.tracked.fresh().map(|pose| pose.isometry()) else { return Ok(()) };
        self.tool.write(&Transform::between("base", "tool", self.base_from_tracker * tracked));
        Ok(())
    }
}

#[test]
fn the_table_moves_only_when_it_is_enabled_and_homed() {
    let mut bench = Bench::<Table>::new("{}");
    let goal = || JointState::default().with_positions(&Vector2::new(0.1, 0.2));
    let say = |bench: &mut Bench<Table>, word: &str| {
        bench.command::<Text<32>, ()>(&format!("arm/{}", crtk::STATE_COMMAND), word.into()).unwrap();
    };
    let refused = bench.command::<_, ()>("servo_jp", goal()).unwrap_err();
    assert!(refused.reason.contains("enable"), "{refused}");
    say(&mut bench, "enable");
    say(&mut bench, "home");
    bench.command::<_, ()>(crtk::SERVO_JP, goal()).unwrap();
    let three = JointState::default().with_positions(&Vector3::new(1.0, 2.0, 3.0));
    let refused = bench.command::<_, ()>("servo_jp", three).unwrap_err();
    assert_eq!(refused.reason, "position has 3 items, this arm has 2 joints: give one per joint");
    bench.step(1);
    let at: JointState = bench.read(crtk::MEASURED_JS, ()).unwrap();
    assert_eq!((at.positions::<2>().unwrap(), at.stamp), (Vector2::new(0.1, 0.2), bench.now()));
}

#[test]
fn a_tracked_tool_is_given_in_the_base_and_what_is_no_pose_is_left_out() {
    let mut bench = Bench::<Table>::new("{}");
    let seen = Pose::from(Isometry3::translation(0.1, 0.2, 0.3));
    bench.push("tracked", seen);
    bench.step(1);
    bench.push("tracked", Pose { orientation: [0.0; 4], ..seen });
    bench.step(1);
    let told = bench.outputs::<Transform>("tool");
    assert_eq!(told.len(), 1, "a pose without an orientation is none");
    assert_eq!((told[0].parent.as_str(), told[0].child.as_str(), told[0].pose), ("base", "tool", seen));
}
