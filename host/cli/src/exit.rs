//! Exit codes of the program, part of its interface.

/// The end of a subcommand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Exit {
    Ok = 0,
    Refused = 1,
    Usage = 2,
    NoGcm = 3,
    TimedOut = 4,
    Partial = 5,
    /// The host served and stood still, and now another process has its name. 75 is EX_TEMPFAIL
    /// of sysexits(3).
    Replaced = 75,
    Interrupted = 130,
}
