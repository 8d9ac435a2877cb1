//! Images on their way out.
//!
//! Invariant: an image goes out whole or not at all; their numbers have no gap.

use trocar_sdk::data::{ImageHeader, PixelFormat};
use trocar_sdk::prelude::*;

/// Frames of an output's pool.
pub(crate) const SLOTS: u32 = 6;

/// Grey images at a rate of their own.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sending {
    next: Stamp,
    index: u64,
}

impl Sending {
    /// Is the next image due? It is not again before `rate_hz` says so.
    pub(crate) fn is_due(&mut self, now: Stamp, rate_hz: f64) -> bool {
        let due = now >= self.next;
        if due {
            self.next = Stamp::from_ns(now.ns() + (1e9 / rate_hz) as u64);
        }
        due
    }

    /// The first one is due at once.
    pub(crate) fn restart(&mut self) {
        self.next = Stamp::INVALID;
    }

    /// Sends an image of `width` times `height` pixels that `draw` draws; false where there is no frame for it.
    pub(crate) fn send(
        &mut self,
        to: &mut Out<Frame<ImageHeader>>,
        stamp: Stamp,
        (width, height): (usize, usize),
        draw: impl FnOnce(&mut [u8]),
    ) -> bool {
        let Ok(mut loan) = to.loan() else { return false };
        let Some(room) = loan.bytes_mut().get_mut(..width * height) else { return false };
        draw(room);
        let width_px = width as u32;
        *loan.header_mut() = ImageHeader {
            stamp,
            index: self.index,
            width: width_px,
            height: height as u32,
            stride: width_px,
            format: PixelFormat::GRAY8,
        };
        loan.commit(width * height, stamp);
        self.index += 1;
        true
    }
}
