//! The newest log lines, for callers that ask later, and the coming ones, for followers.
//!
//! Invariant: no follower sees a line twice or misses one between the kept and the coming ones.

use std::collections::VecDeque;

use parking_lot::Mutex;
use tokio::sync::broadcast;

use trocar_lcm_api::LogLine;

/// Lines kept.
const KEPT: usize = 1000;

/// Log lines of every component this port speaks for.
#[derive(Debug)]
pub struct Lines {
    kept: Mutex<VecDeque<LogLine>>,
    live: broadcast::Sender<LogLine>,
}

impl Default for Lines {
    fn default() -> Self {
        Lines { kept: Mutex::default(), live: broadcast::Sender::new(KEPT) }
    }
}

impl Lines {
    /// Adds the newest line.
    pub fn keep(&self, line: LogLine) {
        let mut kept = self.kept.lock();
        if kept.len() == KEPT {
            kept.pop_front();
        }
        kept.push_back(line.clone());
        // Nobody following is not an error.
        let _ = self.live.send(line);
    }

    /// The lines kept, oldest first, and what comes after them.
    pub fn tail(&self) -> (Vec<LogLine>, broadcast::Receiver<LogLine>) {
        let kept = self.kept.lock();
        (kept.iter().cloned().collect(), self.live.subscribe())
    }
}
