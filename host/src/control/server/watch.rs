//! Watch: a snapshot, or what has changed since the caller's cursor, then the changes from one state of the
//! graph to the next.
//!
//! Invariant: a slow watcher misses states between, never a change. What a change costs a watcher depends on
//! the change, not on the system.

use std::collections::BTreeSet;
use std::pin::Pin;
use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, mpsc, watch};
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;
use trocar_model::{Refusal, SystemGraph, Touched};
use trocar_proto::v1;
use trocar_proto::v1::watch_response::News;

use super::{page, refuse};
use crate::control::convert;
use crate::gcm::{Gcm, History};

pub(super) type WatchStream = Pin<Box<dyn Stream<Item = Result<v1::WatchResponse, Status>> + Send>>;

/// One who follows the graph.
struct Watcher {
    graphs: watch::Receiver<Arc<SystemGraph>>,
    /// Ends with the port, or with the lead of its GCM.
    closing: watch::Receiver<()>,
    history: Arc<History>,
    term: u64,
    /// Most items in a message; 0 = any number.
    size: usize,
    tell: mpsc::Sender<Result<v1::WatchResponse, Status>>,
}

/// Answers a Watch for as long as it is read, and the port answers for this GCM.
///
/// # Errors
/// The request says something that cannot be.
pub(super) fn watch(
    gcm: &Gcm,
    request: &v1::WatchRequest,
    closing: watch::Receiver<()>,
    held: OwnedSemaphorePermit,
) -> Result<WatchStream, Status> {
    let invalid = |why: String, field: &str| Refusal::ArgumentInvalid {
        what: "Watch".into(),
        why,
        field: field.into(),
    };
    let size = request
        .page_size
        .try_into()
        .map_err(|_| refuse(invalid("it is negative; 0 means each in one message".into(), "page_size")))?;
    let seen = match request.after.as_str() {
        "" => None,
        cursor => gcm.history().seen(cursor).map_err(|_| {
            let why = format!("{cursor:?} is no cursor: give that of an answer of Watch or List, or none");
            refuse(invalid(why, "after"))
        })?,
    };
    let (tell, told) = mpsc::channel(4);
    let history = gcm.history().clone();
    let watcher = Watcher { graphs: gcm.watch(), closing, history, term: gcm.term(), size, tell };
    tokio::spawn(async move {
        let _held = held;
        watcher.run(seen).await;
    });
    Ok(Box::pin(ReceiverStream::new(told)))
}

impl Watcher {
    async fn run(mut self, mut seen: Option<u64>) {
        let (mut revision, mut is_first) = (0, true);
        loop {
            let now = self.graphs.borrow_and_update().clone();
            let told = match seen.and_then(|seen| self.history.since(seen, &now)) {
                // The revision reports an accepted change even when the news of it came before.
                Some(touched) if is_first || !touched.is_empty() || now.revision != revision => {
                    self.say(&now, page::deltas(delta(&now, &touched), self.size), News::Delta).await
                }
                Some(_) => Ok(()),
                None => self.say(&now, page::snapshots(whole(&now), self.size), News::Snapshot).await,
            };
            if told.is_err() {
                return;
            }
            (seen, revision, is_first) = (Some(now.seen), now.revision, false);
            drop(now);
            tokio::select! {
                () = self.tell.closed() => return,
                _ = self.closing.changed() => return,
                changed = self.graphs.changed() => if changed.is_err() { return },
            }
        }
    }

    /// # Errors
    /// Nobody reads any more.
    async fn say<T>(
        &self,
        graph: &SystemGraph,
        pages: Vec<T>,
        news: impl Fn(T) -> News,
    ) -> Result<(), mpsc::error::SendError<Result<v1::WatchResponse, Status>>> {
        let last = pages.len().saturating_sub(1);
        for (at, page) in pages.into_iter().enumerate() {
            let cursor = if at == last { self.history.cursor(graph) } else { String::new() };
            let message = v1::WatchResponse {
                revision: graph.revision,
                term: self.term,
                news: Some(news(page)),
                cursor,
            };
            self.tell.send(Ok(message)).await?;
        }
        Ok(())
    }
}

fn whole(graph: &SystemGraph) -> v1::Snapshot {
    let list = convert::list(graph, graph, 0, &convert::Figures::default());
    v1::Snapshot {
        processes: list.processes,
        components: list.components,
        connections: list.connections,
        more: false,
    }
}

fn delta(graph: &SystemGraph, touched: &Touched) -> v1::Delta {
    let (processes, removed_processes) = parted(&touched.processes, |name| graph.processes.get(name));
    let (components, removed_components) = parted(&touched.components, |id| graph.components.get(id));
    let (connections, removed_connections) = parted(&touched.connections, |id| graph.connections.get(id));
    v1::Delta {
        processes: processes.into_iter().map(|(name, p)| convert::process(name, p)).collect(),
        components: components.into_iter().map(|(id, c)| convert::component(id, c, None)).collect(),
        connections: connections.into_iter().map(|(_, c)| convert::connection(graph, c, None)).collect(),
        removed_processes: removed_processes.into_iter().map(ToString::to_string).collect(),
        removed_components: removed_components.into_iter().map(ToString::to_string).collect(),
        removed_connections: removed_connections.into_iter().map(|id| id.0).collect(),
        more: false,
    }
}

/// Parts what was touched into what is there and what is gone.
fn parted<'a, K, V>(
    touched: &'a BTreeSet<K>,
    get: impl Fn(&K) -> Option<&'a V>,
) -> (Vec<(&'a K, &'a V)>, Vec<&'a K>) {
    let (mut there, mut gone) = (Vec::new(), Vec::new());
    for key in touched {
        match get(key) {
            Some(value) => there.push((key, value)),
            None => gone.push(key),
        }
    }
    (there, gone)
}
