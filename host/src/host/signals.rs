//! Ctrl-C and SIGTERM.
//!
//! Invariant: signals are heard from the first moment on, so that nothing is cut off half started. The first
//! one asks for an orderly end, a second one ends the process at once, so a person is never held.

use std::io::{ErrorKind, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;
use trocar_rt::house;

/// Exit code of a program that was interrupted.
const INTERRUPTED: i32 = 130;

/// Time that a process may take to end once its keeper is gone; then it is cut off.
const ORPHANED: Duration = Duration::from_secs(20);

/// True: standard input leads to the keeper of this process, and carries what the process says to it.
static TIED: AtomicBool = AtomicBool::new(false);

/// Request to this process to end.
#[derive(Clone, Debug)]
pub struct StopRequest {
    tell: Arc<watch::Sender<bool>>,
    asked: watch::Receiver<bool>,
}

impl StopRequest {
    /// Begins to listen to Ctrl-C, SIGTERM and hang-up; call it inside a tokio runtime, before
    /// anything is started.
    pub fn listen() -> Self {
        let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
        let mut signals: Vec<Signal> = kinds.into_iter().filter_map(|kind| signal(kind).ok()).collect();
        let (tell, asked) = watch::channel(false);
        let tell = Arc::new(tell);
        let teller = tell.clone();
        tokio::spawn(async move {
            next(&mut signals).await;
            // A process that ends without this word was not asked to end.
            say_to_keeper("{\"ending\":true}");
            // The sender stays open until the end.
            teller.send_replace(true);
            next(&mut signals).await;
            std::process::exit(INTERRUPTED);
        });
        Self { tell, asked }
    }

    /// Also asks when standard input is closed: the kernel does that when the holder of its other end is
    /// gone, for whatever reason.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub fn tie_to_stdin(&self) -> std::io::Result<()> {
        TIED.store(true, Ordering::Release);
        let tell = self.tell.clone();
        let wait = move || {
            while comes(&mut std::io::stdin().lock()) {}
            tell.send_replace(true);
            std::thread::sleep(ORPHANED);
            // A component that never comes back would keep the process for ever, with nobody there to end it.
            std::process::abort();
        };
        house::spawn(std::thread::Builder::new().name("trocar-tie".into()), wait).map(|_| ())
    }

    /// Also asks when standard input is closed before anything came over it: then the program that waits for
    /// this process has gone.
    ///
    /// # Errors
    /// The machine gives no more threads.
    pub fn tie_until_heard(&self) -> std::io::Result<()> {
        let tell = self.tell.clone();
        let wait = move || {
            if !comes(&mut std::io::stdin().lock()) {
                tell.send_replace(true);
            }
        };
        house::spawn(std::thread::Builder::new().name("trocar-tie".into()), wait).map(|_| ())
    }

    /// Ends when the process is asked to end; at once when it already was.
    pub async fn asked(&mut self) {
        if self.asked.wait_for(|asked| *asked).await.is_err() {
            // Without a sender no request can come any more.
            std::future::pending::<()>().await;
        }
    }
}

/// Says a line to the keeper of this process, over the tie. Without a tie, or over one that is only read
/// from, nobody hears it.
pub fn say_to_keeper(line: &str) {
    if !TIED.load(Ordering::Acquire) {
        return;
    }
    let (stdin, line) = (std::io::stdin(), format!("{line}\n"));
    let mut left = line.as_bytes();
    while !left.is_empty() {
        match rustix::io::write(&stdin, left) {
            Ok(n) => left = &left[n..],
            Err(rustix::io::Errno::INTR) => {}
            Err(_) => return,
        }
    }
}

/// Waits for input; false: it is closed. A plugin's signal handler that interrupts the wait closes nothing.
fn comes(stdin: &mut impl Read) -> bool {
    loop {
        match stdin.read(&mut [0; 256]) {
            Ok(n) => return n > 0,
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(_) => return false,
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Interrupted, then something, then closed.
    struct Disturbed(u32);

    impl Read for Disturbed {
        fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
            self.0 += 1;
            match self.0 {
                1 | 3 => Err(ErrorKind::Interrupted.into()),
                2 => Ok(1),
                _ => Ok(0),
            }
        }
    }

    #[test]
    fn a_signal_does_not_close_the_tie() {
        let mut stdin = Disturbed(0);
        assert!(comes(&mut stdin), "interrupted is not closed");
        assert!(!comes(&mut stdin));
        assert_eq!(stdin.0, 4);
    }
}
