//! All supervised processes of this one, and their status.

use std::collections::BTreeMap;

use parking_lot::Mutex;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use super::keeper::{Orders, keep};
use super::status::{Board, Status};
use super::{Exit, Program};

/// Keeps processes; dropped, it lets go of those it still keeps, which then end by themselves, devices safe
/// first.
#[derive(Default)]
pub struct Supervisor {
    board: Board,
    /// Never held while anything is waited for.
    kept: Mutex<BTreeMap<String, Kept>>,
}

struct Kept {
    down: watch::Sender<bool>,
    put_down: mpsc::UnboundedSender<(u32, String)>,
    again: mpsc::UnboundedSender<()>,
    task: JoinHandle<Option<Exit>>,
}

impl Supervisor {
    /// Spawns a process and keeps it. A name that is kept already stays as it is.
    pub fn start(&self, program: Program) {
        let name = program.name.clone();
        let mut kept = self.kept.lock();
        if kept.contains_key(&name) {
            return;
        }
        self.board.begin(&name);
        let (down, asked) = watch::channel(false);
        let (put_down, useless) = mpsc::unbounded_channel();
        let (again, afresh) = mpsc::unbounded_channel();
        let orders = Orders { down: asked, put_down: useless, again: afresh };
        let task = tokio::spawn(keep(program, self.board.clone(), orders));
        kept.insert(name, Kept { down, put_down, again, task });
    }

    /// Returns the status of all processes, now and whenever something changes; a slow reader sees the
    /// newest.
    pub fn statuses(&self) -> watch::Receiver<BTreeMap<String, Status>> {
        self.board.follow()
    }

    /// Reports that the incarnation with this number is of no use, and why: it is asked to end, soon killed,
    /// and treated as one that failed.
    pub fn put_down(&self, name: &str, pid: u32, why: String) {
        if let Some(kept) = self.kept.lock().get(name) {
            // A process that was given up takes no orders.
            let _ = kept.put_down.send((pid, why));
        }
    }

    /// Ends the process, if it runs, and starts it again with a clean record; also one that was given up or
    /// has ended.
    pub fn again(&self, name: &str) {
        if let Some(kept) = self.kept.lock().get(name) {
            // A process that was asked to end takes no orders.
            let _ = kept.again.send(());
        }
    }

    /// Asks the process to end and does not wait: its status says when it has.
    pub fn ask_to_end(&self, name: &str) {
        if let Some(kept) = self.kept.lock().get(name) {
            kept.down.send_replace(true);
        }
    }

    /// Forgets a process that has ended or was given up: its name is free, and it has no status any more.
    pub fn forget(&self, name: &str) {
        if let Some(kept) = self.kept.lock().remove(name) {
            kept.task.abort();
        }
        self.board.forget(name);
    }

    /// Asks these to end, all at once, and waits until they have. Returns those that did not end in order.
    pub async fn end(&self, names: &[String]) -> Vec<(String, Exit)> {
        for name in names {
            self.ask_to_end(name);
        }
        let mut failed = Vec::new();
        for name in names {
            let kept = self.kept.lock().remove(name);
            if let Some(kept) = kept {
                // A keeper that panicked has let go of its child, which ends by itself.
                let exit = kept.task.await.unwrap_or_default();
                failed.extend(exit.filter(|exit| !exit.is_orderly()).map(|exit| (name.clone(), exit)));
            }
        }
        failed
    }
}

impl Drop for Supervisor {
    fn drop(&mut self) {
        for kept in self.kept.lock().values() {
            kept.task.abort();
        }
    }
}
