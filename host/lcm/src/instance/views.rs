//! A component as clients in other processes see it: their views, and the rows that those share.
//!
//! Invariant: rows and results are shown by the thread that publishes a row of the state table, and that
//! thread never waits; the state by the thread that publishes it; the statistics by the watchdog.

use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use trocar_rt::cell::BindingCell;
use trocar_rt::region::Region;
use trocar_rt::segment::{Agreed, Rows};
use trocar_rt::state::{StateReader, StateWriter};

use super::super::kept::Kept;
use super::Instance;

/// One client's view of a component.
pub(crate) trait View: Send + Sync {
    /// Rows from which its client computes reads itself; shared by all views that have them.
    fn rows(&self) -> Option<&Arc<ShownRows>>;

    /// Shows the present state. A thread that changes it comes here afterwards.
    fn show_standing(&self, of: &Instance);

    /// Shows the present results of its reads. Real-time.
    fn show_row(&self, of: &Instance);

    /// Shows the present statistics. Watchdog only.
    fn show_figures(&self, of: &Instance);

    /// Shows the present positions of the reads that the client computes itself.
    fn show_positions(&self);
}

/// The rows of a server, for all clients that compute its reads themselves: one more copy per row, however
/// many clients there are.
pub(crate) struct ShownRows {
    rows: Kept<Rows<StateWriter>>,
    region: Arc<Region>,
}

impl ShownRows {
    /// # Errors
    /// The machine lacks that much memory, or a file descriptor.
    pub(crate) fn create(bytes: usize, agreed: Agreed) -> io::Result<Arc<ShownRows>> {
        let rows = Rows::create(bytes, agreed)?;
        let region = rows.region().ok_or_else(|| io::Error::other("rows without memory"))?;
        Ok(Arc::new(ShownRows { rows: Kept::new(rows), region }))
    }

    pub(crate) fn fd(&self) -> io::Result<OwnedFd> {
        let fd = self.region.fd().ok_or_else(|| io::Error::other("memory without a file"))?;
        fd.try_clone_to_owned()
    }

    /// Shows the newest row, if there is one. Real-time.
    fn show(&self, table: &StateReader) {
        self.rows.write(|rows| {
            rows.end.publish_with(|row| table.latest(row).map(|info| (info.stamp_ns, info.tick)));
        });
    }
}

/// The views there are now.
#[derive(Default)]
struct Present {
    all: Vec<Arc<dyn View>>,
    rows: Option<Arc<ShownRows>>,
}

/// All views of one component.
pub(super) struct Views {
    present: BindingCell<Present>,
    /// True when there is a view.
    is_any: AtomicBool,
    /// Lets managers change the list one after the other.
    editing: Mutex<()>,
}

impl Default for Views {
    fn default() -> Self {
        Views {
            present: BindingCell::new(Box::default()),
            is_any: AtomicBool::new(false),
            editing: Mutex::new(()),
        }
    }
}

impl Views {
    pub(super) fn reclaim(&self) -> usize {
        self.present.reclaim()
    }

    fn show(&self, f: impl Fn(&dyn View)) {
        if self.is_any.load(Ordering::SeqCst) {
            self.present.enter().all.iter().for_each(|view| f(&**view));
        }
    }
}

impl Instance {
    /// Changes the views for clients in other processes; managers only.
    pub(crate) fn edit_views(&self, f: impl FnOnce(&mut Vec<Arc<dyn View>>)) {
        let views = &self.views;
        let _one = views.editing.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = views.present.enter().all.clone();
        f(&mut all);
        views.is_any.store(!all.is_empty(), Ordering::SeqCst);
        let rows = all.iter().find_map(|view| view.rows().cloned());
        views.present.swap(Box::new(Present { all, rows }));
    }

    /// Its rows as other processes see them, if they are shown. Managers only.
    pub(crate) fn shown_rows(&self) -> Option<Arc<ShownRows>> {
        self.views.present.enter().rows.clone()
    }

    /// Shows other processes its state, after that has changed.
    pub(crate) fn show_standing(&self) {
        self.views.show(|view| view.show_standing(self));
    }

    /// Shows other processes the newest row, or the results of its reads. Real-time.
    #[inline]
    pub(crate) fn show_row(&self) {
        if self.views.is_any.load(Ordering::Relaxed) {
            self.views.present.look(|present| {
                if let Some(rows) = &present.rows {
                    rows.show(&self.rows);
                }
                present.all.iter().for_each(|view| view.show_row(self));
            });
        }
    }

    /// Shows other processes its statistics. Watchdog only.
    pub(crate) fn show_figures(&self) {
        self.views.show(|view| view.show_figures(self));
    }

    /// Shows other processes the positions of its reads, after they have changed.
    pub(crate) fn show_positions(&self) {
        self.views.show(|view| view.show_positions());
    }
}
