//! All supervised processes of this one, and how they stand.

use std::collections::BTreeMap;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::keeper::{Status, keep};
use super::{Phase, Program};

/// How every process stands, by name.
#[derive(Clone)]
pub(super) struct Board {
    all: watch::Sender<BTreeMap<String, Status>>,
}

impl Board {
    pub(super) fn change(&self, name: &str, change: &dyn Fn(&mut Status)) {
        self.all.send_modify(|all| change(all.entry(name.to_owned()).or_default()));
    }
}

/// Keeps processes; dropped, it kills what it still keeps.
pub struct Supervisor {
    board: Board,
    kept: BTreeMap<String, Kept>,
}

struct Kept {
    down: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Default for Supervisor {
    fn default() -> Self {
        Supervisor { board: Board { all: watch::Sender::new(BTreeMap::new()) }, kept: BTreeMap::new() }
    }
}

impl Supervisor {
    /// Spawns a process and keeps it. A name that is kept already is left as it is.
    pub fn start(&mut self, program: Program) {
        let name = program.name.clone();
        if self.kept.contains_key(&name) {
            return;
        }
        self.board.change(&name, &|_| {});
        let (down, asked) = watch::channel(false);
        let task = tokio::spawn(keep(program, self.board.clone(), asked));
        self.kept.insert(name, Kept { down, task });
    }

    /// How all stand now and whenever something changes; a slow reader sees the newest.
    pub fn statuses(&self) -> watch::Receiver<BTreeMap<String, Status>> {
        self.board.all.subscribe()
    }

    /// Waits until a process serves; answers how it stands when it will not.
    ///
    /// # Errors
    /// It failed or ended.
    pub async fn serving(&self, name: &str) -> Result<Status, Status> {
        let mut all = self.statuses();
        let settled = |all: &BTreeMap<String, Status>| {
            let phase = all.get(name).map(|s| s.phase);
            !matches!(phase, Some(Phase::Starting | Phase::Restarting))
        };
        // The board lives as long as this does.
        let status =
            all.wait_for(settled).await.ok().and_then(|all| all.get(name).cloned()).unwrap_or_default();
        if status.phase == Phase::Running { Ok(status) } else { Err(status) }
    }

    /// Asks these to end, all at once, and waits until they have.
    pub async fn end(&mut self, names: &[String]) {
        for name in names {
            if let Some(kept) = self.kept.get(name) {
                kept.down.send_replace(true);
            }
        }
        for name in names {
            if let Some(kept) = self.kept.remove(name) {
                // A keeper that panicked has let go of its child, which ends by itself.
                let _ = kept.task.await;
            }
        }
    }
}

impl Drop for Supervisor {
    fn drop(&mut self) {
        for kept in self.kept.values() {
            kept.task.abort();
        }
    }
}
