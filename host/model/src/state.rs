//! The states of a component and the one table of allowed transitions.
//!
//! Invariant: no other place decides whether a verb is allowed; a refusal lists what is allowed from here.

use std::fmt;

/// Reason why a component stands still.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StopReason {
    Requested,
    Restarted,
    Interlock,
    PeerLost,
}

/// State of a component. FAULT carries its reason beside the state, in what the LCM reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    Created,
    Ready,
    Active,
    Stopped(StopReason),
    Fault,
}

/// Health, beside the state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Health {
    #[default]
    Ok,
    Overrun,
    StaleInput,
    Unresponsive,
    Lost,
}

/// Verbs for a component that exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Verb {
    Configure,
    Start,
    Stop,
    Resume,
    Reset,
    Remove,
}

impl Verb {
    pub const ALL: [Verb; 6] =
        [Verb::Configure, Verb::Start, Verb::Stop, Verb::Resume, Verb::Reset, Verb::Remove];
}

impl State {
    /// Every state, for tables and tests.
    pub const ALL: [State; 8] = [
        State::Created,
        State::Ready,
        State::Active,
        State::Stopped(StopReason::Requested),
        State::Stopped(StopReason::Restarted),
        State::Stopped(StopReason::Interlock),
        State::Stopped(StopReason::PeerLost),
        State::Fault,
    ];
}

/// Returns the state `verb` leads to from `state`; `None` = not allowed.
///
/// | from | Configure | Start | Stop | Resume | Reset | Remove |
/// |---|---|---|---|---|---|---|
/// | CREATED | READY | – | same | – | – | gone |
/// | READY | READY | ACTIVE | same | – | READY | gone |
/// | ACTIVE | ACTIVE, live settings only | – | STOPPED{requested} | – | READY | gone |
/// | STOPPED{restarted} | READY | ACTIVE, fresh | STOPPED{requested} | ACTIVE, state kept | READY | gone |
/// | STOPPED{other} | READY | ACTIVE, fresh | same, reason kept | ACTIVE, state kept | READY | gone |
/// | FAULT | – | – | same | – | READY | gone |
///
/// *State kept* is the run-time state; a *fresh* start makes it anew.
///
/// Stop is never refused: where nothing runs it changes nothing, and it keeps the reason of a STOPPED
/// component so that an interlock is not forgotten. A component that stands only because its process was
/// restarted may be resumed by itself, but not once it was stopped by request. For Remove the answer is the
/// state the component is in when it goes.
pub fn transition(state: State, verb: Verb) -> Option<State> {
    use State::{Active, Created, Fault, Ready, Stopped};
    match (verb, state) {
        (Verb::Configure, Created | Ready | Stopped(_)) => Some(Ready),
        (Verb::Configure, Active) => Some(Active),
        (Verb::Start, Ready | Stopped(_)) => Some(Active),
        (Verb::Stop, Active | Stopped(StopReason::Restarted)) => Some(Stopped(StopReason::Requested)),
        (Verb::Resume, Stopped(_)) => Some(Active),
        (Verb::Reset, Ready | Active | Stopped(_) | Fault) => Some(Ready),
        (Verb::Stop | Verb::Remove, other) => Some(other),
        (Verb::Configure, Fault)
        | (Verb::Start, Created | Active | Fault)
        | (Verb::Resume, Created | Ready | Active | Fault)
        | (Verb::Reset, Created) => None,
    }
}

/// Returns the verbs that may be asked in `state`, without a Stop that would change nothing.
pub fn allowed(state: State) -> Vec<Verb> {
    let useful = |verb: &Verb| match transition(state, *verb) {
        Some(to) => *verb != Verb::Stop || to != state,
        None => false,
    };
    Verb::ALL.into_iter().filter(useful).collect()
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            StopReason::Requested => "requested",
            StopReason::Restarted => "restarted",
            StopReason::Interlock => "interlock",
            StopReason::PeerLost => "peer_lost",
        })
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            State::Created => f.write_str("CREATED"),
            State::Ready => f.write_str("READY"),
            State::Active => f.write_str("ACTIVE"),
            State::Stopped(reason) => write!(f, "STOPPED{{{reason}}}"),
            State::Fault => f.write_str("FAULT"),
        }
    }
}

impl fmt::Display for Health {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Health::Ok => "OK",
            Health::Overrun => "OVERRUN",
            Health::StaleInput => "STALE_INPUT",
            Health::Unresponsive => "UNRESPONSIVE",
            Health::Lost => "LOST",
        })
    }
}

impl fmt::Display for Verb {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Verb::Configure => "Configure",
            Verb::Start => "Start",
            Verb::Stop => "Stop",
            Verb::Resume => "Resume",
            Verb::Reset => "Reset",
            Verb::Remove => "Remove",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_state_answers_every_verb_and_only_with_what_the_table_says() {
        for state in State::ALL {
            for verb in Verb::ALL {
                let to = transition(state, verb);
                match verb {
                    Verb::Stop | Verb::Remove => assert!(to.is_some(), "{verb} must be allowed from {state}"),
                    Verb::Start | Verb::Resume => {
                        assert!(matches!(to, None | Some(State::Active)), "{state} {verb}")
                    }
                    Verb::Reset => assert!(matches!(to, None | Some(State::Ready)), "{state} {verb}"),
                    Verb::Configure => assert!(
                        matches!(to, None | Some(State::Ready | State::Active)),
                        "{state} {verb} leads to {to:?}"
                    ),
                }
            }
        }
    }

    #[test]
    fn a_fault_leaves_only_by_reset_or_remove() {
        assert_eq!(allowed(State::Fault), [Verb::Reset, Verb::Remove]);
    }

    #[test]
    fn stop_keeps_the_reason_of_a_component_that_already_stands() {
        let stopped = State::Stopped(StopReason::Interlock);
        assert_eq!(
            transition(stopped, Verb::Stop),
            Some(stopped),
            "an interlock must not turn into a request"
        );
    }

    #[test]
    fn what_would_go_on_by_itself_does_not_once_somebody_stopped_it() {
        let stopped = State::Stopped(StopReason::Restarted);
        assert_eq!(transition(stopped, Verb::Stop), Some(State::Stopped(StopReason::Requested)));
        assert!(allowed(stopped).contains(&Verb::Stop), "{:?}", allowed(stopped));
    }

    #[test]
    fn start_from_stopped_is_allowed_for_every_reason_when_asked_by_name() {
        for state in State::ALL {
            if let State::Stopped(_) = state {
                assert_eq!(transition(state, Verb::Start), Some(State::Active), "{state}");
            }
        }
    }

    #[test]
    fn states_print_as_the_documents_spell_them() {
        let all: Vec<String> = State::ALL.iter().map(ToString::to_string).collect();
        let want = [
            "CREATED",
            "READY",
            "ACTIVE",
            "STOPPED{requested}",
            "STOPPED{restarted}",
            "STOPPED{interlock}",
            "STOPPED{peer_lost}",
            "FAULT",
        ];
        assert_eq!(all, want);
    }
}
