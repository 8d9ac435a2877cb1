//! The end of a host: devices safe first, then everything else, whichever way the host comes to it.
//!
//! Invariant: a thread made with the host ends it, on a clock of its own. Ending therefore needs no runtime,
//! no new thread, and no caller that waits for it.

use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use trocar_loader::WatchHandle;
use trocar_rt::house;

use super::candidacy::Candidacy;
use super::{HostError, StateDir};
use crate::control::Server;
use crate::gcm::Gcm;
use crate::lcm::{LocalLcm, let_go_of_descriptors};

/// Time that components may take to stand still at the end.
pub(super) const SHUTDOWN: Duration = Duration::from_secs(5);
/// Time that a dropping thread waits for the host's end: components that hang are given up before.
const DROPPED: Duration = Duration::from_secs(10);

/// Parts of a host to end, as far as they were started.
pub(super) struct Running {
    pub(super) lcm: Option<Arc<LocalLcm>>,
    /// Its own GCM.
    pub(super) gcm: Option<Gcm>,
    /// True: everything that the host was to be was there.
    pub(super) is_up: bool,
    /// Its campaigns for the lead of a system.
    pub(super) candidacy: Option<Candidacy>,
    pub(super) uplink: Option<JoinHandle<()>>,
    pub(super) server: Option<Server>,
    pub(super) watch: Option<WatchHandle>,
    pub(super) announced: Option<JoinHandle<()>>,
    pub(super) state: Arc<StateDir>,
}

/// Ways to end open calls of the port.
#[derive(Clone, Copy)]
enum How {
    /// The calls get a moment, so that a caller can see the end happen.
    Orderly,
    /// At once: the thread that would carry the calls on may stand still until this is over.
    Abrupt,
}

/// The way to the thread that ends a host.
pub(super) struct Ending {
    running: Arc<Mutex<Running>>,
    order: mpsc::Sender<How>,
    ended: watch::Receiver<bool>,
    /// Closed with the thread, which sends nothing over it.
    alive: Mutex<mpsc::Receiver<()>>,
}

impl Ending {
    /// # Errors
    /// The machine gives no more threads.
    pub(super) fn prepare(state: Arc<StateDir>) -> Result<Ending, HostError> {
        let threads = |e: std::io::Error| HostError::Threads { because: e.to_string() };
        let nothing = Running {
            lcm: None,
            gcm: None,
            is_up: false,
            candidacy: None,
            uplink: None,
            server: None,
            watch: None,
            announced: None,
            state,
        };
        let running = Arc::new(Mutex::new(nothing));
        let (order, ordered) = mpsc::channel();
        let (tell, ended) = watch::channel(false);
        let (life, alive) = mpsc::channel::<()>();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().map_err(threads)?;
        let theirs = running.clone();
        let end = move || {
            let _life = life;
            let how = ordered.recv().unwrap_or(How::Abrupt);
            runtime.block_on(end(&theirs, how));
            tell.send_replace(true);
        };
        house::spawn(thread::Builder::new().name("trocar-end".into()), end).map_err(threads)?;
        Ok(Ending { running, order, ended, alive: Mutex::new(alive) })
    }

    pub(super) fn running(&self) -> MutexGuard<'_, Running> {
        self.running.lock()
    }

    pub(super) fn has_ended(&self) -> bool {
        *self.ended.borrow()
    }

    /// Ends it and waits; any number of times, from anywhere.
    pub(super) async fn end(&self) {
        // A thread that has ended does not listen.
        let _ = self.order.send(How::Orderly);
        // An error means the same: the thread is gone.
        let _ = self.ended.clone().wait_for(|ended| *ended).await;
    }

    /// As `end`, but blocks, since the caller may be a thread of a runtime, and gives up after a while.
    pub(super) fn end_now(&mut self) {
        let _ = self.order.send(How::Abrupt);
        let alive = self.alive.get_mut();
        if alive.recv_timeout(DROPPED) == Err(RecvTimeoutError::Timeout) {
            log::error!(
                "the dropped host has not ended within {} s and is left to end by itself",
                DROPPED.as_secs()
            );
        }
    }
}

async fn end(running: &Mutex<Running>, how: How) {
    let_go_of_descriptors();
    let (lcm, gcm, is_up, candidacy, uplink, server, watch, announced, state) = {
        let mut r = running.lock();
        let r = &mut *r;
        let state = r.state.clone();
        let (lcm, gcm, candidacy) = (r.lcm.take(), r.gcm.take(), r.candidacy.take());
        (
            lcm,
            gcm,
            r.is_up,
            candidacy,
            r.uplink.take(),
            r.server.take(),
            r.watch.take(),
            r.announced.take(),
            state,
        )
    };
    if let Some(task) = &announced {
        task.abort();
    }
    if let Some(candidacy) = candidacy {
        match how {
            How::Orderly => candidacy.end().await,
            How::Abrupt => candidacy.cut(),
        }
    }
    if let Some(lcm) = &lcm {
        lcm.shutdown(SHUTDOWN).await;
    }
    if let Some(task) = uplink {
        task.abort();
        if matches!(how, How::Orderly) {
            // The task is to end as aborted; a runtime that stands still does not get to it.
            let _ = tokio::time::timeout(Duration::from_secs(1), task).await;
        }
    }
    if let Some(server) = server {
        match how {
            How::Orderly => server.shutdown().await,
            How::Abrupt => server.cut(),
        }
    }
    // Nothing is decided any more.
    if let Some(gcm) = gcm {
        if let Some(lcm) = lcm.as_ref().filter(|_| is_up) {
            // It ended in order: nothing of it is to come back.
            gcm.left(lcm.process(), 0);
        }
        gcm.close_journal().await;
    }
    drop(lcm);
    // Joins the watching thread.
    drop(watch);
    state.release();
}
