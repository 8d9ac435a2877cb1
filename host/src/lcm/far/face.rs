//! What a server shows to clients in other processes: how it stands, and the results of its reads.
//!
//! Invariant: results are written by whoever publishes a row of the state table, under the entry lock; how it stands by whoever
//! publishes that. The former never waits.

use std::sync::{Arc, Mutex, PoisonError};

use trocar_rt::exclusive::TryCell;
use trocar_rt::os;
use trocar_rt::segment::Word;
use trocar_rt::state::StateWriter;

use super::super::boundary::{Reader, read_published};
use super::super::instance::Instance;
use super::super::system;

/// Time between two publications of period statistics, ns: they are sums over many cycles.
const STATISTICS_NS: u64 = 10_000_000;

/// How a server stands, in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub(in crate::lcm) enum Standing {
    NotActive = 0,
    Active = 1,
    /// It is removed, or about to be.
    Gone = 2,
}

impl Standing {
    pub(in crate::lcm) fn of(word: u64) -> Standing {
        match word {
            1 => Standing::Active,
            2 => Standing::Gone,
            _ => Standing::NotActive,
        }
    }
}

/// A read whose results are published.
pub(super) struct Shown {
    pub(super) from: Reader,
    pub(super) bytes: usize,
    pub(super) table: StateWriter,
}

/// One client's view of a server.
pub(in crate::lcm) struct Face {
    standing: Word,
    /// Published with rows of the state table.
    rows: TryCell<Rows>,
    /// Published with the state.
    status: Mutex<Vec<Shown>>,
}

struct Rows {
    shown: Vec<Shown>,
    statistics_ns: u64,
}

fn is_status(shown: &Shown) -> bool {
    matches!(shown.from, Reader::System(system::GET_STATE))
}

impl Face {
    pub(super) fn new(standing: Word, shown: Vec<Shown>) -> Arc<Face> {
        let (status, rows) = shown.into_iter().partition(is_status);
        let rows = TryCell::new(Rows { shown: rows, statistics_ns: 0 });
        Arc::new(Face { standing, rows, status: Mutex::new(status) })
    }

    /// How the server stands now. Whoever changes that comes here afterwards, so the last one to come shows the last change.
    pub(in crate::lcm) fn show_standing(&self, server: &Instance) {
        loop {
            let now = server.standing();
            self.standing.set(now as u64);
            if server.standing() == now {
                break;
            }
        }
        let mut shown = self.status.lock().unwrap_or_else(PoisonError::into_inner);
        shown.iter_mut().for_each(|read| read.publish(server));
    }

    /// The results of its reads now. Real-time.
    pub(in crate::lcm) fn show_row(&self, server: &Instance) {
        let Some(mut rows) = self.rows.try_enter() else { return };
        let now_ns = os::now_ns();
        let statistics = now_ns >= rows.statistics_ns + STATISTICS_NS;
        if statistics {
            rows.statistics_ns = now_ns;
        }
        for read in &mut rows.shown {
            if statistics || !matches!(read.from, Reader::System(_)) {
                read.publish(server);
            }
        }
    }
}

impl Shown {
    fn publish(&mut self, server: &Instance) {
        let (from, bytes) = (&self.from, self.bytes);
        self.table.publish_with(|row| {
            let read = read_published(server, from, &[], &mut row[..bytes], &mut []);
            // What a step of the reader looks at is the outcome.
            (read.stamp_ns, read.outcome as u64)
        });
    }
}
