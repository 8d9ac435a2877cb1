//! Status of the supervised processes, and the board where all can read it.
//!
//! Invariant: a process that was forgotten has no status.

use std::collections::BTreeMap;

use serde_json::Value;
use tokio::sync::watch;

use super::Exit;

/// Phase in the life of a supervised process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// Spawned, for the first time or again; it does not serve yet.
    #[default]
    Starting,
    /// The process serves, and is attached to its GCM if it has one.
    Running,
    /// The process failed and will be spawned again.
    Restarting,
    /// The process failed too often.
    Failed,
    /// The process ended and nobody wants it back.
    Ended,
}

/// Status of a supervised process.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    pub phase: Phase,
    /// Process id of the incarnation that runs, or ended last; 0 = none yet.
    pub pid: u32,
    /// Address where the process serves, or did.
    pub address: Option<String>,
    /// Number of times the process was spawned again.
    pub restarts: u32,
    pub last_exit: Option<Exit>,
    /// The reason why it did not start, in its own words.
    pub refused: Option<Value>,
}

impl Status {
    /// Returns how the process ended last, in words, with its own reason; "" when it never did.
    pub fn exit_text(&self) -> String {
        let said = self.refused.as_ref().and_then(|r| r["message"].as_str());
        match (&self.last_exit, said) {
            (None, _) => String::new(),
            (Some(exit), None) => exit.to_string(),
            (Some(exit), Some(said)) => format!("{exit}: {said}"),
        }
    }
}

/// Status of every process, by name.
#[derive(Clone, Default)]
pub(super) struct Board {
    all: watch::Sender<BTreeMap<String, Status>>,
}

impl Board {
    pub(super) fn follow(&self) -> watch::Receiver<BTreeMap<String, Status>> {
        self.all.subscribe()
    }

    pub(super) fn begin(&self, name: &str) {
        self.all.send_modify(|all| _ = all.insert(name.to_owned(), Status::default()));
    }

    /// A forgotten process has no status any more.
    pub(super) fn change(&self, name: &str, change: &dyn Fn(&mut Status)) {
        self.all.send_if_modified(|all| all.get_mut(name).map(change).is_some());
    }

    pub(super) fn forget(&self, name: &str) {
        self.all.send_modify(|all| _ = all.remove(name));
    }
}
