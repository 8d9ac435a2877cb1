//! The thread that makes one picture and writes it, while the component waits for a bounded time.
//!
//! Invariant: one picture at a time; a thread that is still at work is told at the next asking and waited for
//! when its owner is dropped, so that none outlives the plugin's code.

use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use trocar_imaging::side;
use trocar_sdk::Result;

use crate::file::SavedPicture;

/// Longest time that an answer is waited for; the class says `max_step_ms` above it.
const PATIENCE: Duration = Duration::from_secs(8);

/// Makes pictures; one at a time.
#[derive(Default)]
pub(crate) struct Saving {
    thread: Option<JoinHandle<()>>,
}

impl Saving {
    /// Runs `make` in a thread of that name, and gives what it says.
    ///
    /// # Errors
    /// The error of `make`; or an earlier thread is still at work, this one does not end, or there is no
    /// thread.
    pub(crate) fn run(
        &mut self,
        name: &str,
        make: impl FnOnce() -> Result<SavedPicture, String> + Send + 'static,
    ) -> Result<SavedPicture> {
        if self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            return Err("the last picture is still being written: wait for it".into());
        }
        let (tells, told) = sync_channel(1);
        let thread = side::spawn(&format!("{name} png"), move || {
            let _ = tells.send(make());
        })
        .map_err(|why| format!("no thread for the picture: {why}"))?;
        self.thread = Some(thread);
        match told.recv_timeout(PATIENCE) {
            Ok(saved) => {
                // The thread has nothing left to do but to end.
                self.end();
                Ok(saved?)
            }
            Err(RecvTimeoutError::Timeout) => Err(format!(
                "the picture is not written after {} s: look at the file system; it goes on",
                PATIENCE.as_secs()
            )
            .into()),
            Err(RecvTimeoutError::Disconnected) => {
                self.end();
                Err("making the picture panicked: nothing is promised about the file".into())
            }
        }
    }

    fn end(&mut self) {
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Saving {
    fn drop(&mut self) {
        self.end();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_thread_says_is_the_answer() {
        let mut saving = Saving::default();
        let saved = SavedPicture { bytes: 7, ..SavedPicture::default() };
        assert_eq!(saving.run("a", move || Ok(saved)).unwrap(), saved);
        assert_eq!(saving.run("a", || Err("no".into())).unwrap_err().to_string(), "no");
        let why = saving.run("a", || panic!("oh")).unwrap_err().to_string();
        assert!(why.contains("panicked"), "{why}");
        assert_eq!(saving.run("a", move || Ok(saved)).unwrap(), saved, "it goes on");
    }

    #[test]
    fn a_second_picture_waits_for_the_first() {
        let (ends, end) = sync_channel::<()>(1);
        let busy = std::thread::spawn(move || {
            let _ = end.recv();
        });
        let mut saving = Saving { thread: Some(busy) };
        let why = saving.run("a", || Ok(SavedPicture::default())).unwrap_err().to_string();
        assert!(why.contains("still being written"), "{why}");
        drop(ends);
    }
}
