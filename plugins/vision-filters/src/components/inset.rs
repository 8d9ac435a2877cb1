//! The inset of `pip`: what came last, brought to the size that is asked for, once.
//!
//! Invariant: memory is made by `reserve` alone, for an inset as large as the largest frame; what is kept is
//! the inset that came last in the size asked for last, or nothing.

use trocar_sdk::FrameView;
use trocar_sdk::data::{ImageHeader, StereoHeader};
use trocar_sdk::prelude::*;

use super::pair::{self, Tally, Unfit};
use crate::resize::{Method, Resizer};
use crate::view::{Format, Shape, View, ViewMut};

/// Longest side of an inset that is brought to another size, px.
const MAX_FROM: usize = 16_384;

/// An inset as it came: a pair, or one picture for both eyes.
pub(super) struct Given<'a> {
    bytes: &'a [u8],
    which: Which,
    fresh: bool,
}

/// Which inset it is, and so whether it is the one before.
#[derive(Clone, Copy, PartialEq)]
struct Which {
    header: StereoHeader,
    pair: bool,
    seq: u64,
    stamp: Stamp,
}

impl<'a> Given<'a> {
    pub(super) fn pair(frame: &'a FrameView<'_, StereoHeader>) -> Given<'a> {
        Given::of(frame, *frame.header(), true)
    }

    pub(super) fn picture(frame: &'a FrameView<'_, ImageHeader>) -> Given<'a> {
        Given::of(frame, StereoHeader::from(*frame.header()), false)
    }

    /// Columns and rows that it came with.
    pub(super) fn size(&self) -> [u32; 2] {
        [self.which.header.width, self.which.header.height]
    }

    fn of<H: Payload>(frame: &'a FrameView<'_, H>, header: StereoHeader, pair: bool) -> Given<'a> {
        let which = Which { header, pair, seq: frame.seq(), stamp: frame.stamp() };
        Given { bytes: frame.bytes(), which, fresh: frame.is_fresh() }
    }
}

/// Brings insets to the size that is asked for, and keeps the last one.
#[derive(Default)]
pub(super) struct Scaled {
    resizer: Option<Resizer>,
    /// Both images, left first, each in its half.
    bytes: Vec<u8>,
    /// Longest sides of the result, px.
    most: (usize, usize),
    /// The inset that lies there, or was found unfit, and the width and height it was asked for.
    last: Option<(Which, [u32; 2], Result<Kept, Unfit>)>,
}

/// The result of bringing an inset to its size.
#[derive(Clone, Copy)]
enum Kept {
    /// The inset has the size it came with: nothing is kept.
    AsItCame,
    /// The inset lies there in this shape; one image serves both eyes, or not.
    Here { shape: Shape, one: bool },
}

impl Scaled {
    /// Makes room for insets up to this size, px.
    pub(super) fn reserve(&mut self, width: u32, height: u32) {
        let most = (width as usize, height as usize);
        if self.most == most && self.resizer.is_some() {
            return;
        }
        let largest = Shape { width: most.0, height: most.1, format: Format::Rgb8 };
        self.bytes = vec![0; 2 * largest.packed_bytes()];
        self.resizer = Some(Resizer::with_room(MAX_FROM, most.0.max(most.1)));
        (self.most, self.last) = (most, None);
    }

    /// Both images of the inset in the size that is asked for, columns and rows (0: as it came); none when it
    /// cannot be shown, which `tally` tells once.
    pub(super) fn ready<'a>(
        &'a mut self,
        given: &Given<'a>,
        asked: [u32; 2],
        tally: &mut Tally,
    ) -> Option<[View<'a>; 2]> {
        let known =
            self.last.filter(|(which, size, _)| !given.fresh && *which == given.which && *size == asked);
        let kept = match known {
            Some((_, _, kept)) => kept,
            None => {
                // Nothing is kept while it is written over.
                self.last = None;
                let kept = self.bring(given, asked);
                self.last = Some((given.which, asked, kept));
                tally.count(kept.map(|_| ()));
                kept
            }
        };
        match kept.ok()? {
            Kept::AsItCame => pair::images_in(&given.which.header, given.bytes).ok(),
            Kept::Here { shape, one } => {
                let (left, right) = self.bytes.split_at(self.bytes.len() / 2);
                let left = View::packed(shape, left).ok()?;
                Some([left, if one { left } else { View::packed(shape, right).ok()? }])
            }
        }
    }

    fn bring(&mut self, given: &Given<'_>, asked: [u32; 2]) -> Result<Kept, Unfit> {
        let images = pair::images_in(&given.which.header, given.bytes)?;
        let from = images[0].shape();
        let or = |asked: u32, own: usize| if asked == 0 { own } else { asked as usize };
        let shape = Shape { width: or(asked[0], from.width), height: or(asked[1], from.height), ..from };
        if shape == from {
            return Ok(Kept::AsItCame);
        }
        // Means for smaller ones, smooth for larger ones.
        let shrinks = shape.width <= from.width && shape.height <= from.height;
        let method = if shrinks { Method::Area } else { Method::Bilinear };
        let fits = shape.width <= self.most.0 && shape.height <= self.most.1;
        let resizer = self.resizer.as_mut().filter(|_| fits).ok_or(Unfit::Inset)?;
        if !resizer.prepare(from, shape.width, shape.height, method) {
            return Err(Unfit::Inset);
        }
        let one = given.which.header.right_offset == 0;
        let half = self.bytes.len() / 2;
        for (image, bytes) in
            images.iter().zip(self.bytes.chunks_mut(half.max(1))).take(if one { 1 } else { 2 })
        {
            let mut to = ViewMut::packed(shape, bytes).map_err(|_| Unfit::Inset)?;
            if !resizer.run(image, &mut to) {
                return Err(Unfit::Inset);
            }
        }
        Ok(Kept::Here { shape, one })
    }
}
