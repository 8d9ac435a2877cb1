//! Outcomes of commands and reads: what a status means to the caller, and how long a call may wait.

use std::io::Write;

use trocar_plugin_api::abi::{
    EXECUTED, ErrBuf, FAILED, INVALID_ARGUMENT, Outcome, STATUS_INVALID, STATUS_OK, Status,
};

use super::entry::Unexplained;
use super::texts::{text_in, write_err};

/// Deadline of a blocking call that names none, ns.
pub(crate) const DEFAULT_DEADLINE_NS: u64 = 1_000_000_000;
/// Longest deadline of a call, ns, as of a connection: a call that asks for more waits an hour.
const MAX_DEADLINE_NS: u64 = 3_600_000_000_000;

/// Longest wait of a call that asks for `asked_ns`, ns; 0 means the deadline of its connection.
pub(crate) fn within_ns(asked_ns: u64, connection_ns: u64) -> u64 {
    if asked_ns == 0 { connection_ns } else { asked_ns.min(MAX_DEADLINE_NS) }
}

/// Turns a status of `command` or `read` into the caller's outcome. The caller is told the number where the
/// plugin gives no sentence.
pub(crate) fn outcome_of(status: Status, err: *mut ErrBuf) -> Outcome {
    if status == STATUS_OK {
        return EXECUTED;
    }
    explain(status, err);
    plain_outcome(status)
}

#[cold]
fn explain(status: Status, err: *mut ErrBuf) {
    // SAFETY: null or a buffer the caller lends for the call.
    if unsafe { err.as_ref() }.is_none_or(|err| !text_in(err).is_empty()) {
        return;
    }
    let mut room = [0; 64];
    let mut rest = &mut room[..];
    // Text without room is left out.
    let _ = write!(rest, "{}", Unexplained(status));
    let said = 64 - rest.len();
    write_err(err, &room[..said]);
}

/// Outcome of a status of `command`, without the sentence.
pub(crate) fn plain_outcome(status: Status) -> Outcome {
    match status {
        STATUS_OK => EXECUTED,
        STATUS_INVALID => INVALID_ARGUMENT,
        _ => FAILED,
    }
}

/// Tells whether the command has this argument or result and the caller gave no place for it.
pub(super) fn lacks(place: *const u8, bytes: usize) -> bool {
    place.is_null() && bytes > 0
}

#[cfg(test)]
mod tests {
    use super::{MAX_DEADLINE_NS, within_ns};

    #[test]
    fn a_call_waits_as_long_as_it_or_its_connection_says_and_never_more_than_an_hour() {
        assert_eq!(within_ns(0, 20), 20, "it names none");
        assert_eq!(within_ns(7, 20), 7);
        assert_eq!(within_ns(MAX_DEADLINE_NS + 1, 20), MAX_DEADLINE_NS);
        assert_eq!(within_ns(u64::MAX, 20), MAX_DEADLINE_NS);
    }
}
