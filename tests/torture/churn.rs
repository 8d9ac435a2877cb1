//! Somebody who connects and disconnects all the time, whatever becomes of the ends.
//!
//! Invariant: a refusal is an answer like any other; what counts is that there is one, and that nothing stays
//! behind.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use trocar_proto::v1::ConnectOptions;

use crate::clock::eventually;
use crate::rpc::{Answer, Rpc};

/// Between two requests.
const PAUSE: Duration = Duration::from_millis(3);

pub(crate) struct Churn {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<Churned>>,
    rpc: Rpc,
    pairs: Vec<(String, String)>,
}

/// What came of it.
#[derive(Default)]
pub(crate) struct Churned {
    pub(crate) made: usize,
    pub(crate) refused: usize,
    /// Longest wait for an answer, ms.
    pub(crate) longest_ms: f64,
}

impl Churn {
    /// Begins with these pairs of client and server, in turn.
    pub(crate) fn begin(rpc: &Rpc, pairs: &[(&str, &str)]) -> Churn {
        let pairs: Vec<(String, String)> =
            pairs.iter().map(|(client, server)| ((*client).to_owned(), (*server).to_owned())).collect();
        let (ends, rpc) = (Arc::new(AtomicBool::new(false)), rpc.clone());
        let (stops, theirs, of) = (ends.clone(), rpc.clone(), pairs.clone());
        let thread = thread::spawn(move || {
            let mut churned = Churned::default();
            while !stops.load(Ordering::Relaxed) {
                for (client, server) in &of {
                    let asked = Instant::now();
                    let made = theirs.connect(client, server, ConnectOptions::default());
                    churned.count(made.map(drop), asked);
                    thread::sleep(PAUSE);
                    let asked = Instant::now();
                    churned.count(theirs.disconnect(client, server), asked);
                    thread::sleep(PAUSE);
                }
            }
            churned
        });
        Churn { ends, thread: Some(thread), rpc, pairs }
    }

    /// Ends it, and takes away what it had made last.
    pub(crate) fn end(mut self) -> Result<Churned, String> {
        let churned = self.join().ok_or("connecting panicked")?;
        for (client, server) in &self.pairs {
            eventually("the last connection is taken away", || match self.rpc.disconnect(client, server) {
                Ok(()) => Ok(()),
                Err(refused) if refused.reason == "CONNECTION_NOT_FOUND" => Ok(()),
                Err(refused) => Err(refused.to_string()),
            })?;
        }
        Ok(churned)
    }

    fn join(&mut self) -> Option<Churned> {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.take()?.join().ok()
    }
}

impl Drop for Churn {
    fn drop(&mut self) {
        self.join();
    }
}

impl Churned {
    pub(crate) fn add(&mut self, more: Churned) {
        self.made += more.made;
        self.refused += more.refused;
        self.longest_ms = self.longest_ms.max(more.longest_ms);
    }

    fn count(&mut self, answer: Answer<()>, asked: Instant) {
        self.longest_ms = self.longest_ms.max(asked.elapsed().as_secs_f64() * 1e3);
        match answer {
            Ok(()) => self.made += 1,
            Err(_) => self.refused += 1,
        }
    }
}
