//! The places samples lie in. A place is touched only by the end, or the queue, that owns its index.
//!
//! The description of a sample may lie where another process writes; the end that owns the place holds the
//! frame itself, in its own process.

use super::Meta;
use crate::buf::{copy, round_up};
use crate::pool::Frame;
use crate::region::{AnyBits, Bytes, Layout, Table};
use crate::sync::Shared;

/// Description of the sample in a place.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub(super) struct Content {
    pub(super) meta: Meta,
    /// Bytes in use of a plain sample.
    pub(super) len: u64,
    /// Place of the frame, for an end that has to find it in another process.
    pub(super) frame: Located,
}

/// A frame as the other end finds it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub(super) struct Located {
    /// Number under which it was lent.
    pub(super) lease: u32,
    /// Number of its pool on this link, and its slot in it.
    pub(super) pool: u32,
    pub(super) slot: u64,
    /// Bytes after the header.
    pub(super) len: u64,
}

// SAFETY: numbers.
unsafe impl AnyBits for Content {}

pub(super) struct Slots {
    contents: Table<Shared<Content>>,
    plain: Bytes,
    stride: usize,
    /// Frame in each place, of links of frames.
    frames: Box<[Shared<Option<Frame>>]>,
}

// SAFETY: a place has one owner at a time, passed on with Release and Acquire; a `Frame` may go anywhere.
unsafe impl Send for Slots {}
// SAFETY: as above.
unsafe impl Sync for Slots {}

impl Slots {
    /// Plain samples of up to `bytes`, or frames.
    pub(super) fn lay_out(layout: &mut Layout, slots: usize, bytes: usize, frames: bool) -> Self {
        let stride = round_up(bytes, 64);
        Self {
            contents: layout.table(slots, |_| Shared::new(Content::default())),
            plain: layout.bytes(stride * slots),
            stride,
            frames: (0..if frames { slots } else { 0 }).map(|_| Shared::new(None)).collect(),
        }
    }

    /// # Safety
    /// The caller owns the place; `data` is no longer than the link's samples.
    #[inline]
    pub(super) unsafe fn write(&self, place: usize, meta: Meta, data: &[u8]) {
        debug_assert!(data.len() <= self.stride, "the writer checks the length");
        // SAFETY: the caller owns the place, which has `stride` bytes.
        unsafe {
            copy(data.as_ptr(), self.plain.at(place * self.stride), data.len());
            let content = self.contents[place].exclusive();
            (*content).meta = meta;
            (*content).len = data.len() as u64;
        }
    }

    /// As [`Slots::write`]: `head`, then `body`, then zeros up to `bytes`.
    ///
    /// # Safety
    /// The caller owns the place; both together are no longer than `bytes`, and that no longer than the
    /// link's samples.
    #[inline]
    pub(super) unsafe fn write_parts(
        &self,
        place: usize,
        meta: Meta,
        head: &[u8],
        body: &[u8],
        bytes: usize,
    ) {
        let filled = head.len() + body.len();
        debug_assert!(filled <= bytes && bytes <= self.stride, "the writer checks the lengths");
        // SAFETY: the caller owns the place, which has `stride` bytes.
        unsafe {
            let to = self.plain.at(place * self.stride);
            copy(head.as_ptr(), to, head.len());
            copy(body.as_ptr(), to.add(head.len()), body.len());
            to.add(filled).write_bytes(0, bytes - filled);
            let content = self.contents[place].exclusive();
            (*content).meta = meta;
            (*content).len = bytes as u64;
        }
    }

    /// Describes a frame and puts it there, where the other end takes it from this process.
    ///
    /// # Safety
    /// The caller owns the place and uses one reference to its frame at a time.
    pub(super) unsafe fn put(&self, place: usize, meta: Meta, frame: Option<Frame>, located: Located) {
        // SAFETY: the caller owns the place.
        unsafe { *self.contents[place].exclusive() = Content { meta, len: 0, frame: located } };
        if let Some(mine) = self.frames.get(place) {
            // SAFETY: as above.
            unsafe { *mine.exclusive() = frame };
        }
    }

    /// # Safety
    /// The caller owns the place and uses one reference to its frame at a time.
    #[expect(clippy::mut_from_ref, reason = "ownership of a place is by index, as the contract says")]
    #[inline]
    pub(super) unsafe fn frame_mut(&self, place: usize) -> Option<&mut Option<Frame>> {
        // SAFETY: the caller owns the place.
        self.frames.get(place).map(|frame| unsafe { &mut *frame.exclusive() })
    }

    /// # Safety
    /// The caller owns the place, and nobody writes it while the answer lives.
    #[inline]
    pub(super) unsafe fn frame(&self, place: usize) -> Option<&Frame> {
        // SAFETY: the caller owns the place and keeps it.
        unsafe { &*self.frames.get(place)?.readable() }.as_ref()
    }

    /// # Safety
    /// The caller owns the place.
    #[inline]
    pub(super) unsafe fn look(&self, place: usize) -> Content {
        // SAFETY: the caller owns the place.
        unsafe { self.contents[place].fetch() }
    }

    /// The sample and what lies behind its header.
    ///
    /// # Safety
    /// As for [`Slots::frame`].
    #[inline]
    pub(super) unsafe fn read(&self, place: usize) -> (Meta, &[u8], &[u8]) {
        // SAFETY: the caller's promise is the one asked for.
        let content = unsafe { self.look(place) };
        // SAFETY: as above.
        match unsafe { self.frame(place) } {
            Some(frame) => (content.meta, frame.header(), frame.bytes()),
            None => {
                let len = (content.len as usize).min(self.stride);
                // SAFETY: as above; the place has `stride` bytes.
                let data = unsafe { std::slice::from_raw_parts(self.plain.at(place * self.stride), len) };
                (content.meta, data, &[])
            }
        }
    }

    /// Lets go of the frame in a place.
    ///
    /// # Safety
    /// As for [`Slots::frame_mut`].
    #[inline]
    pub(super) unsafe fn empty(&self, place: usize) {
        // SAFETY: the caller's promise is the one asked for.
        if let Some(frame) = unsafe { self.frame_mut(place) } {
            drop(frame.take());
        }
    }
}
