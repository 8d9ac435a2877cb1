//! Ports that change while their component lives: descriptions on request, connections of lost ports, losses
//! of queues.
//!
//! Invariant: the component's own thread describes and binds; this one only asks for it, cuts and reports. It
//! waits for no component.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use trocar_model::{ComponentId, State};
use trocar_rt::wake::Waker;
use trocar_rt::{house, os};

use super::super::inbox::{Inbox, Party};
use super::super::instance::Instance;
use super::super::watch::Entry;
use super::super::{News, dynamic};
use super::LocalLcm;

/// Time between looks at queues for unreported losses, ns.
const LOOK_NS: u64 = 1_000_000_000;
/// As above while a cycle under way still looks at cut wires, ns.
const SOON_NS: u64 = 10_000_000;
/// Longest wait of a job for a caller inside a component that runs in others' threads, ns.
const PATIENCE_NS: u64 = 1_000_000_000;

/// The thread that follows changing ports.
pub(crate) struct Follower {
    waker: Arc<Waker>,
    closing: Arc<AtomicBool>,
    thread: Mutex<Option<thread::JoinHandle<()>>>,
}

impl Follower {
    /// `waker`: notified to request a look.
    pub(crate) fn new(waker: Arc<Waker>) -> Follower {
        Follower { waker, closing: Arc::new(AtomicBool::new(false)), thread: Mutex::new(None) }
    }

    /// # Errors
    /// The machine gives no more threads.
    pub(crate) fn start(&self, lcm: &Arc<LocalLcm>) -> std::io::Result<()> {
        let (waker, closing, lcm) = (self.waker.clone(), self.closing.clone(), Arc::downgrade(lcm));
        let thread = house::spawn(thread::Builder::new().name("trocar-ports".into()), move || {
            let mut pause_ns = LOOK_NS;
            loop {
                waker.wait(Some(os::now_ns() + pause_ns));
                let Some(lcm) = lcm.upgrade().filter(|_| !closing.load(Ordering::Acquire)) else { return };
                pause_ns = if lcm.follow_ports() { SOON_NS } else { LOOK_NS };
            }
        })?;
        *self.thread.lock() = Some(thread);
        Ok(())
    }

    pub(crate) fn stop(&self) {
        self.closing.store(true, Ordering::Release);
        self.waker.notify();
        let thread = self.thread.lock().take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            log::error!("the thread that follows changing ports panicked");
        }
    }
}

impl LocalLcm {
    /// Looks once: asks for descriptions, cuts the connections of lost ports, reports losses, drops what was
    /// cut before, tends carriers. True while some of that is still in use.
    fn follow_ports(&self) -> bool {
        let mut in_use = 0;
        let now_ns = os::now_ns();
        let slots: Vec<_> = self.held().components.values().cloned().collect();
        for slot in slots {
            let instance = slot.instance;
            if instance.described.takes_wish() {
                let job = instance.clone();
                slot.executor.submit(move |_| redescribe(&job));
            }
            if instance.described.changed_by_itself() {
                let lost_connections = self.cut_lost(&instance);
                let report = super::super::Report { lost_connections, ..instance.report(true) };
                // A failure is fine without listeners: the inventory has the report.
                let _ = self.hub.news.send(News::State(report));
            }
            self.lock_pools(&instance);
            instance.full_queues(now_ns).iter().for_each(|inbox| tell_full(&instance, inbox));
            instance.queues().iter().for_each(|inbox| inbox.tell_failures(&*instance));
            in_use += instance.reclaim();
        }
        in_use += self.reclaim_left();
        self.carriers.tend() || in_use > 0
    }

    /// Drops what removed components and their remains hold of others, if no cycle looks at it any more;
    /// returns the number of those where one does.
    fn reclaim_left(&self) -> usize {
        self.reclaim_leaving() + self.remains.reclaim()
    }

    fn reclaim_leaving(&self) -> usize {
        let leaving = self.held().leaving.clone();
        let left: Vec<_> = leaving.into_iter().filter(|instance| instance.reclaim() == 0).collect();
        let mut held = self.held();
        // They stay in the list during the look: a second thread that looks finds them as well.
        held.leaving.retain(|instance| !left.iter().any(|l| Arc::ptr_eq(l, instance)));
        held.leaving.len()
    }

    /// Waits until then for the cycles that may still look at cut wires, and so at what is dropped next. No
    /// later look follows.
    pub(super) async fn drop_left(&self, until: Instant) {
        loop {
            match self.reclaim_left() {
                0 => return,
                in_use if Instant::now() >= until => {
                    log::warn!("a cycle that does not end still uses what {in_use} removed components held");
                    return;
                }
                _ => tokio::time::sleep(Duration::from_millis(1)).await,
            }
        }
    }

    #[cfg(test)]
    pub(crate) fn is_followed(&self) -> bool {
        !self.follower.closing.load(Ordering::Acquire)
    }

    /// Locks frame pools into memory if the process asked for it and is not locked as a whole.
    pub(super) fn lock_pools(&self, instance: &Instance) {
        if self.memory.is_in_pieces() {
            instance.lock_pools();
        }
    }

    /// Cuts the connections of ports lost since the last call; returns their numbers. If an interface only
    /// has other members than before, those connections stay whose own members have all stayed.
    pub(super) fn cut_lost(&self, instance: &Instance) -> Vec<u64> {
        let lost = instance.described.take_lost();
        if lost.is_empty() {
            return Vec::new();
        }
        let remote = self.carriers.halves().flat_map(|halves| halves.cut_misfits(&instance.id, &lost));
        let remote: Vec<u64> = remote.collect();
        let gone = |id: &ComponentId, port: &str| *id == instance.id && lost.iter().any(|l| l == port);
        let held = self.held();
        let links = held.links.values().filter(|l| {
            gone(&l.client.id, l.client_port.as_str()) || gone(&l.server.id, l.server_port.as_str())
        });
        let links: Vec<u64> = links.filter(|l| !l.still_fits()).map(|l| l.id).collect();
        drop(held);
        links.into_iter().filter(|id| self.cut(*id).is_some()).chain(remote).collect()
    }
}

/// Warns both ends of a queue that was full.
fn tell_full(to: &Instance, inbox: &Inbox) {
    let ((from, name), lost) = (inbox.sender(), inbox.losses());
    let (what, why) = match inbox.events {
        true => ("events", format!(": {lost} so far were lost, as they came faster than its handlers ran")),
        false => ("commands", format!(": {lost} so far were refused, as they came faster than they ran")),
    };
    let say = |who: &dyn Party, stem: String| who.warn_about(&stem, &why);
    say(to, format!("its queue for {what} from {name} was full"));
    if let Some(from) = from {
        say(&*from, format!("it flooded {} with {what}", to.id));
    }
}

/// Describes and binds anew on the component's own thread, then wakes the follower for the outcome.
fn redescribe(instance: &Instance) {
    match instance.object.enter_until(os::now_ns() + PATIENCE_NS) {
        None => instance.described.wish(),
        // Reset describes a failed component anew; a removed one is not described any more.
        Some(_) if instance.is_closed() || instance.state() == State::Fault => {}
        Some(mut entered) => {
            let done = instance.as_running(Entry::Configure, || dynamic::describe(instance, &mut entered));
            match done {
                Ok(()) => instance.described.tell_change(),
                Err((entry, e)) => instance.fail(&mut entered, entry, &e),
            }
            instance.leave(entered);
        }
    }
    instance.look_at_ports();
}
