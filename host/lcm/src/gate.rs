//! A component's state in one atomic word.

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
