//! Rows that show how a component stands: of its state table, of its state and health, of its timing.
//!
//! Invariant: a row is published before anybody can miss it; no reader is waited for.

use std::sync::Arc;

use trocar_loader::system;
use trocar_rt::os;

use super::super::boundary::deferred;
use super::super::context;
use super::super::pending::{self, Owed, Owes};
use super::{Core, Entered, Inner, ShownRows, View};

impl Inner {
    /// Tells the tap of the newest row, unless it knows that row.
    fn tell_row(&mut self) {
        if let Some((stamp_ns, row)) = self.untold.take()
            && let Some(tap) = &self.row_tap
        {
            tap.to.tell_row(self.rows.newest(), stamp_ns, row);
        }
    }
}

impl Core {
    /// Publishes a row of the state table. Real-time.
    pub(crate) fn publish_state(&self, entered: &mut Entered<'_>) {
        if self.state_bytes > 0 {
            self.publish_row(entered, os::now_ns());
        }
    }

    /// Defers its row; false where it has to be published now. For the thread that is inside.
    #[inline]
    pub(super) fn owes_row(&self) -> bool {
        // Set only by the thread that runs it: a thread that is inside and finds it set is that thread.
        self.state_bytes == 0 || self.owed.get() || self.comes_to_owe()
    }

    #[inline(never)]
    fn comes_to_owe(&self) -> bool {
        let own_thread_only = !self.is_passive() && !self.is_called_back();
        if !context::stepping() || !own_thread_only || context::executor() != self.executor_id() {
            return false;
        }
        let Some(me) = self.me.upgrade() else { return false };
        pending::enlist(me);
        true
    }

    /// Publishes its row, and all others this thread owes, if this thread owes it.
    #[inline]
    pub(crate) fn publish_if_owed(&self) {
        if self.owed.get() && context::executor() == self.executor_id() {
            pending::publish();
        }
    }

    /// Publishes a row of this time. Real-time.
    pub(crate) fn publish_row(&self, entered: &mut Entered<'_>, stamp_ns: u64) {
        self.owed.take();
        if self.state_bytes > 0 {
            let (inner, block) = entered.with_state();
            // The row left for the turn's end is told while it is still the newest.
            inner.tell_row();
            let published = inner.rows.publish(stamp_ns, inner.cycle, |row| block.copy_to(row));
            self.show_row();
            if inner.row_tap.as_ref().is_some_and(|tap| tap.is_listened()) {
                inner.untold = Some((stamp_ns, published.row + 1));
                if !deferred::row(self) {
                    inner.tell_row();
                }
            }
        }
    }

    /// Tells the tap of the row that was left for the turn's end. If this very thread is inside, without room
    /// to leave more, its next publication tells it.
    pub(crate) fn tell_row_of_turn(&self) {
        if let Some(mut entered) = self.object.try_enter() {
            entered.inner().tell_row();
        }
    }

    /// Answers a read of the system interface into `out`; returns its stamp.
    pub(crate) fn system_read(&self, which: usize, out: &mut [u8]) -> u64 {
        match which {
            system::PERIOD_STATISTICS => {
                let s = self.statistics();
                system::write_statistics(&s, out);
                s.stamp_ns
            }
            system::GET_STATE => self.read_status(out),
            _ => 0,
        }
    }

    /// Copies the newest published status; returns its stamp. Real-time.
    pub(crate) fn read_status(&self, out: &mut [u8]) -> u64 {
        let Some(out) = out.get_mut(..system::MAX_BYTES) else { return 0 };
        if self.status_rows.latest(out).is_none() {
            return 0;
        }
        // The status still holds: every change publishes a row.
        let stamp_ns = os::now_ns();
        out[..8].copy_from_slice(&stamp_ns.to_le_bytes());
        stamp_ns
    }

    fn statistics(&self) -> system::Statistics {
        let s = self.books.steps.snapshot();
        let seconds = |ns: f64| ns * 1e-9;
        system::Statistics {
            stamp_ns: os::now_ns(),
            period: [
                seconds(s.period.avg_ns),
                seconds(s.period.std_ns),
                seconds(s.period.min_ns as f64),
                seconds(s.period.max_ns as f64),
            ],
            compute: [
                seconds(s.compute.avg_ns),
                seconds(s.compute.std_ns),
                seconds(s.compute.min_ns as f64),
                seconds(s.compute.max_ns as f64),
            ],
            lateness: [
                seconds(s.lateness_p50_ns as f64),
                seconds(s.lateness_p99_ns as f64),
                seconds(s.lateness_max_ns as f64),
            ],
            load: s.load,
            executed: s.executed,
            skipped: s.skipped,
            overruns: s.overruns,
        }
    }

    /// Changes the views for clients in other processes; managers only.
    pub(crate) fn edit_views(&self, f: impl FnOnce(&mut Vec<Arc<dyn View<Core>>>)) {
        self.peers.views.edit(f);
    }

    /// Its rows as other processes see them, if they are shown. Managers only.
    pub(crate) fn shown_rows(&self) -> Option<Arc<ShownRows>> {
        self.peers.views.rows()
    }

    /// Shows other processes its state, after that has changed.
    pub(crate) fn show_standing(&self) {
        self.peers.views.show(|view| view.show_standing(self));
    }

    /// Shows other processes the newest row, or the results of its reads. Real-time.
    #[inline]
    pub(crate) fn show_row(&self) {
        self.peers.views.show_row(&self.rows, self);
    }

    /// Shows other processes its statistics. Watchdog only.
    pub(crate) fn show_figures(&self) {
        self.peers.views.show(|view| view.show_figures(self));
    }

    /// Shows other processes the positions of its reads, after they have changed.
    pub(crate) fn show_positions(&self) {
        self.peers.views.show(|view| view.show_positions());
    }
}

impl Owes for Core {
    fn owed(&self) -> &Owed {
        &self.owed
    }

    fn publish_owed(&self) {
        if let Some(mut entered) = self.object.try_enter() {
            self.publish_state(&mut entered);
        }
    }
}
