//! A manager that is away while something is recorded: asked again, for a while.
//!
//! Invariant: a person who waits is told so, and may end it.

use std::time::Duration;

use indicatif::ProgressBar;
use tokio::time::Instant;

use super::ends::Ends;
use crate::failure::Failure;
use crate::out;
use crate::session::holding::Holding;

/// Time that a manager that is away is waited for. A manager that was ended by mistake is back in seconds,
/// and the recorder goes on without it.
const AWAY: Duration = Duration::from_secs(10);
/// Pause between two questions.
const AGAIN: Duration = Duration::from_millis(200);

/// Asks again while the manager is away, and says so; recorders do not need one to go on.
pub(super) struct Patience<'a> {
    /// The recorder, which ends with this program.
    held: &'a Holding,
    bar: Option<&'a ProgressBar>,
    /// Events that end the waiting before its time.
    ends: Option<&'a mut Ends>,
    since: Option<Instant>,
    pub(super) is_over: bool,
}

impl<'a> Patience<'a> {
    pub(super) fn new(held: &'a Holding, bar: Option<&'a ProgressBar>, ends: Option<&'a mut Ends>) -> Self {
        Self { held, bar, ends, since: None, is_over: false }
    }

    /// Tells whether the failure is a manager that is away.
    pub(super) fn is_away(failure: &Failure) -> bool {
        failure.reason == "NO_GCM"
    }

    /// Returns the manager's answer in the end. A manager that is back may have to hear its processes first.
    pub(super) async fn wait<T>(
        &mut self,
        asked: impl AsyncFn() -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        loop {
            match asked().await {
                Ok(answer) => {
                    if let Some(since) = self.since.take() {
                        // A manager that was made anew knows this program's hold a moment later.
                        let stands = self.unless_ended(self.held.stands(since + AWAY)).await;
                        let but = "; but it would not end the recorder with this program";
                        self.say(&format!("it answers again{}", if stands == Some(true) { "" } else { but }));
                    }
                    return Ok(answer);
                }
                Err(failure) if self.is_over || self.since.is_none() && !Self::is_away(&failure) => {
                    return Err(failure);
                }
                Err(failure) => {
                    if self.since.is_none() {
                        let wait = AWAY.as_secs();
                        self.say(&format!(
                            "{}; recording goes on without it, and it is waited for, {wait} s",
                            failure.message
                        ));
                    }
                    self.is_over = self.since.get_or_insert_with(Instant::now).elapsed() > AWAY;
                    self.unless_ended(tokio::time::sleep(AGAIN)).await;
                }
            }
        }
    }

    /// Waits for it; `None` when the user ends the waiting before.
    async fn unless_ended<T>(&mut self, wait: impl Future<Output = T>) -> Option<T> {
        let Some(ends) = &mut self.ends else { return Some(wait.await) };
        tokio::select! {
            waited = wait => Some(waited),
            () = ends.come() => {
                self.is_over = true;
                None
            }
        }
    }

    fn say(&self, text: &str) {
        match self.bar {
            Some(bar) => bar.suspend(|| out::complain("warning", text)),
            None => out::complain("warning", text),
        }
    }
}
