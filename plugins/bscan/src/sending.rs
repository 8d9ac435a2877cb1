//! Images on their way out.
//!
//! Invariant: an image goes out whole or not at all, with the time of its newest A-scan, and not again before
//! another one came: so an image of an OCT that is silent never passes for a new one. Their numbers have no
//! gap.

use trocar_sdk::RateLimit;
use trocar_sdk::data::{ImageHeader, PixelFormat};
use trocar_sdk::prelude::*;

/// Frames of an output's pool.
pub(crate) const SLOTS: u32 = 6;

/// Grey images at a rate of their own.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sending {
    pace: RateLimit,
    index: u64,
    /// Time of the newest A-scan, 0 without any, and that of the last image.
    newest: Stamp,
    sent: Stamp,
}

impl Sending {
    /// An A-scan of this time was taken along the line or beyond its end.
    pub(crate) fn saw(&mut self, taken: Stamp) {
        self.newest = self.newest.max(taken);
    }

    /// Time of the newest A-scan of the scan, also beyond the image's last column; 0 without any.
    pub(crate) fn newest(&self) -> Stamp {
        self.newest
    }

    /// Is there an A-scan in the image at all?
    pub(crate) fn has_any(&self) -> bool {
        self.newest.is_valid()
    }

    /// Is there an A-scan that no image showed yet?
    fn has_news(&self) -> bool {
        self.newest > self.sent
    }

    /// Is the next image due? It is with news alone, and not again before `rate_hz` says so.
    pub(crate) fn is_due(&mut self, now: Stamp, rate_hz: f64) -> bool {
        let due = self.has_news() && self.pace.at(rate_hz).is_due(now.ns());
        if due {
            self.pace.keep(now.ns());
        }
        due
    }

    /// Another image: its first one is due at once, with its first A-scan.
    pub(crate) fn restart(&mut self) {
        *self = Sending { index: self.index, ..Sending::default() };
    }

    /// Sends an image of `width` times `height` pixels that `draw` draws; false if there is no frame for it.
    pub(crate) fn send(
        &mut self,
        to: &mut Out<Frame<ImageHeader>>,
        (width, height): (usize, usize),
        draw: impl FnOnce(&mut [u8]),
    ) -> bool {
        let Ok(mut loan) = to.loan() else { return false };
        let Some(room) = loan.bytes_mut().get_mut(..width * height) else { return false };
        draw(room);
        let (stamp, width_px) = (self.newest, width as u32);
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
        self.sent = stamp;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_come_at_the_rate_that_is_asked_for_also_where_it_is_no_part_of_the_cycles() {
        for rate_hz in [15.0, 30.0, 300.0, 700.0] {
            let mut sending = Sending::default();
            let due = (1..=2000_u64).filter(|ms| {
                let now = Stamp::from_ns(ms * 1_000_000);
                sending.saw(now);
                sending.is_due(now, rate_hz)
            });
            let due = due.count() as f64;
            assert!((due - 2.0 * rate_hz).abs() <= 1.0, "{due} in 2 s at {rate_hz} Hz");
        }
    }
}
