//! Ctrl-C and SIGTERM.
//!
//! Invariant: the first one asks for an orderly end; a second one ends at once, so a person is never held.

use tokio::signal::unix::{Signal, SignalKind, signal};

/// Exit code of a program that was interrupted.
const INTERRUPTED: i32 = 130;

/// Ends at the first Ctrl-C, SIGTERM or hang-up; from then on a second one ends the process at once.
pub(crate) async fn asked_to_stop() {
    let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
    let mut signals: Vec<Signal> = kinds.into_iter().filter_map(|kind| signal(kind).ok()).collect();
    next(&mut signals).await;
    tokio::spawn(async move {
        next(&mut signals).await;
        std::process::exit(INTERRUPTED);
    });
}

/// The next of several signals; never when there are none.
async fn next(signals: &mut [Signal]) {
    std::future::poll_fn(|cx| {
        let arrived = signals.iter_mut().any(|s| s.poll_recv(cx).is_ready());
        if arrived { std::task::Poll::Ready(()) } else { std::task::Poll::Pending }
    })
    .await;
}
