//! Log lines of components: a bounded ring written from any thread, drained and printed by one of the LCM's
//! own.
//!
//! Invariant: writing never waits or allocates; lines that did not fit are counted and the count is logged.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::broadcast;
use trocar_model::ComponentId;
use trocar_model::plain::sentence;
use trocar_rt::mailbox::{EntryHead, Mailbox, Overflow, Push};
use trocar_rt::wake::Waker;

use trocar_lcm_api::{LogLine, News};

/// Most lines in the ring.
const DEPTH: usize = 1024;
/// Target of the host's own lines about a component: only printed, since their event and news are sent with
/// the change they tell of.
pub(super) const HOST: &str = "trocar::lcm";
/// Bytes of target and message together; the rest is cut.
const LINE_BYTES: usize = 504;
/// Number of the level info.
const INFO: u32 = 3;

pub(super) struct LogRing {
    mailbox: Mailbox,
    lost: AtomicU64,
    waker: Arc<Waker>,
    stop: AtomicBool,
    names: Mutex<Names>,
}

#[derive(Default)]
struct Names {
    known: BTreeMap<u32, ComponentId>,
    /// Components that are gone: their names are kept for their last lines in the ring.
    gone: Vec<u32>,
}

impl LogRing {
    pub(super) fn new() -> Arc<LogRing> {
        Arc::new(LogRing {
            mailbox: Mailbox::new(DEPTH, LINE_BYTES, 0),
            lost: AtomicU64::new(0),
            waker: Arc::new(Waker::new()),
            stop: AtomicBool::new(false),
            names: Mutex::default(),
        })
    }

    fn names(&self) -> MutexGuard<'_, Names> {
        self.names.lock()
    }

    /// Names a component, or notes that it is gone.
    pub(super) fn name(&self, number: u32, id: Option<&ComponentId>) {
        let mut names = self.names();
        match id {
            Some(id) => drop(names.known.insert(number, id.clone())),
            None => names.gone.push(number),
        }
        drop(names);
        self.waker.notify();
    }

    /// Forgets the names of components that were gone before all lines were printed.
    fn forget(&self, gone: Vec<u32>) {
        let mut names = self.names();
        if self.mailbox.is_empty() {
            gone.iter().for_each(|number| drop(names.known.remove(number)));
        } else {
            names.gone.extend(gone);
        }
    }

    /// Any thread. `level` is 1 error … 5 trace: lines up to info are kept whatever the program prints, since
    /// the events and `Logs` tell them, too.
    pub(super) fn push(&self, number: u32, level: u32, target: &[u8], message: &[u8]) {
        if level > INFO.max(log::max_level() as u32) {
            return;
        }
        let mut line = [0u8; LINE_BYTES];
        let target = &target[..target.len().min(64)];
        let message = &message[..message.len().min(LINE_BYTES - 2 - target.len())];
        line[0] = target.len() as u8;
        line[1..1 + target.len()].copy_from_slice(target);
        line[1 + target.len()..1 + target.len() + message.len()].copy_from_slice(message);
        let head = EntryHead {
            kind: level,
            index: number,
            reply: (1 + target.len() + message.len()) as u64,
            stamp_ns: wall_ns(),
        };
        match self.mailbox.push(head, &line, Overflow::Reject) {
            Push::Queued => super::context::wake(&self.waker),
            _ => {
                self.lost.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Prints and forwards lines until [`LogRing::close`]; the body of the LCM's log thread. `note` gets
    /// every line of a component of level info and above, with the number of the component.
    pub(super) fn run(&self, process: &str, news: &broadcast::Sender<News>, note: impl Fn(u32, u32, &str)) {
        loop {
            let print = |head: EntryHead, line: &[u8]| {
                let line = self.line(process, &head, line);
                log::log!(target: "component", level(line.level), "{}: {}", line.path, line.message);
                // The host itself sends its own lines about a component as an event.
                if line.target != HOST && line.level <= INFO {
                    note(head.index, line.level, &line.message);
                }
                // No receiver is fine: the line is printed already.
                let _ = news.send(News::Log(line));
            };
            let gone = std::mem::take(&mut self.names().gone);
            self.mailbox.drain(print, |_| ());
            self.forget(gone);
            let lost = self.lost.swap(0, Ordering::Relaxed);
            if lost > 0 {
                log::warn!(
                    "{lost} log lines of components were lost: they came faster than they could be written"
                );
            }
            if self.stop.load(Ordering::Acquire) {
                return;
            }
            self.waker.wait(None);
        }
    }

    pub(super) fn close(&self) {
        self.stop.store(true, Ordering::Release);
        self.waker.notify();
    }

    fn line(&self, process: &str, head: &EntryHead, bytes: &[u8]) -> LogLine {
        let end = (head.reply as usize).min(bytes.len());
        let split = 1 + bytes[0] as usize;
        let names = self.names();
        LogLine {
            wall_ns: head.stamp_ns,
            level: head.kind,
            path: names.known.get(&head.index).map_or_else(|| process.to_owned(), ComponentId::to_string),
            target: sentence(&bytes[1..split.min(end)]),
            message: sentence(&bytes[split.min(end)..end]),
        }
    }
}

fn level(n: u32) -> log::Level {
    match n {
        0 | 1 => log::Level::Error,
        2 => log::Level::Warn,
        3 => log::Level::Info,
        4 => log::Level::Debug,
        _ => log::Level::Trace,
    }
}

fn wall_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines that a ring prints after `tell`.
    fn printed(tell: impl FnOnce(&LogRing)) -> Vec<LogLine> {
        let (ring, (news, mut told)) = (LogRing::new(), broadcast::channel(64));
        tell(&ring);
        ring.close();
        ring.run("host", &news, |_, _, _| ());
        let lines = std::iter::from_fn(|| told.try_recv().ok());
        lines.filter_map(|news| if let News::Log(line) = news { Some(line) } else { None }).collect()
    }

    #[test]
    fn the_last_words_of_a_component_that_is_gone_are_under_its_own_name() {
        let id = ComponentId::parse("host/c").unwrap();
        let lines = printed(|ring| {
            ring.name(7, Some(&id));
            ring.push(7, 1, b"chaos", b"it burns");
            ring.name(7, None);
            ring.push(7, 1, b"chaos", b"and is gone");
        });
        let said: Vec<_> = lines.iter().map(|line| (line.path.as_str(), line.message.as_str())).collect();
        assert_eq!(said, [("host/c", "it burns"), ("host/c", "and is gone")]);
    }

    #[test]
    fn lines_up_to_info_are_told_where_the_program_prints_none() {
        assert_eq!(log::max_level(), log::LevelFilter::Off, "no test of this crate sets a logger");
        let lines = printed(|ring| (1..=5).for_each(|level| ring.push(0, level, b"chaos", b"words")));
        assert_eq!(lines.iter().map(|line| line.level).collect::<Vec<_>>(), [1, 2, 3]);
    }

    #[test]
    fn a_name_is_kept_no_longer_than_its_lines() {
        let ring = LogRing::new();
        ring.name(7, Some(&ComponentId::parse("host/c").unwrap()));
        ring.name(7, None);
        ring.close();
        ring.run("host", &broadcast::channel(1).0, |_, _, _| ());
        assert!(ring.names().known.is_empty() && ring.names().gone.is_empty());
    }
}
