//! One matcher for images of one size: brightness, then block or semi-global matching.
//!
//! Invariant: `new` makes all memory; a run allocates nothing and gives the same disparities with and without
//! AVX2.

use trocar_imaging::luma_row;
use trocar_imaging::simd::Avx2;
use trocar_sdk::data::{ImageView, PixelFormat};

use crate::block_matching::BlockMatching;
use crate::dark::Dark;
use crate::semi_global::SemiGlobal;
use crate::settings::{BadSettings, Method, Settings};
use crate::simd;

/// Distance that a census looks to, and that the paths beside it carry what it saw at an edge.
const CENSUS_REACH_PX: usize = 4;

/// Finds disparities of rectified pairs of one size.
pub struct Matcher {
    settings: Settings,
    lanes: Option<Avx2>,
    width: usize,
    height: usize,
    /// Brightness of the left image, of the right one mirrored, and a row to mirror.
    left: Vec<u8>,
    mirrored: Vec<u8>,
    row: Vec<u8>,
    dark: Dark,
    how: How,
}

/// Large, therefore boxed.
enum How {
    Bm(Box<BlockMatching>),
    Sgm(Box<SemiGlobal>),
}

impl Matcher {
    /// A matcher for images of `width` × `height` px, with what the processor has.
    ///
    /// # Errors
    /// Settings or sizes outside of their limits.
    pub fn new(width: usize, height: usize, settings: Settings) -> Result<Self, BadSettings> {
        Matcher::with_lanes(width, height, settings, Avx2::detect())
    }

    /// One that uses no special instructions; the result is the same.
    ///
    /// # Errors
    /// As [`Matcher::new`].
    pub fn portable(width: usize, height: usize, settings: Settings) -> Result<Self, BadSettings> {
        Matcher::with_lanes(width, height, settings, None)
    }

    fn with_lanes(
        width: usize,
        height: usize,
        settings: Settings,
        lanes: Option<Avx2>,
    ) -> Result<Self, BadSettings> {
        settings.check(width, height)?;
        let how = match settings.method {
            Method::Bm => How::Bm(Box::new(BlockMatching::new(settings, lanes, width, height))),
            Method::Sgm => How::Sgm(Box::new(SemiGlobal::new(settings, lanes, width, height))),
        };
        let plane = || vec![0; width * height];
        Ok(Matcher {
            settings,
            lanes,
            width,
            height,
            left: plane(),
            mirrored: plane(),
            row: vec![0; width],
            dark: Dark::new(width),
            how,
        })
    }

    /// Width and height of the images, px.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The settings that it was made with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Matches a pair of GRAY8 or RGB8 images; disparities are row after row, 1/16 px, negative where nothing
    /// is known. False, with nothing written, when a size or format is another one.
    #[must_use]
    pub fn run(&mut self, left: &ImageView<'_>, right: &ImageView<'_>, disparity: &mut [i16]) -> bool {
        let fits = |image: &ImageView<'_>| {
            (image.width() as usize, image.height() as usize) == self.size()
                && [PixelFormat::GRAY8, PixelFormat::RGB8].contains(&image.format())
        };
        if !fits(left) || !fits(right) || disparity.len() != self.width * self.height {
            return false;
        }
        self.take(left, false);
        self.take(right, true);
        match &mut self.how {
            How::Bm(matching) => matching.run(&self.left, &self.mirrored, disparity),
            How::Sgm(matching) => matching.run(&self.left, &self.mirrored, disparity),
        }
        let Settings { method, block, dark, .. } = self.settings;
        if dark > 0 {
            let reach = if method == Method::Bm { block / 2 } else { CENSUS_REACH_PX };
            self.dark.leave_out(&self.left, dark, reach, disparity);
        }
        true
    }

    /// Brightness of an image, mirrored when asked.
    fn take(&mut self, image: &ImageView<'_>, mirrored: bool) {
        let to = if mirrored { &mut self.mirrored } else { &mut self.left };
        for (to, from) in to.chunks_exact_mut(self.width).zip(image.rows()) {
            match (image.format(), mirrored) {
                (PixelFormat::RGB8, false) => luma_row(self.lanes, from, to),
                (PixelFormat::RGB8, true) => {
                    luma_row(self.lanes, from, &mut self.row);
                    simd::copy_row(self.lanes, &self.row, true, to);
                }
                _ => simd::copy_row(self.lanes, from, mirrored, to),
            }
        }
    }
}

#[cfg(test)]
#[path = "matcher_tests.rs"]
mod tests;
