//! Ctrl-C and SIGTERM.
//!
//! Invariant: heard from the first moment on, so that nothing is cut off half started; the first one asks for an orderly
//! end, a second one ends the process at once, so a person is never held.

use std::io::Read;
use std::sync::Arc;
use std::time::Duration;

use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;

/// Exit code of a program that was interrupted.
const INTERRUPTED: i32 = 130;

/// How long a process may take to end once whoever keeps it is gone; then it is cut off.
const ORPHANED: Duration = Duration::from_secs(20);

/// Whether somebody asked this process to end.
#[derive(Clone, Debug)]
pub struct StopRequest {
    tell: Arc<watch::Sender<bool>>,
    asked: watch::Receiver<bool>,
}

impl StopRequest {
    /// Begins to listen to Ctrl-C, SIGTERM and hang-up; call it inside a tokio runtime, before anything is started.
    pub fn listen() -> Self {
        let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
        let mut signals: Vec<Signal> = kinds.into_iter().filter_map(|kind| signal(kind).ok()).collect();
        let (tell, asked) = watch::channel(false);
        let tell = Arc::new(tell);
        let teller = tell.clone();
        tokio::spawn(async move {
            next(&mut signals).await;
            // Kept open until the end, whoever listens.
            teller.send_replace(true);
            next(&mut signals).await;
            std::process::exit(INTERRUPTED);
        });
        Self { tell, asked }
    }

    /// Also asks when standard input is closed: the kernel does that when whoever holds its other end is gone, however
    /// that came about.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub fn tie_to_stdin(&self) -> std::io::Result<()> {
        let tell = self.tell.clone();
        let wait = move || {
            let (mut stdin, mut bytes) = (std::io::stdin().lock(), [0; 256]);
            while matches!(stdin.read(&mut bytes), Ok(1..)) {}
            tell.send_replace(true);
            std::thread::sleep(ORPHANED);
            // A component that never comes back would keep it for ever, and nobody is there to end it.
            std::process::abort();
        };
        std::thread::Builder::new().name("trocar-tie".into()).spawn(wait).map(|_| ())
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
