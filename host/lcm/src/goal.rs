//! The kind of goal that a command gives its component: how long it may wait depends on that.
//!
//! Invariant: pure; a command that lets a device rest is no goal.

use trocar_model::{Command, Type};

/// The kind of goal a command gives its component.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Goal {
    /// None: the command carries only text, choices or flags, or no argument, like a command that stops a
    /// device.
    #[default]
    None,
    /// Numbers, which are valid at the time they are sent.
    Numbers,
    /// A goal of a stream that is renewed all the time, CRTK's `servo_*`.
    Servo,
    /// A word to CRTK's `state_command`, where [`Goal::with`] has not looked at it yet.
    State,
}

/// Words of `state_command` after which a device moves, or follows goals again. The others let it rest.
const IN_MOTION: [&[u8]; 3] = [b"enable", b"resume", b"home"];

impl Goal {
    pub(super) fn of(command: &Command) -> Goal {
        let Some(arg) = command.arg.as_ref().filter(|_| !command.kind.is_read()) else { return Goal::None };
        if command.name == "state_command" && matches!(arg.ty, Type::Text { .. }) {
            Goal::State
        } else if !arg.ty.has_numbers() {
            Goal::None
        } else if command.name.starts_with("servo_") {
            Goal::Servo
        } else {
            Goal::Numbers
        }
    }

    /// The goal with this argument: a word that lets a device rest is no goal. Real-time.
    pub(super) fn with(self, arg: &[u8]) -> Goal {
        if self == Goal::State && !IN_MOTION.contains(&text(arg)) { Goal::None } else { self }
    }
}

/// The bytes of a text as laid out: its length, then room for the longest one.
fn text(arg: &[u8]) -> &[u8] {
    let Some((length, room)) = arg.split_first_chunk() else { return &[] };
    let length = usize::try_from(u64::from_ne_bytes(*length)).unwrap_or(usize::MAX);
    room.get(..length).unwrap_or_default()
}
