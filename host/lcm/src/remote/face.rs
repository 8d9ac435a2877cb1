//! Data of a server shown to clients in other processes: its state, its rows for clients that have its class,
//! and the results of its reads for the others.
//!
//! Invariant: rows and results are written by the thread that publishes a row of the state table, and that
//! thread never waits; the state is written by the thread that publishes it; the statistics by the watchdog.

use std::sync::Arc;

use parking_lot::Mutex;
use trocar_loader::system;
use trocar_rt::os;
use trocar_rt::segment::Word;
use trocar_rt::state::StateWriter;
use trocar_rt::wake::Waker;

use super::super::boundary::{ERR_BYTES, Reader, read_published};
use super::super::context;
use super::super::core::{Core, ShownRows, View};
use super::super::inbox::Position;
use super::super::kept::Kept;

/// Time between two publications of period statistics, ns: they are sums over many cycles.
const STATISTICS_NS: u64 = 10_000_000;

/// A read whose results are published.
pub(super) struct Shown {
    pub(super) from: Reader,
    pub(super) bytes: usize,
    pub(super) table: StateWriter,
    /// Sentences of failed reads.
    pub(super) whys: StateWriter,
    /// True when the read panicked last time.
    panicked: bool,
}

/// One client's view of a server.
pub(super) struct Face {
    standing: Word,
    /// Positions of the reads that the client computes itself.
    own: Vec<(Arc<Position>, Word)>,
    rows: Option<Arc<ShownRows>>,
    /// Published with rows of the state table.
    results: Option<Kept<Vec<Shown>>>,
    /// Published with the state.
    status: Mutex<Vec<Shown>>,
    figures: Option<Kept<Figures>>,
    /// Bell of whoever stands in for the client here, and takes all this to another machine.
    bell: Option<Arc<Waker>>,
}

struct Figures {
    shown: Vec<Shown>,
    /// Time of the last publication, ns.
    at_ns: u64,
}

fn unless_empty<T>(all: Vec<Shown>, make: impl FnOnce(Vec<Shown>) -> T) -> Option<Kept<T>> {
    if all.is_empty() { None } else { Some(Kept::new(make(all))) }
}

impl Face {
    /// `own`: the reads that the client computes itself from `rows`.
    pub(super) fn new(
        standing: Word,
        shown: Vec<Shown>,
        own: Vec<(Arc<Position>, Word)>,
        rows: Option<Arc<ShownRows>>,
        bell: Option<Arc<Waker>>,
    ) -> Arc<Face> {
        let is = |shown: &Shown, which| matches!(shown.from, Reader::System(system) if system == which);
        let (status, rest): (Vec<_>, Vec<_>) = shown.into_iter().partition(|s| is(s, system::GET_STATE));
        let (figures, results) = rest.into_iter().partition(|s| is(s, system::PERIOD_STATISTICS));
        let face = Face {
            standing,
            own,
            rows,
            results: unless_empty(results, |all| all),
            status: Mutex::new(status),
            figures: unless_empty(figures, |shown| Figures { shown, at_ns: 0 }),
            bell,
        };
        face.show_positions();
        Arc::new(face)
    }
}

impl View<Core> for Face {
    fn rows(&self) -> Option<&Arc<ShownRows>> {
        self.rows.as_ref()
    }

    /// Shows the present positions of the reads that the client computes itself.
    fn show_positions(&self) {
        for (position, word) in &self.own {
            loop {
                let now = position.get();
                word.set(now.map_or(0, |id| u64::from(id) + 1));
                // A thread that moves a position comes here afterwards.
                if position.get() == now {
                    break;
                }
            }
        }
    }

    /// Shows the present state of the server. A thread that changes it comes here afterwards, so the last one
    /// to come shows the last change.
    fn show_standing(&self, server: &Core) {
        loop {
            let now = server.presence();
            self.standing.set(now as u64);
            if server.presence() == now {
                break;
            }
        }
        self.status.lock().iter_mut().for_each(|read| read.publish(server));
        if let Some(bell) = &self.bell {
            bell.notify();
        }
    }

    /// Shows the present results of the reads. Real-time.
    fn show_row(&self, server: &Core) {
        if let Some(results) = &self.results {
            results.write(|shown| shown.iter_mut().for_each(|read| read.publish(server)));
            if let Some(bell) = &self.bell {
                context::wake(bell);
            }
        }
    }

    /// Shows the present statistics, unless they were shown a moment ago. Never on a thread that steps: they
    /// are sums over many cycles.
    fn show_figures(&self, server: &Core) {
        let Some(figures) = &self.figures else { return };
        figures.write(|figures| {
            let now_ns = os::now_ns();
            if now_ns >= figures.at_ns + STATISTICS_NS {
                figures.at_ns = now_ns;
                figures.shown.iter_mut().for_each(|read| read.publish(server));
            }
        });
    }
}

impl Shown {
    pub(super) fn new(from: Reader, bytes: usize, table: StateWriter, whys: StateWriter) -> Shown {
        Shown { from, bytes, table, whys, panicked: false }
    }

    fn publish(&mut self, server: &Core) {
        let (from, bytes, again) = (&self.from, self.bytes, self.panicked);
        let mut text = [0; ERR_BYTES];
        let (whys, panicked) = (&mut self.whys, &mut self.panicked);
        self.table.publish_with(|row| {
            let read = read_published(server, from, &[], &mut row[..bytes], &mut text, again);
            *panicked = read.panicked;
            if read.text_bytes > 0 {
                // The sentence comes before the outcome, so that a reader that sees the outcome finds the
                // sentence.
                whys.publish_with(|why| {
                    let said = read.text_bytes.min(why.len());
                    why[..said].copy_from_slice(&text[..said]);
                    Some((read.stamp_ns, said as u64))
                });
            }
            // The outcome is the part that a step of the reader looks at.
            Some((read.stamp_ns, read.outcome as u64))
        });
    }
}
