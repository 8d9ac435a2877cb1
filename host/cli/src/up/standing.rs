//! State of a system, as its GCM tells it: processes and components, kept up to date over Watch.
//!
//! Invariant: the GCM is not polled. When it is gone, the last known state stays, marked as old; a GCM that
//! comes back tells everything anew.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::failure::Failure;
use crate::session::Session;
use crate::view::{ChangeView, ComponentView, ConnectionView, ProcessView, SystemView};

/// Pause between two attempts to hear a GCM that does not answer.
const PAUSE: Duration = Duration::from_millis(100);

/// The last known state.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Standing {
    /// False: the GCM does not answer, and all of this may be old.
    pub(super) heard: bool,
    /// Incarnation of the GCM; 0 = none was ever heard.
    pub(super) term: u64,
    pub(super) processes: BTreeMap<String, ProcessView>,
    /// By path.
    pub(super) components: BTreeMap<String, ComponentView>,
    /// By number.
    pub(super) connections: BTreeMap<u64, ConnectionView>,
    /// Cursor of the last news.
    pub(super) cursor: String,
}

#[cfg(test)]
impl Standing {
    /// One process with one component, as a GCM that is there tells it.
    pub(super) fn of_one(process: ProcessView, component: ComponentView) -> Standing {
        Standing {
            heard: true,
            term: 1,
            processes: [(process.name.clone(), process)].into(),
            components: [(component.path.clone(), component)].into(),
            ..Standing::default()
        }
    }
}

impl Standing {
    /// Takes a fresh answer of List from that GCM.
    pub(super) fn of(term: u64, listed: SystemView) -> Standing {
        let mut standing = Standing::default();
        let SystemView { revision, processes, components, connections, .. } = listed;
        let listed = ChangeView { revision, term, processes, components, connections, ..Default::default() };
        standing.take(listed);
        standing
    }

    /// Tells whether the GCM hears this incarnation of a process, and has given it what it is to have.
    pub(super) fn is_whole(&self, process: &str, pid: u32) -> bool {
        self.heard && self.processes.get(process).is_some_and(|p| p.state == "ATTACHED" && p.pid == pid)
    }

    /// Returns the components of a process.
    pub(super) fn within(&self, process: &str) -> impl Iterator<Item = &ComponentView> {
        let prefix = format!("{process}/");
        let from = self.components.range(prefix.clone()..);
        from.take_while(move |(path, _)| path.starts_with(&prefix)).map(|(_, c)| c)
    }

    fn take(&mut self, change: ChangeView) {
        if change.snapshot {
            (self.processes, self.components, self.connections) = Default::default();
        }
        (self.heard, self.term, self.cursor) = (true, change.term, change.cursor);
        self.processes.extend(change.processes.into_iter().map(|p| (p.name.clone(), p)));
        self.components.extend(change.components.into_iter().map(|c| (c.path.clone(), c)));
        self.connections.extend(change.connections.into_iter().map(|c| (c.id, c)));
        for name in change.removed_processes {
            self.processes.remove(&name);
        }
        for path in change.removed_components {
            self.components.remove(&path);
        }
        for id in change.removed_connections {
            self.connections.remove(&id);
        }
    }
}

/// Follows the state in the background, for as long as there is a receiver.
pub(super) fn follow(addr: &str) -> (watch::Receiver<Arc<Standing>>, JoinHandle<()>) {
    let (tell, told) = watch::channel(Arc::new(Standing::default()));
    let addr = addr.to_owned();
    let following = tokio::spawn(async move {
        while !tell.is_closed() {
            // A connection that was cut is made anew.
            let session = Session::new(Some(addr.clone()), false);
            if let Err(failure) = hear(&session, &tell).await {
                log::debug!("the GCM is not heard: {}", failure.message);
            }
            tell.send_if_modified(|now| std::mem::replace(&mut Arc::make_mut(now).heard, false));
            tokio::time::sleep(PAUSE).await;
        }
    });
    (told, following)
}

async fn hear(session: &Session, tell: &watch::Sender<Arc<Standing>>) -> Result<(), Failure> {
    let known = tell.borrow().cursor.clone();
    let mut changes = session.watch(&known).await?;
    while let Some(change) = changes.next().await? {
        tell.send_modify(|now| Arc::make_mut(now).take(change));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn component(path: &str, state: &str) -> ComponentView {
        ComponentView {
            path: path.into(),
            state: state.into(),
            health: "OK".into(),
            ..ComponentView::default()
        }
    }

    #[test]
    fn a_snapshot_replaces_all_and_a_delta_some() {
        let mut standing = Standing::default();
        let process = |state: &str| ProcessView {
            name: "a".into(),
            state: state.into(),
            pid: 7,
            ..ProcessView::default()
        };
        standing.take(ChangeView {
            term: 3,
            snapshot: true,
            processes: vec![process("ATTACHED")],
            components: vec![component("a/x", "ACTIVE"), component("a.b/y", "READY")],
            ..ChangeView::default()
        });
        assert!(standing.is_whole("a", 7) && !standing.is_whole("a", 8) && !standing.is_whole("b", 7));
        assert_eq!(standing.within("a").count(), 1, "a.b is another process");
        standing.take(ChangeView {
            term: 3,
            processes: vec![process("LOST")],
            removed_components: vec!["a/x".into()],
            ..ChangeView::default()
        });
        assert!(!standing.is_whole("a", 7));
        assert_eq!(standing.components.len(), 1);
        standing.take(ChangeView { term: 4, snapshot: true, ..ChangeView::default() });
        assert_eq!((standing.term, standing.components.len(), standing.processes.len()), (4, 0, 0));
    }
}
