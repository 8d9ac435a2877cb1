//! A cell and the slot in front of it, both at fixed addresses.
//!
//! Invariant: a cell outlives every use of its slot: it is freed after the component was bound to others, or
//! destroyed.

use std::mem;

pub(crate) struct Wired<Cell, Slot> {
    name: String,
    cell: *mut Cell,
    slot: Box<Slot>,
}

impl<Cell, Slot> Wired<Cell, Slot> {
    fn new(name: String, cell: Cell, slot: fn(*mut Cell) -> Slot) -> Self {
        let cell = Box::into_raw(Box::new(cell));
        Wired { name, cell, slot: Box::new(slot(cell)) }
    }

    /// Ties the ports of a new description: a port whose name was there before keeps its cell. Returns the
    /// cells left over, to be dropped after the component was bound.
    #[must_use]
    pub(crate) fn rewire(
        wired: &mut Vec<Self>,
        wanted: impl Iterator<Item = (String, Cell)>,
        slot: fn(*mut Cell) -> Slot,
    ) -> Vec<Self> {
        let mut before = mem::take(wired);
        for (name, cell) in wanted {
            let kept = before.iter().position(|w| w.name == name).map(|at| before.swap_remove(at));
            wired.push(kept.unwrap_or_else(|| Wired::new(name, cell, slot)));
        }
        before
    }

    pub(crate) fn slot(&self) -> *const Slot {
        &raw const *self.slot
    }

    pub(crate) fn get(&mut self) -> &mut Cell {
        // SAFETY: made in `new`, freed in drop; the component uses it only inside an entry, when the bench
        // does not.
        unsafe { &mut *self.cell }
    }
}

impl<Cell, Slot> Drop for Wired<Cell, Slot> {
    fn drop(&mut self) {
        // SAFETY: made by `Box::into_raw` in `new`, and by the invariant nobody uses it any more.
        drop(unsafe { Box::from_raw(self.cell) });
    }
}
