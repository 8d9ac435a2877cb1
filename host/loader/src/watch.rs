//! Tells observers what changes in the plugin directories while the host runs.
//!
//! Invariant: events only say when to look; only a look finds what is there. So a lost event costs at most
//! the two seconds to the next look, and a network file system that raises none works too.

use std::collections::BTreeSet;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use notify::event::{AccessKind, AccessMode, EventKind, ModifyKind, RenameMode};
use notify::{RecommendedWatcher, RecursiveMode, Watcher};
use trocar_rt::house;

use super::file::is_library_name;
use super::scan::SETTLE;
use super::store::Observer;
use super::{CatalogChange, PluginStore};

/// Quiet time after the last event before a look.
const DEBOUNCE: Duration = Duration::from_millis(100);
/// A look comes at the latest this long after the first event of a busy directory.
const DEBOUNCE_LIMIT: Duration = Duration::from_millis(500);
/// Looks without any event.
const RESCAN: Duration = Duration::from_secs(2);
/// The same where the kernel gives no events.
const RESCAN_WITHOUT_EVENTS: Duration = Duration::from_millis(500);

/// Ends the watching when dropped.
pub struct WatchHandle {
    store: Arc<PluginStore>,
    id: u64,
    stop: Sender<Message>,
    thread: Option<JoinHandle<()>>,
}

enum Message {
    Event(notify::Result<notify::Event>),
    Stop,
}

impl PluginStore {
    /// Calls `callback` for every change from now on, on the watching thread (or on the thread of a
    /// `rescan`), in order. It must not call `rescan` or `watch`. What is listed now is in `list`.
    pub fn watch(self: &Arc<Self>, callback: impl Fn(&CatalogChange) + Send + 'static) -> WatchHandle {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        self.observers.lock().push(Observer { id, tell: Box::new(callback) });
        let (stop, messages) = channel();
        // Events are asked for before this returns: a copy that begins now is seen from its first byte.
        let watching = Watching::new(self.clone(), stop.clone());
        let run = move || watching.run(&messages);
        let thread = house::spawn(std::thread::Builder::new().name("trocar-watch".into()), run);
        let thread =
            thread.inspect_err(|e| log::error!("plugin directories are not watched, no thread: {e}")).ok();
        WatchHandle { store: self.clone(), id, stop, thread }
    }
}

impl Drop for WatchHandle {
    fn drop(&mut self) {
        // A send fails only when the thread has ended.
        let _ = self.stop.send(Message::Stop);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the thread that watches plugin directories panicked");
        }
        self.store.observers.lock().retain(|o| o.id != self.id);
    }
}

struct Watching {
    store: Arc<PluginStore>,
    /// None where the kernel has no inotify instance left.
    notify: Option<RecommendedWatcher>,
    /// Device and inode of each watched directory: a recreated one is another.
    watched: Vec<(PathBuf, Option<(u64, u64)>)>,
    /// Files closed by their writer since the last look.
    closed: BTreeSet<PathBuf>,
    first_event: Option<Instant>,
    next_look: Instant,
}

impl Watching {
    fn new(store: Arc<PluginStore>, events: Sender<Message>) -> Watching {
        let send = move |event| drop(events.send(Message::Event(event)));
        let notify = notify::recommended_watcher(send)
            .inspect_err(|e| {
                log::warn!("no change events ({e}); plugin directories are looked at every 0.5 s")
            })
            .ok();
        let watched = store.dirs().iter().map(|dir| (dir.clone(), None)).collect();
        let mut watching = Watching {
            store,
            notify,
            watched,
            closed: BTreeSet::new(),
            first_event: None,
            next_look: Instant::now(),
        };
        watching.watch_dirs();
        watching
    }

    fn run(mut self, messages: &Receiver<Message>) {
        loop {
            let wait = self.next_look.saturating_duration_since(Instant::now());
            match messages.recv_timeout(wait) {
                Ok(Message::Event(Ok(event))) => self.hear(&event),
                Ok(Message::Event(Err(error))) => {
                    log::debug!("change events: {error}");
                    self.look_soon();
                }
                Ok(Message::Stop) | Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => self.look(),
            }
        }
    }

    fn hear(&mut self, event: &notify::Event) {
        if event.need_rescan() {
            return self.look_soon();
        }
        let removed = matches!(event.kind, EventKind::Remove(_));
        for path in &event.paths {
            if !path.file_name().is_some_and(is_library_name) {
                // The directory itself went away, or was replaced.
                if removed && self.watched.iter().any(|(dir, _)| dir == path) {
                    self.look_soon();
                }
                continue;
            }
            match event.kind {
                EventKind::Access(AccessKind::Close(AccessMode::Write))
                | EventKind::Modify(ModifyKind::Name(RenameMode::To)) => {
                    self.store.writing.lock().remove(path);
                    self.closed.insert(path.clone());
                    self.look_soon();
                }
                EventKind::Modify(ModifyKind::Data(_)) => {
                    self.closed.remove(path);
                    self.store.writing.lock().insert(path.clone());
                }
                EventKind::Remove(_) | EventKind::Modify(ModifyKind::Name(_)) => {
                    self.store.writing.lock().remove(path);
                    self.closed.remove(path);
                    self.look_soon();
                }
                EventKind::Create(_) | EventKind::Modify(ModifyKind::Metadata(_)) => self.look_soon(),
                _ => {}
            }
        }
    }

    fn look_soon(&mut self) {
        let now = Instant::now();
        let first = *self.first_event.get_or_insert(now);
        self.next_look = (now + DEBOUNCE).min(first + DEBOUNCE_LIMIT);
    }

    fn look(&mut self) {
        self.watch_dirs();
        let unsettled = self.store.scan(&std::mem::take(&mut self.closed));
        self.first_event = None;
        let pause = match (unsettled, &self.notify) {
            (true, _) => SETTLE,
            (false, Some(_)) => RESCAN,
            (false, None) => RESCAN_WITHOUT_EVENTS,
        };
        self.next_look = Instant::now() + pause;
    }

    /// Begins to watch directories that are new since the last look.
    fn watch_dirs(&mut self) {
        let Some(notify) = &mut self.notify else { return };
        for (dir, known) in &mut self.watched {
            let now = identity(dir);
            if now == *known {
                continue;
            }
            if known.is_some() {
                // The kernel dropped the watch with the old directory; forget it here too.
                let _ = notify.unwatch(dir);
            }
            *known = now;
            if now.is_some()
                && let Err(error) = notify.watch(dir, RecursiveMode::NonRecursive)
            {
                log::warn!("no change events for {}: {error}", dir.display());
            }
        }
    }
}

fn identity(dir: &Path) -> Option<(u64, u64)> {
    std::fs::metadata(dir).ok().map(|meta| (meta.dev(), meta.ino()))
}
