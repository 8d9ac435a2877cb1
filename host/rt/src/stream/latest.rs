//! The newest sample: three places, of which writer and reader own one each and exchange the third.
//!
//! `middle` holds the index of the third place and whether its sample is unseen; each end moves by one swap.

use crate::region::{Layout, Place};
use crate::sync::{AtomicU32, Ordering};

pub(super) const SLOTS: usize = 3;
/// The places the ends begin with; the middle begins with the third.
pub(super) const WRITERS: usize = 0;
pub(super) const READERS: usize = 1;

const UNSEEN: u32 = 4;

/// One of the places, whatever the word holds: the other end may be another process.
fn place_in(word: u32) -> usize {
    (word & 3).min(SLOTS as u32 - 1) as usize
}

pub(super) struct Latest {
    middle: Place<AtomicU32>,
}

impl Latest {
    pub(super) fn lay_out(layout: &mut Layout) -> Self {
        Self { middle: layout.place(|| AtomicU32::new(2)) }
    }

    /// Gives the written place away for another one; returns whether that other one held an unseen sample.
    /// Wait-free.
    #[inline]
    pub(super) fn publish(&self, written: usize) -> (usize, bool) {
        let got = self.middle.swap(written as u32 | UNSEEN, Ordering::AcqRel);
        (place_in(got), got & UNSEEN != 0)
    }

    /// Gives an empty place away for the third one; returns whether that held an unseen sample. For a writer
    /// that goes.
    pub(super) fn take_back(&self, back: usize) -> (usize, bool) {
        let got = self.middle.swap(back as u32, Ordering::AcqRel);
        (place_in(got), got & UNSEEN != 0)
    }

    /// Tells whether there is an unseen sample: once true for the reader, it stays true until it takes one.
    #[inline]
    pub(super) fn has_unseen(&self) -> bool {
        self.middle.load(Ordering::Relaxed) & UNSEEN != 0
    }

    /// Gives the seen (and emptied) place away for the newest one. Wait-free.
    #[inline]
    pub(super) fn exchange(&self, seen: usize) -> usize {
        place_in(self.middle.swap(seen as u32, Ordering::AcqRel))
    }
}
