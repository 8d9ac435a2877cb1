//! A manager that is away while something is recorded: asked again, for a while.
//!
//! Invariant: whoever waits is told so, and may end it.

use std::time::{Duration, Instant};

use indicatif::ProgressBar;

use super::ends::Ends;
use crate::cli::failure::Failure;
use crate::cli::out;

/// How long a manager that is away is waited for: one that was ended by mistake is back in seconds, and the recorder goes on without.
const AWAY: Duration = Duration::from_secs(10);
/// How often it is asked.
const AGAIN: Duration = Duration::from_millis(200);

/// Asks again while the manager is away, and says so; recorders do not need one to go on.
pub(super) struct Patience<'a> {
    bar: Option<&'a ProgressBar>,
    /// What ends the waiting before its time.
    ends: Option<&'a mut Ends>,
    since: Option<Instant>,
    pub(super) is_over: bool,
}

impl<'a> Patience<'a> {
    pub(super) fn new(bar: Option<&'a ProgressBar>, ends: Option<&'a mut Ends>) -> Self {
        Self { bar, ends, since: None, is_over: false }
    }

    /// Whether it is a manager that is away.
    pub(super) fn is_away(failure: &Failure) -> bool {
        failure.reason == "NO_GCM"
    }

    /// What it answers in the end. One that is back may have to hear its processes first.
    pub(super) async fn wait<T>(
        &mut self,
        asked: impl AsyncFn() -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        loop {
            match asked().await {
                Ok(answer) => {
                    if self.since.take().is_some() {
                        self.say("it answers again");
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
                    let sleep = tokio::time::sleep(AGAIN);
                    match &mut self.ends {
                        None => sleep.await,
                        Some(ends) => tokio::select! {
                            () = sleep => {}
                            () = ends.come() => self.is_over = true,
                        },
                    }
                }
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
