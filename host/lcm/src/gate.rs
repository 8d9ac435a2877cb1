//! A component's state in one atomic word, and what of it its callers see.

use trocar_model::{State, StopReason};

pub(super) const ACTIVE: u32 = 2;

pub(super) fn pack(state: State) -> u32 {
    match state {
        State::Created => 0,
        State::Ready => 1,
        State::Active => ACTIVE,
        State::Fault => 3,
        State::Stopped(StopReason::Requested) => 4,
        State::Stopped(StopReason::Restarted) => 5,
        State::Stopped(StopReason::Interlock) => 6,
        State::Stopped(StopReason::PeerLost) => 7,
    }
}

pub(super) fn unpack(word: u32) -> State {
    match word {
        0 => State::Created,
        1 => State::Ready,
        ACTIVE => State::Active,
        4 => State::Stopped(StopReason::Requested),
        5 => State::Stopped(StopReason::Restarted),
        6 => State::Stopped(StopReason::Interlock),
        7 => State::Stopped(StopReason::PeerLost),
        _ => State::Fault,
    }
}

/// State of a server as its callers in other processes see it, in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub(crate) enum Presence {
    NotActive = 0,
    Active = 1,
    /// The server is removed, or about to be.
    Gone = 2,
}

impl Presence {
    pub(crate) fn of(word: u64) -> Presence {
        match word {
            1 => Presence::Active,
            2 => Presence::Gone,
            _ => Presence::NotActive,
        }
    }
}
