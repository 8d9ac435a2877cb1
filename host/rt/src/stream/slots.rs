//! The places samples lie in. A place is touched only by the end, or the queue, that owns its index.

use super::Meta;
use crate::buf::{AlignedBuf, copy, round_up};
use crate::pool::Frame;
use crate::sync::Shared;

/// What lies in a place.
#[derive(Default)]
pub(super) struct Content {
    pub(super) meta: Meta,
    pub(super) frame: Option<Frame>,
    /// Bytes in use of a plain sample.
    len: usize,
}

pub(super) struct Slots {
    contents: Box<[Shared<Content>]>,
    plain: AlignedBuf,
    stride: usize,
}

// SAFETY: a place has one owner at a time, passed on with Release and Acquire; a `Frame` may go anywhere.
unsafe impl Send for Slots {}
// SAFETY: as above.
unsafe impl Sync for Slots {}

impl Slots {
    pub(super) fn new(slots: usize, bytes: usize) -> Self {
        let stride = round_up(bytes, 64);
        Self {
            contents: (0..slots).map(|_| Shared::new(Content::default())).collect(),
            plain: AlignedBuf::new(stride * slots),
            stride,
        }
    }

    /// # Safety
    /// The caller owns the place and uses one reference to it at a time.
    #[expect(clippy::mut_from_ref, reason = "ownership of a place is by index, as the contract says")]
    #[inline]
    pub(super) unsafe fn content(&self, place: usize) -> &mut Content {
        // SAFETY: the caller owns the place.
        unsafe { &mut *self.contents[place].exclusive() }
    }

    /// # Safety
    /// As for [`Slots::content`]; `data` is no longer than the link's samples.
    #[inline]
    pub(super) unsafe fn write(&self, place: usize, meta: Meta, data: &[u8]) {
        debug_assert!(data.len() <= self.stride, "the writer checks the length");
        // SAFETY: the caller owns the place, which has `stride` bytes.
        unsafe {
            copy(data.as_ptr(), self.plain.at(place * self.stride), data.len());
            *self.content(place) = Content { meta, frame: None, len: data.len() };
        }
    }

    /// # Safety
    /// The caller owns the place, and nobody writes it while the answer lives.
    #[inline]
    pub(super) unsafe fn look(&self, place: usize) -> &Content {
        // SAFETY: the caller owns the place and keeps it.
        unsafe { &*self.contents[place].readable() }
    }

    /// # Safety
    /// As for [`Slots::look`].
    #[inline]
    pub(super) unsafe fn read(&self, place: usize) -> (Meta, &[u8], &[u8]) {
        // SAFETY: the caller's promise is the one asked for.
        let content = unsafe { self.look(place) };
        match &content.frame {
            Some(frame) => (content.meta, frame.header(), frame.bytes()),
            None => {
                // SAFETY: as above; `len` bytes were written when the content was.
                let data =
                    unsafe { std::slice::from_raw_parts(self.plain.at(place * self.stride), content.len) };
                (content.meta, data, &[])
            }
        }
    }

    /// Lets go of the frame in a place.
    ///
    /// # Safety
    /// As for [`Slots::content`].
    #[inline]
    pub(super) unsafe fn empty(&self, place: usize) {
        // SAFETY: the caller's promise is the one asked for.
        drop(unsafe { self.content(place) }.frame.take());
    }
}
