//! Watch: a snapshot, then the changes between one state of the graph and the next.
//!
//! Invariant: the difference is a pure function of two graphs; a slow watcher misses states between, never a
//! change.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, mpsc, watch};
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;
use trocar_model::{Connection, SystemGraph};
use trocar_proto::v1;
use trocar_proto::v1::watch_response::News;

use super::page;
use crate::control::convert;

pub(super) type WatchStream = Pin<Box<dyn Stream<Item = Result<v1::WatchResponse, Status>> + Send>>;

/// A watcher that knows revision `from` already gets no snapshot when nothing is newer; messages have `size`
/// items at most, 0 = any number.
pub(super) fn watch(
    mut graphs: watch::Receiver<Arc<SystemGraph>>,
    term: u64,
    from: u64,
    size: usize,
    held: OwnedSemaphorePermit,
) -> WatchStream {
    let (tell, told) = mpsc::channel(4);
    tokio::spawn(async move {
        let _held = held;
        let mut seen = graphs.borrow_and_update().clone();
        if from == 0 || from != seen.revision {
            for news in snapshots(&seen, size) {
                if tell.send(Ok(message(&seen, term, news))).await.is_err() {
                    return;
                }
            }
        }
        loop {
            tokio::select! {
                () = tell.closed() => return,
                changed = graphs.changed() => if changed.is_err() { return },
            }
            let now = graphs.borrow_and_update().clone();
            // The revision reports an accepted change even when the news of it came before.
            let changed = delta(&seen, &now);
            if changed.is_some() || now.revision != seen.revision {
                for delta in page::deltas(changed.unwrap_or_default(), size) {
                    if tell.send(Ok(message(&now, term, News::Delta(delta)))).await.is_err() {
                        return;
                    }
                }
            }
            seen = now;
        }
    });
    Box::pin(ReceiverStream::new(told))
}

fn message(graph: &SystemGraph, term: u64, news: News) -> v1::WatchResponse {
    v1::WatchResponse { revision: graph.revision, term, news: Some(news) }
}

fn snapshots(graph: &SystemGraph, size: usize) -> impl Iterator<Item = News> {
    let list = convert::list(graph, graph, 0, &convert::Figures::default());
    let whole = v1::Snapshot {
        processes: list.processes,
        components: list.components,
        connections: list.connections,
        more: false,
    };
    page::snapshots(whole, size).into_iter().map(News::Snapshot)
}

fn delta(before: &SystemGraph, after: &SystemGraph) -> Option<v1::Delta> {
    let (p, c, l) = (&after.processes, &after.components, &after.connections);
    let delta = v1::Delta {
        processes: changed(&before.processes, p).map(|(n, p)| convert::process(n, p)).collect(),
        components: changed(&before.components, c).map(|(id, c)| convert::component(id, c, None)).collect(),
        connections: connections(before, after).map(|c| convert::connection(after, c, None)).collect(),
        removed_processes: removed(&before.processes, p).map(ToString::to_string).collect(),
        removed_components: removed(&before.components, c).map(ToString::to_string).collect(),
        removed_connections: removed(&before.connections, l).map(|id| id.0).collect(),
        more: false,
    };
    (delta != v1::Delta::default()).then_some(delta)
}

/// Returns the connections that changed, or whose halves changed.
fn connections<'a>(before: &'a SystemGraph, after: &'a SystemGraph) -> impl Iterator<Item = &'a Connection> {
    let same = |c: &&Connection| {
        before.connections.get(&c.id) == Some(c) && before.proxies_of(c) == after.proxies_of(c)
    };
    after.connections.values().filter(move |c| !same(c))
}

fn changed<'a, K: Ord, V: PartialEq>(
    before: &'a BTreeMap<K, V>,
    after: &'a BTreeMap<K, V>,
) -> impl Iterator<Item = (&'a K, &'a V)> {
    after.iter().filter(|(k, v)| before.get(k) != Some(v))
}

fn removed<'a, K: Ord, V>(
    before: &'a BTreeMap<K, V>,
    after: &'a BTreeMap<K, V>,
) -> impl Iterator<Item = &'a K> {
    before.keys().filter(|k| !after.contains_key(k))
}
