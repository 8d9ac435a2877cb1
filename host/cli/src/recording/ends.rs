//! Ends of a recording from outside: Ctrl-C, a closed terminal, or an end that was asked for.
//!
//! Invariant: a signal that was ignored when the program began stays ignored: `nohup` and shells that run it
//! in the background mean it.

use std::future::poll_fn;
use std::task::Poll;

use tokio::signal::unix::{Signal, SignalKind, signal};

/// Signals, heard from the creation on, so that none ends the program meanwhile.
pub(super) struct Ends(Vec<Signal>);

impl Ends {
    pub(super) fn listen() -> Ends {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let ignored = ignored(&status);
        let ends = [SignalKind::interrupt(), SignalKind::hangup(), SignalKind::terminate()];
        let heard = ends.into_iter().filter(|kind| ignored >> (kind.as_raw_value() - 1) & 1 == 0);
        // A signal that cannot be heard ends the program, as it does without this.
        Ends(heard.filter_map(|kind| signal(kind).ok()).collect())
    }

    /// Returns when one of them has come.
    pub(super) async fn come(&mut self) {
        poll_fn(|context| {
            let came = self.0.iter_mut().any(|signal| signal.poll_recv(context).is_ready());
            if came { Poll::Ready(()) } else { Poll::Pending }
        })
        .await;
    }
}

/// The signals a process ignores, by its `status`: bit n-1 is signal n.
fn ignored(status: &str) -> u64 {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_ignored_stands_in_the_status_of_a_process() {
        let hangup = SignalKind::hangup().as_raw_value();
        assert_eq!(
            ignored("Name:\ttrocar\nSigIgn:\t0000000000001001\nSigCgt:\tff\n"),
            1 << 12 | 1 << (hangup - 1)
        );
        assert_eq!(ignored("nothing of it"), 0);
    }
}
