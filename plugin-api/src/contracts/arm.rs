//! The contract of robot arms: the CRTK interface.
//!
//! Invariant: names are CRTK's, letter by letter. Members of CRTK beyond the required ones are listed as
//! optional, so that every arm that has them has them in the same form.

use super::{Command, Contract, Flows, Interface, Output, event, newest, read, void, write};

const ARM_COMMANDS: &[Command] = &[
    read(
        "measured_js",
        true,
        "JointState",
        "Joints as measured. All lists that are not empty have one item per joint.",
    ),
    read(
        "measured_cp",
        true,
        "Pose",
        "Pose of the tip as measured, with the stamp of the joints it was computed from.",
    ),
    read("setpoint_js", true, "JointState", "Where the joints are sent at this moment."),
    read("configuration_js", true, "JointConfiguration", "Names, kinds and limits of the joints."),
    read("operating_state", true, "OperatingState", "State of the device, and why after a fault."),
    newest(
        "servo_jp",
        true,
        "JointState",
        "Go to joint positions now; pre-empts. Only `position` is looked at.",
    ),
    write(
        "move_jp",
        true,
        "JointState",
        "Go to joint positions along a trajectory; busy until it has ended.",
    ),
    void("hold", true, "Brake and stay. Taken in every state."),
    write(
        "state_command",
        true,
        "text[32]",
        "`enable`, `disable`, `pause`, `resume`, `home`, `unhome`; any other word, or one the state does not allow, is refused with what is allowed.",
    ),
    read("measured_cv", false, "Twist", "Velocity of the tip."),
    read(
        "measured_cf",
        false,
        "Wrench",
        "Force and torque that the tip meets; a hand on a handle is `hand/measured_cf`.",
    ),
    read("measured_cs", false, "CartesianState", "Pose, twist and wrench of one instant."),
    read(
        "setpoint_cp",
        false,
        "Pose",
        "Where the tip is sent; stamp 0 while the motion is not position based.",
    ),
    read("setpoint_cv", false, "Twist", "How fast the tip is sent."),
    read("setpoint_cf", false, "Wrench", "Force and torque the arm is to give."),
    read("goal_js", false, "JointState", "Where the running motion ends."),
    read("goal_cp", false, "Pose", "Where the running motion ends."),
    read("goal_cv", false, "Twist", "The velocity asked for."),
    read("is_homed", false, "bool", "As in `operating_state`."),
    read("is_busy", false, "bool", "As in `operating_state`."),
    newest("servo_jr", false, "JointState", "Change the joint setpoint by this much now."),
    newest(
        "servo_jv",
        false,
        "JointState",
        "Move at joint velocities; holds by itself when it is not repeated.",
    ),
    newest(
        "servo_jf",
        false,
        "JointState",
        "Give joint forces and torques; holds by itself when it is not repeated.",
    ),
    newest("servo_cp", false, "Pose", "Go to a pose now."),
    newest("servo_cr", false, "Pose", "Change the pose setpoint by this much now."),
    newest("servo_cv", false, "Twist", "Move the tip; holds by itself when it is not repeated."),
    newest("servo_cf", false, "Wrench", "Give a force; holds by itself when it is not repeated."),
    newest(
        "interpolate_jp",
        false,
        "JointState",
        "Like `servo_jp`, for goals that come slowly: the arm fills the gaps.",
    ),
    newest("interpolate_jr", false, "JointState", "Like `servo_jr`, for goals that come slowly."),
    newest("interpolate_jv", false, "JointState", "Like `servo_jv`, for goals that come slowly."),
    newest("interpolate_jf", false, "JointState", "Like `servo_jf`, for goals that come slowly."),
    newest("interpolate_cp", false, "Pose", "Like `servo_cp`, for goals that come slowly."),
    newest("interpolate_cr", false, "Pose", "Like `servo_cr`, for goals that come slowly."),
    newest("interpolate_cv", false, "Twist", "Like `servo_cv`, for goals that come slowly."),
    newest("interpolate_cf", false, "Wrench", "Like `servo_cf`, for goals that come slowly."),
    write("move_jr", false, "JointState", "Like `move_jp`, from where the arm is."),
    write("move_cp", false, "Pose", "Go to a pose along a trajectory; busy until it has ended."),
    write("move_cr", false, "Pose", "Like `move_cp`, from where the arm is."),
    void("free", false, "Let go: the joints give way to a hand."),
];

const fn frame(name: &'static str, doc: &'static str) -> Interface {
    Interface { name, doc, required: false, commands: FRAME_COMMANDS, events: &[] }
}

const FRAME_COMMANDS: &[Command] = &[
    read("measured_cp", false, "Pose", "As in `arm`, in this frame."),
    read("measured_cv", false, "Twist", "As in `arm`, in this frame."),
    read("measured_cf", false, "Wrench", "As in `arm`, in this frame."),
    read("setpoint_cp", false, "Pose", "As in `arm`, in this frame."),
    newest("servo_cp", false, "Pose", "As in `arm`, in this frame."),
    newest("servo_cv", false, "Twist", "As in `arm`, in this frame."),
    newest("servo_cf", false, "Wrench", "As in `arm`, in this frame."),
];

/// A robot arm.
pub const ARM: Contract = Contract {
    name: "arm",
    doc: "A robot arm behind the names of the Collaborative Robotics Toolkit (CRTK).",
    safety: "actuator",
    frames: "Poses, twists and wrenches of `arm` are in the arm's base frame. Other frames are interfaces of their own, \
             `local` (relative to the arm's first link), `spatial` (the tip with the orientation of the base), `body` (the tip in its own frame). \
             A cartesian value that is computed from joints carries the joints' stamp; stamp 0 says that a value is not valid.",
    threads: "Reads are answered from the row of the last step, in the caller's thread, and never wait. Motions are queued \
              and taken at the next step; a goal that comes faster than the steps replaces the one before.",
    rules: &[
        "Motions are refused, with what to send first, until the arm is ENABLED and homed.",
        "A goal outside the limits of `configuration_js`, of another number of joints, or with a number that is not finite is \
         refused whole, and the running motion goes on.",
        "Every motion pre-empts the one before without a jump of the setpoint.",
        "A motion by velocity or force that is not repeated ends in a hold.",
        "`operating_state` is emitted once for each change of state, `is_homed` or `is_busy`, and is what the read gives.",
        "No word of `state_command` leads to FAULT; only the device's own trouble does, and the component stays ACTIVE and \
         answers.",
        "`make_safe` brakes at once; an enabled arm is PAUSED after it.",
        "A `servo_*` that lay in wait, a second or more by its stamp, or whose stamp is as far ahead of the host's clock, is refused; \
         the arm may be stricter. Stamp 0 says that the client gives none, and is taken as now.",
    ],
    tried_by: "assert_behaves_as_arm",
    interfaces: &[
        Interface {
            name: "arm",
            doc: "The arm in its base frame.",
            required: true,
            commands: ARM_COMMANDS,
            events: &[event(
                "operating_state",
                true,
                "OperatingState",
                "State, `is_homed` or `is_busy` changed.",
            )],
        },
        frame("local", "The arm relative to its first link."),
        frame("spatial", "The tip with the orientation of the base."),
        frame("body", "The tip in its own frame."),
        Interface {
            name: "hand",
            doc: "The hand on the arm's handle.",
            required: false,
            commands: &[read(
                "measured_cf",
                false,
                "Wrench",
                "Force and torque of the hand, with the orientation of the base; stamp 0 while there is none.",
            )],
            events: &[],
        },
        Interface {
            name: "compliance",
            doc: "Hands-on control.",
            required: false,
            commands: &[newest(
                "servo_cf",
                false,
                "Wrench",
                "Force to give beside the hand's; zero follows the hand.",
            )],
            events: &[],
        },
    ],
    outputs: &[Output {
        name: "state",
        doc: "Joints and tip, one sample per step.",
        required: false,
        one_of: &[Flows::Samples("ArmState")],
    }],
};
