//! The pictures of a window: the newest frame, marked while it is stale.
//!
//! Invariant: a frame is drawn once, and again only when its mark changes; the next one has no mark.

use std::sync::Arc;

use trocar_imaging::pixels::{Part, rgb};
use trocar_sdk::prelude::*;

use crate::freshness::{Freshness, Stale};
use crate::handoff::Taker;
use crate::mark;

pub(crate) struct Drawing {
    taker: Taker,
    freshness: Arc<Freshness>,
    /// Whether a frame has come.
    any: bool,
    /// The mark of the picture drawn last.
    marked: Option<u64>,
    pixels: Vec<u8>,
}

impl Drawing {
    pub(crate) fn new(taker: Taker, freshness: Arc<Freshness>) -> Drawing {
        Drawing { taker, freshness, any: false, marked: None, pixels: Vec::new() }
    }

    /// Both images side by side as red, green, blue, rows touching, with width and height; `None` while
    /// nothing has changed.
    pub(crate) fn next(&mut self, now: Stamp) -> Option<(&[u8], usize, usize)> {
        let new = self.taker.renew();
        self.any |= new;
        let stale = self.freshness.stale(now).filter(|_| self.any);
        let mark = stale.map(Stale::turn);
        if !new && (mark.is_none() || mark == self.marked) {
            return None;
        }
        self.marked = mark;
        let frame = self.taker.newest();
        let (width, height) = rgb(&frame.header, frame.bytes(), Part::Both, &mut self.pixels).ok()?;
        let size = (width as usize, height as usize);
        if let Some(stale) = stale {
            let images = (width / frame.header.width.max(1)).max(1);
            mark::draw(&mut self.pixels, size, images as usize, stale);
        }
        Some((&self.pixels, size.0, size.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::handoff::pair;
    use trocar_sdk::data::{PixelFormat, StereoHeader};

    const RED: [u8; 3] = [255, 0, 0];
    const GREEN: [u8; 3] = [0, 200, 0];
    const BLUE: [u8; 3] = [0, 0, 200];

    /// Colours of the corner and of the middles of both images of 64 × 16 px.
    fn seen((pixels, width, height): (&[u8], usize, usize)) -> [[u8; 3]; 3] {
        assert_eq!((pixels.len(), width, height), (3 * 128 * 16, 128, 16));
        [0, 8 * 128 + 32, 8 * 128 + 96].map(|at| pixels.as_chunks::<3>().0[at])
    }

    #[test]
    fn a_frozen_picture_is_marked_and_the_next_one_is_not() {
        let at = |ms: u64| Stamp::from_ns(1_000_000 * ms);
        let (mut giver, taker) = pair(2 * 3 * 64 * 16);
        let freshness = Arc::new(Freshness::default());
        freshness.limit(0.5);
        let mut drawing = Drawing::new(taker, freshness.clone());
        let header = StereoHeader {
            width: 64,
            height: 16,
            stride: 3 * 64,
            format: PixelFormat::RGB8,
            right_offset: 3 * 64 * 16,
            ..Default::default()
        };
        let both = [GREEN.repeat(64 * 16), BLUE.repeat(64 * 16)].concat();
        let mut show = |stamp: Stamp, now: Stamp| {
            assert!(giver.give(&header, &both));
            freshness.renewed(stamp, now);
        };
        assert!(drawing.next(at(9_000)).is_none(), "none has come");
        show(at(10_000), at(10_000));
        assert_eq!(seen(drawing.next(at(10_001)).unwrap()), [GREEN, GREEN, BLUE]);
        assert!(drawing.next(at(10_400)).is_none(), "once");
        assert_eq!(seen(drawing.next(at(10_700)).unwrap()), [RED, GREEN, BLUE], "no step ran meanwhile");
        assert!(drawing.next(at(10_800)).is_none(), "its text is the same");
        assert_eq!(seen(drawing.next(at(11_200)).unwrap()), [RED, GREEN, BLUE]);
        show(at(11_300), at(11_300));
        assert_eq!(seen(drawing.next(at(11_301)).unwrap()), [GREEN, GREEN, BLUE]);
        // A camera whose clock is a minute ahead, and that falls silent, is silent.
        show(at(71_400), at(11_400));
        assert_eq!(seen(drawing.next(at(11_401)).unwrap()), [GREEN, GREEN, BLUE]);
        assert_eq!(seen(drawing.next(at(12_100)).unwrap()), [RED, GREEN, BLUE]);
        // A frame that never becomes stale is never marked.
        freshness.limit(0.0);
        show(at(12_200), at(12_200));
        assert_eq!(seen(drawing.next(at(12_201)).unwrap()), [GREEN, GREEN, BLUE]);
        assert!(drawing.next(at(99_000)).is_none());
    }
}
