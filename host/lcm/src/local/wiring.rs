//! Connections of this process: making them, cutting them, and the order they give to a shared thread.
//!
//! Invariant: changes of a running stream take effect between two of its cycles; ports that a cut leaves
//! unconnected are noted, and the watchdog handles them.

use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use tokio::sync::oneshot;
use trocar_model::{Connection, Refusal, idle_connection};

use super::super::connect::Wired;
use super::super::cycle::Member;
use super::super::loss::Loss;
use super::super::order::Place;
use super::super::{Report, order};
use super::{LocalLcm, Slot};

/// Longest wait for a shared thread to come to the end of its cycle.
const PATIENCE: Duration = Duration::from_millis(200);

impl LocalLcm {
    pub(super) async fn wire(&self, connection: Connection, deadline: Instant) -> Result<Report, Refusal> {
        let client = self.slot(&connection.client.component)?;
        let server = self.slot(&connection.server.component)?;
        let id = connection.id.0;
        let carriers = self.carriers.clone();
        let (from, to) = (server.here(), client.here());
        let ends = (connection.client.clone(), connection.server.clone());
        let connect = move || Wired::connect(&carriers, &connection, &to, &from);
        let wired = between_cycles(&client, &server, deadline, connect).await?;
        if wired.required {
            client.instance.connected(wired.client_port.as_str());
        }
        self.held().links.insert(id, Arc::new(wired));
        self.reorder(&client);
        let (to, from) = (client.instance.described.now(), server.instance.described.now());
        let mut report = client.instance.report(false);
        report.warnings.extend(idle_connection(&to.ports, &ends.0, &from.ports, &ends.1));
        Ok(report)
    }

    /// Cuts a connection between two cycles of the thread its ends share, if they do. `replaced`: another one
    /// is made next.
    pub(super) async fn unwire(&self, id: u64, replaced: bool, deadline: Instant) -> Option<Arc<Wired>> {
        let wired = self.held().links.remove(&id)?;
        match (self.slot(&wired.client.id), self.slot(&wired.server.id)) {
            (Ok(client), Ok(server)) => {
                let cut = wired.clone();
                between_cycles(&client, &server, deadline, move || cut.disconnect()).await;
            }
            _ => wired.disconnect(),
        }
        self.loosened(&wired, if replaced { Loss::Replaced } else { Loss::Cut });
        Some(wired)
    }

    /// Cuts a connection at once.
    pub(super) fn cut(&self, id: u64) -> Option<Arc<Wired>> {
        let wired = self.held().links.remove(&id)?;
        wired.disconnect();
        self.loosened(&wired, Loss::Cut);
        Some(wired)
    }

    /// Handles the results of a cut: the watchdog sees that a connection is missing.
    fn loosened(&self, wired: &Wired, how: Loss) {
        if let Ok(client) = self.slot(&wired.client.id) {
            if wired.required {
                client.instance.disconnected(wired.client_port.as_str(), how);
            }
            self.reorder(&client);
        }
    }

    /// Sorts the members of a shared thread along their streams.
    pub(super) fn reorder(&self, slot: &Slot) {
        let held = self.held();
        let shared: Vec<&Slot> =
            held.components.values().filter(|s| s.executor.id == slot.executor.id).collect();
        let streams: Vec<(u32, u32)> = held
            .links
            .values()
            .filter(|l| l.is_stream())
            .map(|l| (l.server.number, l.client.number))
            .collect();
        let number_of =
            |id: &str| shared.iter().find(|s| s.instance.id.to_string() == id).map(|s| s.instance.number);
        let places: Vec<(u32, Place)> =
            shared.iter().map(|s| (s.instance.number, s.place(number_of).0)).collect();
        let sorted: Vec<Member> = order::along(&places, &streams)
            .into_iter()
            .filter_map(|n| shared.iter().find(|s| s.instance.number == n))
            .map(|s| Member::new(s.instance.clone(), s.place(number_of).1))
            .collect();
        slot.executor.submit(move |crew| crew.members = sorted);
    }
}

/// Runs `f` between two cycles of the thread both ends share, so that no cycle sees half of it. Runs it on
/// this thread if they share none, or if that thread does not come to it in time.
async fn between_cycles<R: Send + 'static>(
    client: &Slot,
    server: &Slot,
    deadline: Instant,
    f: impl FnOnce() -> R + Send + 'static,
) -> R {
    if client.executor.id != server.executor.id {
        return f();
    }
    let work = Arc::new(Mutex::new(Some(f)));
    let (tell, told) = oneshot::channel();
    let theirs = work.clone();
    client.executor.submit(move |_| {
        if let Some(f) = take(&theirs) {
            // A caller that is gone meanwhile sees the links instead.
            let _ = tell.send(f());
        }
    });
    let until = deadline.min(Instant::now() + PATIENCE);
    let mut told = std::pin::pin!(told);
    loop {
        if let Ok(Ok(result)) = tokio::time::timeout_at(until.into(), told.as_mut()).await {
            return result;
        }
        // If `f` has not begun, it is done here. If it has, it ends soon: it is no component's code.
        if let Some(f) = take(&work) {
            return f();
        }
        tokio::task::yield_now().await;
    }
}

fn take<F>(work: &Mutex<Option<F>>) -> Option<F> {
    work.lock().take()
}
