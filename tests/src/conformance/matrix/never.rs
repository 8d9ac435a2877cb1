//! What a command never comes to, and why.
//!
//! Invariant: the situations that bring an outcome about for others are played here, too, and come to
//! something else.

use super::super::Reach;
use super::{Fate, Kind, Mode, Situation, fate};

/// Outcomes, who never sees them, and why.
type Row = (&'static [Fate], fn(Reach, Kind, Mode) -> bool, &'static str);

/// Everything that cannot be.
pub const NEVER: &[Row] = &[
    (&[Fate::Queued, Fate::QueueFull], |_, k, _| k.reads(), "a read is answered at once, from the row"),
    (
        &[Fate::WouldBlock, Fate::TooLate, Fate::StillRuns],
        |r, k, m| k.reads() && (!k.is_asked_for(r) || m == Mode::Send),
        "a read waits for nobody, so there is no deadline to miss",
    ),
    (
        &[Fate::TooLate, Fate::StillRuns],
        |r, k, m| k.is_asked_for(r) && m == Mode::Call,
        "its process answers it beside the component, whatever that does",
    ),
    (
        &[Fate::PeerLost, Fate::NotActive],
        |_, k, _| k.reads(),
        "a row that was published can be read whatever became of the component, until the connection is cut",
    ),
    (
        &[Fate::Executed, Fate::Failed, Fate::Disabled],
        |_, k, m| k.reads() && m == Mode::Send,
        "a read that is only sent has no place for its answer",
    ),
    (
        &[Fate::InvalidArgument],
        |_, k, m| !k.takes_an_argument() && (k != Kind::Read || m == Mode::Call),
        "without an argument there is none that could be wrong",
    ),
    (&[Fate::Queued], |_, k, m| !k.reads() && m == Mode::Call, "a call comes back with what became of it"),
    (
        &[Fate::WouldBlock, Fate::TooLate, Fate::StillRuns],
        |_, k, m| !k.reads() && m == Mode::Send,
        "what is only sent waits for nothing",
    ),
    (
        &[Fate::PeerLost],
        |_, k, m| !k.reads() && m == Mode::Send,
        "before the cut it is taken, and counted when it comes to nothing; after it the function is unbound",
    ),
    (
        &[Fate::Executed, Fate::Failed],
        |r, k, m| r.queues() && !k.reads() && m == Mode::Send,
        "it is answered before it runs; its failure is counted and told",
    ),
    (
        &[Fate::Disabled],
        |r, k, m| r != Reach::Thread && !k.reads() && m == Mode::Send,
        "it is queued while the server describes itself anew, and counted when it comes to nothing",
    ),
    (
        &[Fate::WouldBlock],
        |r, k, m| r == Reach::Thread && !k.reads() && m == Mode::Call,
        "who shares the server's thread finds nobody inside: circles of direct calls are refused at Connect",
    ),
    (
        &[Fate::StillRuns],
        |r, k, m| !r.queues() && !k.reads() && m == Mode::Call,
        "who runs it himself comes back with it; who waits for the shared thread is waited for by it, so it is never begun",
    ),
    (
        &[Fate::TooLate],
        |r, k, m| r == Reach::Machine && !k.reads() && m == Mode::Call,
        "what was sent to another machine may have begun there",
    ),
    (
        &[Fate::QueueFull],
        |r, k, m| r == Reach::Caller && !k.reads() && m == Mode::Call,
        "a call to a server without a thread waits for the server, not in its queue",
    ),
];

/// The reason why this never comes to `what`.
fn reason(reach: Reach, kind: Kind, mode: Mode, what: Fate) -> Option<&'static str> {
    let row = NEVER.iter().find(|(fates, who, _)| fates.contains(&what) && who(reach, kind, mode));
    row.map(|(_, _, why)| *why)
}

/// Cells that nothing brings about although nothing forbids it, or that have a reason and yet come about.
#[must_use]
pub fn holes() -> Vec<String> {
    let mut holes = Vec::new();
    for reach in Reach::ALL {
        for (kind, mode) in Kind::ALL.into_iter().flat_map(|k| Mode::ALL.map(|m| (k, m))) {
            for what in Fate::ALL {
                let by = Situation::ALL.into_iter().find(|s| fate(reach, *s, kind, mode) == what);
                match (by, reason(reach, kind, mode, what)) {
                    (Some(_), None) | (None, Some(_)) => {}
                    (None, None) => holes.push(format!(
                        "{reach:?}: {kind:?}, {mode:?} → {what:?}: no situation, and no reason why there is none"
                    )),
                    (Some(by), Some(why)) => holes.push(format!(
                        "{reach:?}: {kind:?}, {mode:?} → {what:?}: comes about in {by:?}, but never: {why}"
                    )),
                }
            }
        }
    }
    holes
}
