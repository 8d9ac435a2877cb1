//! Ctrl-C and SIGTERM.
//!
//! Invariant: heard from the first moment on, so that nothing is cut off half started; the first one asks for an orderly
//! end, a second one ends the process at once, so a person is never held.

use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;

/// Exit code of a program that was interrupted.
const INTERRUPTED: i32 = 130;

/// Whether somebody asked this process to end.
#[derive(Clone, Debug)]
pub struct StopRequest {
    asked: watch::Receiver<bool>,
}

impl StopRequest {
    /// Begins to listen to Ctrl-C, SIGTERM and hang-up; call it inside a tokio runtime, before anything is started.
    pub fn listen() -> Self {
        let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
        let mut signals: Vec<Signal> = kinds.into_iter().filter_map(|kind| signal(kind).ok()).collect();
        let (tell, asked) = watch::channel(false);
        tokio::spawn(async move {
            next(&mut signals).await;
            // Kept open until the end, whoever listens.
            tell.send_replace(true);
            next(&mut signals).await;
            std::process::exit(INTERRUPTED);
        });
        Self { asked }
    }

    /// Ends when the process is asked to end; at once when it already was.
    pub async fn asked(&mut self) {
        if self.asked.wait_for(|asked| *asked).await.is_err() {
            // Nobody can ask any more.
            std::future::pending::<()>().await;
        }
    }
}

/// The next of several signals; never when there are none.
async fn next(signals: &mut [Signal]) {
    std::future::poll_fn(|cx| {
        let arrived = signals.iter_mut().any(|s| s.poll_recv(cx).is_ready());
        if arrived { std::task::Poll::Ready(()) } else { std::task::Poll::Pending }
    })
    .await;
}
