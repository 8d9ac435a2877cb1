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

/// Longest wait of a goal that was only sent to an actuator, ns, if its connection gives no deadline; or so
/// many of the actuator's own periods, if those are longer.
const GOAL_NS: u64 = 100_000_000;
const GOAL_PERIODS: u64 = 3;
/// Likewise for a stream of goals, ns: a machine without real-time threads is late by some milliseconds.
const SERVO_NS: u64 = 10_000_000;

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

    /// Longest wait of a goal that was only sent, ns; `None`: no limit. `said_ns` is the deadline of its
    /// connection and `period_ns` that of the component's own grid, 0 without one. Real-time.
    pub(super) fn may_wait_ns(self, said_ns: u64, is_actuator: bool, period_ns: u64) -> Option<u64> {
        let periods_ns = GOAL_PERIODS * period_ns;
        match self {
            Goal::None => None,
            _ if said_ns > 0 => Some(said_ns),
            _ if !is_actuator => None,
            Goal::Numbers | Goal::State => Some(GOAL_NS.max(periods_ns)),
            Goal::Servo if periods_ns > 0 => Some(SERVO_NS.max(periods_ns)),
            Goal::Servo => Some(GOAL_NS),
        }
    }
}

/// The bytes of a text as laid out: its length, then room for the longest one.
fn text(arg: &[u8]) -> &[u8] {
    let Some((length, room)) = arg.split_first_chunk() else { return &[] };
    let length = usize::try_from(u64::from_ne_bytes(*length)).unwrap_or(usize::MAX);
    room.get(..length).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::Goal;

    const MS: u64 = 1_000_000;

    #[test]
    fn a_goal_waits_for_an_actuator_100_ms_and_one_of_a_stream_three_periods_unless_its_connection_says() {
        use Goal::{None as Words, Numbers, Servo, State};
        // Columns: goal, deadline of its connection, whether it moves something, period; longest wait. All in
        // ms.
        for (goal, said, actuator, period, longest) in [
            (Numbers, 0, true, 0, Some(100)),
            (Numbers, 0, true, 1, Some(100)),
            (Numbers, 0, true, 33, Some(100)),
            (Numbers, 0, true, 50, Some(150)),
            (Servo, 0, true, 5, Some(15)),
            (Servo, 0, true, 50, Some(150)),
            // A machine without real-time threads is late by so much.
            (Servo, 0, true, 1, Some(10)),
            (Servo, 0, true, 0, Some(100)),
            (Numbers, 20, true, 1, Some(20)),
            (Servo, 20, true, 1, Some(20)),
            (Servo, 500, false, 1, Some(500)),
            // A word that sets it in motion is a goal like any other.
            (State, 0, true, 1, Some(100)),
            (State, 20, true, 1, Some(20)),
            (State, 0, false, 1, None),
            (Numbers, 0, false, 1, None),
            (Servo, 0, false, 1, None),
            // A stop is right however late it comes.
            (Words, 20, true, 1, None),
            (Words, 0, true, 0, None),
        ] {
            let case = format!("{goal:?}, {said} ms said, actuator {actuator}, period {period} ms");
            let answer = goal.may_wait_ns(said * MS, actuator, period * MS);
            assert_eq!(answer, longest.map(|ms: u64| ms * MS), "{case}");
        }
    }
}
