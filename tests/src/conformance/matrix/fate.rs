//! What each call comes to in each situation.
//!
//! Invariant: total and exact; where ways differ, they differ by how the call reaches the server and by
//! nothing else.

use super::super::Reach;
use super::{Fate, Kind, Mode, Situation};

/// What a command of this kind comes to, sent or called.
#[must_use]
pub fn fate(reach: Reach, situation: Situation, kind: Kind, mode: Mode) -> Fate {
    if situation == Situation::NoConnection {
        return Fate::Unbound;
    }
    if situation == Situation::OutsideItsLimits && kind.takes_an_argument() {
        return Fate::InvalidArgument;
    }
    let asked = kind.is_asked_for(reach) && mode == Mode::Call;
    match (kind.reads(), mode) {
        (true, _) if asked && must_not_wait(situation) => Fate::WouldBlock,
        (true, mode) => read(situation, mode),
        (false, Mode::Send) => sent(reach, situation),
        (false, Mode::Call) => called(reach, situation),
    }
}

/// Called where nothing may wait for another process.
fn must_not_wait(situation: Situation) -> bool {
    matches!(situation, Situation::ACommand | Situation::AStep | Situation::ABusyServerFromACommand)
}

/// The published row is there, whatever the server does; a read that is only sent has no place for what it
/// answers.
fn read(situation: Situation, mode: Mode) -> Fate {
    match (mode, situation) {
        (Mode::Send, _) => Fate::InvalidArgument,
        (Mode::Call, Situation::Refusing) => Fate::Failed,
        (Mode::Call, Situation::Withdrawn) => Fate::Disabled,
        (Mode::Call, _) => Fate::Executed,
    }
}

fn sent(reach: Reach, situation: Situation) -> Fate {
    match (situation, reach) {
        (Situation::NotActive, _) => Fate::NotActive,
        (Situation::AFullQueue, _) => Fate::QueueFull,
        // What waits to be run elsewhere has been answered; what becomes of it is counted.
        (_, Reach::Queue | Reach::Process | Reach::Apart | Reach::Machine) => Fate::Queued,
        (Situation::Refusing | Situation::BegunAndPanics, Reach::Thread | Reach::Caller) => Fate::Failed,
        (Situation::Withdrawn, Reach::Thread) => Fate::Disabled,
        (Situation::AThreadOfItsOwn, Reach::Thread) => Fate::Queued,
        (situation, Reach::Thread | Reach::Caller) if finds_somebody_inside(situation, reach) => Fate::Queued,
        (_, Reach::Thread | Reach::Caller) => Fate::Executed,
    }
}

/// Whoever is sent to finds the server entered by another thread.
fn finds_somebody_inside(situation: Situation, reach: Reach) -> bool {
    let waits = situation == Situation::ABusyServer || situation.ends_a_wait();
    let alone = matches!(situation, Situation::ABusyServerFromACommand | Situation::Withdrawn);
    waits || (alone && reach == Reach::Caller)
}

fn called(reach: Reach, situation: Situation) -> Fate {
    match (situation, reach) {
        // A step, and a command of whoever has a step, waits for no other thread.
        (
            Situation::ACommand | Situation::AStep,
            Reach::Queue | Reach::Process | Reach::Apart | Reach::Machine,
        ) => Fate::WouldBlock,
        (
            Situation::ABusyServerFromACommand,
            Reach::Queue | Reach::Process | Reach::Apart | Reach::Machine | Reach::Caller,
        ) => Fate::WouldBlock,
        // The thread that would run it waits for the very thread that calls.
        (Situation::AThreadOfItsOwn, Reach::Thread) => Fate::TooLate,
        // A call on its way to another machine may have begun.
        (Situation::ABusyServer, Reach::Machine) => Fate::StillRuns,
        (Situation::ABusyServer, _) => Fate::TooLate,
        (
            Situation::AFullQueue,
            Reach::Queue | Reach::Process | Reach::Apart | Reach::Machine | Reach::Thread,
        ) => Fate::QueueFull,
        // It waits for whoever is inside, not in a queue.
        (Situation::AFullQueue, Reach::Caller) => Fate::TooLate,
        (Situation::BegunAndHeld, Reach::Queue | Reach::Process | Reach::Apart | Reach::Machine) => {
            Fate::StillRuns
        }
        // What was begun is carried to its end, and its caller is told how it ended.
        (Situation::BegunAndCut | Situation::BegunAndStopped | Situation::BegunAndRemoved, _) => {
            Fate::Executed
        }
        (Situation::NotActive, _) => Fate::NotActive,
        (Situation::Refusing | Situation::BegunAndPanics, _) => Fate::Failed,
        (Situation::Withdrawn, _) => Fate::Disabled,
        (Situation::CutWhileWaiting | Situation::RemovedWhileWaiting, _) => Fate::PeerLost,
        (Situation::StoppedWhileWaiting, _) => Fate::NotActive,
        // On one thread the failure is over before the next call is made.
        (Situation::FailedWhileWaiting, _) => Fate::NotActive,
        _ => Fate::Executed,
    }
}
