//! Every CRTK name a device may offer, with the payload it carries.
//!
//! Invariant: one line per name; the constants and [`NAMES`] come from the same line.

/// Form in which a name is offered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// A read.
    Query,
    /// A write (a void one when it carries nothing).
    Command,
    /// A read and an event of one name: asked for now, told when it changes.
    QueryAndEvent,
}

/// A name of the convention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Name {
    /// The name itself, such as "measured_js".
    pub name: &'static str,
    /// The form in which a device offers it.
    pub used_as: Use,
    /// The standard payload, as in [`crate::data`]; empty for none.
    pub payload: &'static str,
}

/// The entry of a name; none when the convention has no such name.
pub fn name(name: &str) -> Option<&'static Name> {
    NAMES.iter().find(|n| n.name == name)
}

macro_rules! names {
    ($($constant:ident $name:literal $used_as:ident $payload:literal;)*) => {
        $(#[doc = concat!("`", $name, "`, payload `", $payload, "`.")] pub const $constant: &str = $name;)*
        /// All names.
        pub const NAMES: &[Name] =
            &[$(Name { name: $name, used_as: Use::$used_as, payload: $payload }),*];
    };
}

names! {
    MEASURED_JS "measured_js" Query "JointState";
    MEASURED_CP "measured_cp" Query "Pose";
    MEASURED_CV "measured_cv" Query "Twist";
    MEASURED_CF "measured_cf" Query "Wrench";
    MEASURED_CS "measured_cs" Query "CartesianState";
    SETPOINT_JS "setpoint_js" Query "JointState";
    SETPOINT_CP "setpoint_cp" Query "Pose";
    SETPOINT_CV "setpoint_cv" Query "Twist";
    SETPOINT_CF "setpoint_cf" Query "Wrench";
    GOAL_JS "goal_js" Query "JointState";
    GOAL_CP "goal_cp" Query "Pose";
    GOAL_CV "goal_cv" Query "Twist";
    CONFIGURATION_JS "configuration_js" Query "JointConfiguration";
    SERVO_JP "servo_jp" Command "JointState";
    SERVO_JR "servo_jr" Command "JointState";
    SERVO_JV "servo_jv" Command "JointState";
    SERVO_JF "servo_jf" Command "JointState";
    SERVO_CP "servo_cp" Command "Pose";
    SERVO_CR "servo_cr" Command "Pose";
    SERVO_CV "servo_cv" Command "Twist";
    SERVO_CF "servo_cf" Command "Wrench";
    INTERPOLATE_JP "interpolate_jp" Command "JointState";
    INTERPOLATE_JR "interpolate_jr" Command "JointState";
    INTERPOLATE_JV "interpolate_jv" Command "JointState";
    INTERPOLATE_JF "interpolate_jf" Command "JointState";
    INTERPOLATE_CP "interpolate_cp" Command "Pose";
    INTERPOLATE_CR "interpolate_cr" Command "Pose";
    INTERPOLATE_CV "interpolate_cv" Command "Twist";
    INTERPOLATE_CF "interpolate_cf" Command "Wrench";
    MOVE_JP "move_jp" Command "JointState";
    MOVE_JR "move_jr" Command "JointState";
    MOVE_CP "move_cp" Command "Pose";
    MOVE_CR "move_cr" Command "Pose";
    HOLD "hold" Command "";
    FREE "free" Command "";
    STATE_COMMAND "state_command" Command "Text";
    OPERATING_STATE "operating_state" QueryAndEvent "OperatingState";
    IS_HOMED "is_homed" Query "Flag";
    IS_BUSY "is_busy" Query "Flag";
}
