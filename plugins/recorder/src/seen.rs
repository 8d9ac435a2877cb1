//! A sample of an input, as it came.
//!
//! Invariant: only a sample that its input still has can be held; one that was put aside is a copy.

use trocar_sdk::AnyView;

/// A sample as its input gave it.
pub(crate) struct Seen<'a> {
    pub(crate) value: &'a [u8],
    pub(crate) bytes: &'a [u8],
    pub(crate) stamp_ns: u64,
    pub(crate) seq: u64,
    /// View by which its frame may be held.
    view: Option<&'a AnyView<'a>>,
}

impl<'a> Seen<'a> {
    /// `may_hold`: what becomes of it will be in the file soon.
    pub(crate) fn of(view: &'a AnyView<'a>, may_hold: bool) -> Seen<'a> {
        let (stamp_ns, seq) = (view.stamp().ns(), view.seq());
        Seen { value: view.value(), bytes: view.bytes(), stamp_ns, seq, view: may_hold.then_some(view) }
    }

    /// Returns a sample that was put aside.
    pub(crate) fn copied(value: &'a [u8], bytes: &'a [u8], stamp_ns: u64, seq: u64) -> Seen<'a> {
        Seen { value, bytes, stamp_ns, seq, view: None }
    }

    /// Returns the view by which its frame may be held.
    pub(crate) fn holdable(&self) -> Option<&AnyView<'a>> {
        self.view
    }

    #[cfg(test)]
    pub(crate) fn plain(value: &'a [u8], stamp_ns: u64, seq: u64) -> Seen<'a> {
        Seen::copied(value, &[], stamp_ns, seq)
    }
}
