//! What is asked and what it may come to.
//!
//! Invariant: the names are those of the component model.

use trocar_sdk::Outcome;

use super::super::{Answer, Function, Reach};

/// A kind of command, and which function of the client stands for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Void,
    Write,
    VoidReturn,
    WriteReturn,
    Read,
    QualifiedRead,
}

impl Kind {
    pub const ALL: [Kind; 6] =
        [Kind::Void, Kind::Write, Kind::VoidReturn, Kind::WriteReturn, Kind::Read, Kind::QualifiedRead];

    #[must_use]
    pub fn function(self) -> Function {
        match self {
            Kind::Void => Function::Poke,
            Kind::Write => Function::Write,
            Kind::VoidReturn => Function::Take,
            Kind::WriteReturn => Function::Twice,
            Kind::Read => Function::Value,
            Kind::QualifiedRead => Function::Scaled,
        }
    }

    /// Answered from the published row, without entering the server.
    #[must_use]
    pub fn reads(self) -> bool {
        self.function().reads()
    }

    /// A read that a client whose process has not the server's class has to ask for.
    #[must_use]
    pub fn is_asked_for(self, reach: Reach) -> bool {
        reach.asks() && self == Kind::QualifiedRead
    }

    #[must_use]
    pub fn takes_an_argument(self) -> bool {
        matches!(self, Kind::Write | Kind::WriteReturn | Kind::QualifiedRead)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    Send,
    Call,
}

impl Mode {
    pub const ALL: [Mode; 2] = [Mode::Send, Mode::Call];
}

/// An outcome; a missed deadline is two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    Executed,
    Queued,
    Unbound,
    QueueFull,
    WouldBlock,
    Disabled,
    InvalidArgument,
    Failed,
    /// DEADLINE, and it never runs.
    TooLate,
    /// DEADLINE, and it may still run.
    StillRuns,
    PeerLost,
    NotActive,
}

impl Fate {
    pub const ALL: [Fate; 12] = [
        Fate::Executed,
        Fate::Queued,
        Fate::Unbound,
        Fate::QueueFull,
        Fate::WouldBlock,
        Fate::Disabled,
        Fate::InvalidArgument,
        Fate::Failed,
        Fate::TooLate,
        Fate::StillRuns,
        Fate::PeerLost,
        Fate::NotActive,
    ];

    #[must_use]
    pub fn outcome(self) -> Outcome {
        match self {
            Fate::Executed => Outcome::Executed,
            Fate::Queued => Outcome::Queued,
            Fate::Unbound => Outcome::Unbound,
            Fate::QueueFull => Outcome::QueueFull,
            Fate::WouldBlock => Outcome::WouldBlock,
            Fate::Disabled => Outcome::Disabled,
            Fate::InvalidArgument => Outcome::InvalidArgument,
            Fate::Failed => Outcome::Failed,
            Fate::TooLate | Fate::StillRuns => Outcome::Deadline,
            Fate::PeerLost => Outcome::PeerLost,
            Fate::NotActive => Outcome::NotActive,
        }
    }

    /// So many calls came to this, and none to anything else.
    #[must_use]
    pub fn is(self, answer: &Answer, times: u64) -> bool {
        let still = if self == Fate::StillRuns { times } else { 0 };
        answer.outcomes == [(self.outcome(), times)] && answer.may_still_run == still
    }
}
