//! Filters that change a frame where it lies, or a copy of it when others read it, too, or when its images
//! share rows.
//!
//! Invariant: what goes out has the header that came in, but for a copy, whose rows touch.

use trocar_sdk::FrameView;
use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use super::pair::{self, Unfit};
use crate::gray::convert;
use crate::view::{Format, Shape, ViewMut};

/// The pool for copies.
#[derive(Default)]
pub(super) struct Room(usize);

impl Room {
    /// Makes it for images up to this size, px.
    pub(super) fn reserve(&mut self, out: &mut Out<Frame<StereoHeader>>, width: u32, height: u32) -> Result {
        let most = Shape { width: width as usize, height: height as usize, format: Format::Rgb8 };
        pair::reserve(out, &mut self.0, most)
    }
}

/// A received frame on its way to an output.
pub(super) struct InPlace<'a, 'o> {
    pub(super) frame: FrameView<'a, StereoHeader>,
    pub(super) out: &'o mut Out<Frame<StereoHeader>>,
}

impl InPlace<'_, '_> {
    /// Lets `change` work on both images and sends them; without one the frame passes as it is.
    pub(super) fn run<F>(mut self, change: Option<F>) -> Result<(), Unfit>
    where
        F: FnOnce(&mut [ViewMut<'_>; 2]),
    {
        let Some(change) = change else {
            pair::images(&self.frame)?;
            self.out.forward(&self.frame);
            return Ok(());
        };
        let header = *self.frame.header();
        if !pair::share_rows(&header)?
            && let Some(bytes) = self.frame.bytes_mut()
        {
            change(&mut pair::images_mut(&header, bytes)?);
            self.out.forward(&self.frame);
            return Ok(());
        }
        let source = pair::images(&self.frame)?;
        let shape = source[0].shape();
        let mut loan = self.out.loan()?;
        let mut images = pair::blank(&mut loan, &header, shape)?;
        source.iter().zip(&mut images).for_each(|(from, to)| convert(from, to));
        change(&mut images);
        loan.commit(2 * shape.packed_bytes(), self.frame.stamp());
        Ok(())
    }
}
