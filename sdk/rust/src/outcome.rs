//! Outcomes of a call through a slot.
//!
//! Invariant: exactly one outcome per call; a caller never hangs.

use core::fmt;
use trocar_plugin_api::abi;

/// The outcome of `send`, `call`, `emit`, `write`, `commit`. `Executed` and `Queued` are success.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Outcome {
    /// The callee has done it.
    Executed,
    /// The call waits in the peer's queue.
    Queued,
    /// No peer is connected.
    Unbound,
    /// The peer's queue is full; nothing was sent.
    QueueFull,
    /// Waiting is not allowed on this thread.
    WouldBlock,
    /// The command is not among its component's ports any more, or the host is too old for the call.
    Disabled,
    /// The argument is outside its limits, or its size is not the type's.
    InvalidArgument,
    /// The command ran and failed.
    Failed,
    /// No answer in time.
    Deadline,
    /// The peer's process, or its thread, is lost.
    PeerLost,
    /// The peer's component is not ACTIVE.
    NotActive,
    /// The frame pool has no free slot.
    Exhausted,
    /// A newer host's answer that this SDK does not know.
    Other(i32),
}

impl Outcome {
    /// True when the call was executed or is on its way.
    pub const fn is_ok(self) -> bool {
        matches!(self, Outcome::Executed | Outcome::Queued)
    }
}

impl From<abi::Outcome> for Outcome {
    #[inline]
    fn from(code: abi::Outcome) -> Outcome {
        match code {
            abi::EXECUTED => Outcome::Executed,
            abi::QUEUED => Outcome::Queued,
            abi::UNBOUND => Outcome::Unbound,
            abi::QUEUE_FULL => Outcome::QueueFull,
            abi::WOULD_BLOCK => Outcome::WouldBlock,
            abi::DISABLED => Outcome::Disabled,
            abi::INVALID_ARGUMENT => Outcome::InvalidArgument,
            abi::FAILED => Outcome::Failed,
            abi::DEADLINE => Outcome::Deadline,
            abi::PEER_LOST => Outcome::PeerLost,
            abi::NOT_ACTIVE => Outcome::NotActive,
            abi::EXHAUSTED => Outcome::Exhausted,
            other => Outcome::Other(other),
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Outcome::Executed => "executed",
            Outcome::Queued => "queued",
            Outcome::Unbound => "no peer is connected",
            Outcome::QueueFull => "the peer's queue is full",
            Outcome::WouldBlock => "waiting is not allowed on this thread: use `send`",
            Outcome::Disabled => "the command is not among its component's ports any more",
            Outcome::InvalidArgument => "the argument is outside its limits",
            Outcome::Failed => "the command failed",
            Outcome::Deadline => "no answer before the deadline",
            Outcome::PeerLost => "the peer is lost",
            Outcome::NotActive => "the peer is not active",
            Outcome::Exhausted => "the frame pool has no free slot",
            Outcome::Other(code) => return write!(f, "outcome {code}, unknown to this SDK"),
        })
    }
}

/// Why a `call` gave no result.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CallError {
    /// Never `Executed` or `Queued`.
    pub outcome: Outcome,
    /// The peer's own sentence, empty when it gave none.
    pub reason: String,
    /// With [`Outcome::Deadline`]: the command may still be executed.
    pub may_still_run: bool,
}

impl CallError {
    /// Without a sentence of the peer's.
    pub(crate) fn of(outcome: Outcome) -> CallError {
        CallError { outcome, reason: String::new(), may_still_run: false }
    }
}

impl fmt::Display for CallError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.outcome)?;
        if !self.reason.is_empty() {
            write!(f, ": {}", self.reason)?;
        }
        if self.may_still_run {
            f.write_str(" (it may still run)")?;
        }
        Ok(())
    }
}

impl std::error::Error for CallError {}

/// An output lends no frame now: nobody is connected or the pool is exhausted (the host counts it). Handed on
/// with `?` from `step`, it ends this cycle quietly instead of putting the component in FAULT.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct NoFrame(pub Outcome);

impl fmt::Display for NoFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "no frame to fill: {}", self.0)
    }
}

impl std::error::Error for NoFrame {}
