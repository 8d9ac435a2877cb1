//! A component as clients in other processes see it: their views, and the rows that those share.
//!
//! Invariant: rows and results are shown by the thread that publishes a row of the state table, and that
//! thread never waits; the state by the thread that publishes it; the statistics by the watchdog.

use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::Mutex;
use trocar_rt::cell::BindingCell;
use trocar_rt::region::Region;
use trocar_rt::segment::{Agreed, Rows};
use trocar_rt::state::{StateReader, StateWriter};

use super::super::kept::Kept;

/// One client's view of a component.
pub(crate) trait View<S>: Send + Sync {
    /// Rows from which its client computes reads itself; shared by all views that have them.
    fn rows(&self) -> Option<&Arc<ShownRows>>;

    /// Shows the present state. A thread that changes it comes here afterwards.
    fn show_standing(&self, of: &S);

    /// Shows the present results of its reads. Real-time.
    fn show_row(&self, of: &S);

    /// Shows the present statistics. Watchdog only.
    fn show_figures(&self, of: &S);

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
struct Present<S> {
    all: Vec<Arc<dyn View<S>>>,
    rows: Option<Arc<ShownRows>>,
}

/// All views of one component, whose core is an `S`.
pub(super) struct Views<S> {
    present: BindingCell<Present<S>>,
    /// True when there is a view.
    is_any: AtomicBool,
    /// Lets managers change the list one after the other.
    editing: Mutex<()>,
}

impl<S: 'static> Default for Views<S> {
    fn default() -> Self {
        Views {
            present: BindingCell::new(Box::new(Present { all: Vec::new(), rows: None })),
            is_any: AtomicBool::new(false),
            editing: Mutex::new(()),
        }
    }
}

impl<S: 'static> Views<S> {
    /// Changes the list; managers only.
    pub(super) fn edit(&self, f: impl FnOnce(&mut Vec<Arc<dyn View<S>>>)) {
        let _one = self.editing.lock();
        let mut all = self.present.enter().all.clone();
        f(&mut all);
        self.is_any.store(!all.is_empty(), Ordering::SeqCst);
        let rows = all.iter().find_map(|view| view.rows().cloned());
        self.present.swap(Box::new(Present { all, rows }));
    }

    /// The rows as other processes see them, if they are shown. Managers only.
    pub(super) fn rows(&self) -> Option<Arc<ShownRows>> {
        self.present.enter().rows.clone()
    }

    /// Shows every view something that has changed.
    pub(super) fn show(&self, f: impl Fn(&dyn View<S>)) {
        if self.is_any.load(Ordering::SeqCst) {
            self.present.enter().all.iter().for_each(|view| f(&**view));
        }
    }

    /// Shows the newest row of the state table, or the results of the reads. Real-time.
    #[inline]
    pub(super) fn show_row(&self, table: &StateReader, of: &S) {
        if self.is_any.load(Ordering::Relaxed) {
            self.present.look(|present| {
                if let Some(rows) = &present.rows {
                    rows.show(table);
                }
                present.all.iter().for_each(|view| view.show_row(of));
            });
        }
    }

    pub(super) fn reclaim(&self) -> usize {
        self.present.reclaim()
    }
}
