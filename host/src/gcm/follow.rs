//! Follows the news of the processes and enters it in the graph.
//!
//! Invariant: news of a lost or replaced session changes nothing; news that was told before an answer is
//! entered before it.

use std::sync::{Arc, Weak};

use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio::sync::{mpsc, oneshot};
use trocar_lcm_api::{Decision, HalfReport, Inventory, Lcm, News, Report};
use trocar_model::{Change, Component, ComponentId, ConnectionId, Health, Name, SystemGraph};

use super::Gcm;
use super::manager::Inner;
use super::observed::{After, observe, stand_by};
use super::reconcile::nameless;

/// Follows the news of a session until it ends, and answers each question in `asked` when all present news
/// has been entered.
pub(super) async fn follow(
    gcm: Weak<Inner>,
    process: Name,
    session: u64,
    lcm: Weak<dyn Lcm>,
    mut news: Receiver<News>,
    mut asked: mpsc::Receiver<oneshot::Sender<()>>,
) {
    loop {
        let (heard, tell) = tokio::select! {
            heard = news.recv() => (Some(heard), None),
            tell = asked.recv() => match tell {
                Some(tell) => (None, Some(tell)),
                // Lost, or replaced.
                None => return,
            },
        };
        // This keeps neither alive: an embedded GCM and its LCM go with their host.
        let (Some(inner), Some(lcm)) = (gcm.upgrade(), lcm.upgrade()) else { return };
        let gcm = Gcm { inner };
        if !gcm.hears(&process, session) {
            return;
        }
        let (mut lagged, mut first) = (false, None);
        match heard {
            Some(Ok(news)) => first = Some(news),
            Some(Err(RecvError::Lagged(_))) => lagged = true,
            Some(Err(RecvError::Closed)) => return gcm.lost(&process, session),
            None => {}
        }
        let mut loose = Vec::new();
        lagged |= gcm.enter_all(&process, first, &mut news, &mut loose);
        if lagged {
            gcm.enter_inventory(&process, &*lcm, &mut loose).await;
        }
        gcm.cut_off(loose);
        if let Some(tell) = tell {
            // The caller that asked may have given up.
            let _ = tell.send(());
        }
    }
}

impl Gcm {
    /// Enters `first` and all news that is queued now; true: some of it was lost.
    fn enter_all(
        &self,
        process: &Name,
        first: Option<News>,
        news: &mut Receiver<News>,
        loose: &mut Vec<After>,
    ) -> bool {
        let mut lagged = false;
        self.edit_if(|graph| {
            // An LCM tells its news before it answers. So all that is queued now is entered before any later
            // answer is, and no state that was passed long ago comes back.
            let mut changed = first.is_some_and(|first| enter(self, graph, process, first, loose));
            for _ in 0..news.len() {
                match news.try_recv() {
                    Ok(next) => changed |= enter(self, graph, process, next, loose),
                    Err(e) => lagged |= matches!(e, TryRecvError::Lagged(_)),
                }
            }
            changed
        });
        lagged
    }

    /// Asks the LCM for all it has, after some of its news was lost.
    async fn enter_inventory(&self, process: &Name, lcm: &dyn Lcm, loose: &mut Vec<After>) {
        let Inventory { components, classes, halves, warnings, stopped_here, .. } =
            match lcm.inventory().await {
                Ok(inventory) => inventory,
                Err(refusal) => return log::warn!("the inventory of {process} cannot be had: {refusal}"),
            };
        self.edit(|graph| {
            graph.proxies.retain(|_, half| half.process != *process);
            for half in halves {
                let key = (ConnectionId(half.connection), half.end);
                graph.proxies.extend(half.proxy.map(|proxy| (key, proxy)));
            }
            let mut sessions = self.inner.sessions.lock();
            let newest: Vec<_> = components.iter().filter(|report| sessions.is_newest(report)).collect();
            drop(sessions);
            loose.extend(newest.into_iter().flat_map(|report| observe(graph, report)));
            if let Some(p) = graph.processes.get_mut(process) {
                (p.classes, p.warnings) = (classes, warnings);
            }
        });
        self.heard_stop(process, stopped_here);
        self.look_again(process, &components);
    }

    /// Has looked at again what a process has otherwise than is listed: what was done late may be among the
    /// news that was lost.
    fn look_again(&self, process: &Name, has: &[Report]) {
        let graph = self.graph();
        for report in has.iter().filter(|report| !graph.components.contains_key(&report.id)) {
            let component = Box::new(nameless(report.state));
            self.straighten(process, Change::Create { id: report.id.clone(), component }, Decision::NONE);
        }
        // One that could not be made again is listed with the reason.
        let lacks = |id: &ComponentId, c: &Component| {
            id.process == *process && c.health != Health::Lost && !has.iter().any(|report| report.id == *id)
        };
        for (id, component) in graph.components.iter().filter(|(id, component)| lacks(id, component)) {
            let component = Box::new(component.clone());
            self.straighten(process, Change::Destroy { id: id.clone(), component }, Decision::NONE);
        }
    }
}

/// True: the graph is different.
fn enter_half(graph: &mut Arc<SystemGraph>, process: &Name, half: HalfReport) -> bool {
    let key = (ConnectionId(half.connection), half.end);
    // Nobody tells of another process's half, not that it is gone either.
    if graph.proxies.get(&key).is_some_and(|known| known.process != *process) {
        return false;
    }
    if graph.proxies.get(&key) == half.proxy.as_ref() {
        return false;
    }
    let proxies = &mut Arc::make_mut(graph).proxies;
    match half.proxy {
        Some(proxy) => proxies.insert(key, proxy),
        None => _ = proxies.remove(&key),
    }
    true
}

/// True: the graph is different.
fn enter(
    gcm: &Gcm,
    graph: &mut Arc<SystemGraph>,
    process: &Name,
    news: News,
    loose: &mut Vec<After>,
) -> bool {
    match news {
        News::Late(change, decision, report) => {
            enter(gcm, graph, process, News::State(report), loose);
            loose.push(After::Late(process.clone(), change, decision));
        }
        News::State(report) => {
            let is_newest = gcm.inner.sessions.lock().is_newest(&report);
            let graph = Arc::make_mut(graph);
            let known = graph.components.get(&report.id).cloned();
            loose.extend(observe(graph, &report));
            if !is_newest {
                stand_by(graph, &report.id, known);
            }
        }
        News::Catalog(classes) => {
            if let Some(p) = Arc::make_mut(graph).processes.get_mut(process) {
                p.classes = classes;
            }
        }
        News::Log(line) => {
            gcm.lines().keep(line);
            return false;
        }
        News::Half(half) => return enter_half(graph, process, half),
        News::StoppedHere(told) => {
            gcm.heard_stop(process, told);
            return false;
        }
        News::Warnings(warnings) => {
            if let Some(p) = Arc::make_mut(graph).processes.get_mut(process) {
                p.warnings = warnings;
            }
        }
    }
    true
}
