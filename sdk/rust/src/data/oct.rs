//! Payloads of optical coherence tomography: spectra, A-scans, the spectrometer, and distances measured with
//! it.
//!
//! Invariant: a frame holds whole lines only: `lines` times `samples` values, line after line, in the
//! machine's byte order; `FrameView::lines` checks it.
#![allow(
    missing_docs,
    reason = "the docs of fields go into every manifest: a field has one where name, type and unit do not say it all"
)]

use crate as trocar_sdk;
use trocar_sdk::{Flag, Payload, Stamp, named_values};

named_values! {
    /// Format of one value of a line.
    pub struct SampleFormat: u32 {
        /// Counts of the detector.
        U16 = 1,
        /// Any number; its unit is the header's.
        F32 = 2,
        /// 0 to 255 over the display range of the A-scan.
        U8 = 3,
    }
}

impl SampleFormat {
    /// Bytes of one value; 0 for an unknown format.
    pub const fn bytes(self) -> usize {
        match self {
            SampleFormat::U8 => 1,
            SampleFormat::U16 => 2,
            SampleFormat::F32 => 4,
            _ => 0,
        }
    }
}

/// Header of a frame of raw spectra: `lines` exposures one after the other, each of `samples` pixels of the
/// detector.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
#[format("spectra")]
pub struct SpectraHeader {
    /// Middle of the first line's exposure.
    pub stamp: Stamp,
    /// Counts the source's lines, from 0; that of the first line here.
    pub index: u64,
    /// Exposures in this frame.
    pub lines: u32,
    /// Pixels of one line.
    #[unit("px")]
    pub samples: u32,
    pub format: SampleFormat,
    /// Bits of a value that the detector fills, at most those of the format.
    pub bits: u32,
    /// From the middle of one exposure to that of the next.
    #[unit("s")]
    pub line_period: f64,
}

/// Header of a frame of A-scans: `lines` depth profiles one after the other, each of `samples` bins, in dB
/// for `F32`.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
#[format("ascan")]
pub struct AScanHeader {
    /// That of the spectra it was made of.
    pub stamp: Stamp,
    /// That of the spectra it was made of.
    pub index: u64,
    /// Depth profiles in this frame.
    pub lines: u32,
    /// Bins of one profile.
    #[unit("px")]
    pub samples: u32,
    pub format: SampleFormat,
    pub reserved: u32,
    /// From one line to the next.
    #[unit("s")]
    pub line_period: f64,
    /// Optical path from one bin to the next: depth times index of refraction.
    #[unit("m")]
    pub bin: f64,
    /// Optical path of the first bin.
    #[unit("m")]
    pub first: f64,
}

impl AScanHeader {
    /// Returns the middle of the exposure of line `i`; none where the header cannot tell it: no stamp, a
    /// period that is negative, above 1 s or no number, or a time beyond the range of a stamp.
    pub fn stamp_of(&self, i: usize) -> Option<Stamp> {
        let later_ns = i as f64 * self.line_period * 1e9;
        let possible = self.stamp.is_valid() && (0.0..=1.0).contains(&self.line_period);
        let later_ns = if possible { later_ns.round() as u64 } else { return None };
        self.stamp.ns().checked_add(later_ns).map(Stamp::from_ns)
    }
}

/// A spectrometer (`spectrometer`): which light falls on which pixel. Wavelength of pixel i of n, with
/// x = 2 i / (n - 1) - 1, is the sum of `wavelength[k]` times x to the power k.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Spectrometer {
    /// Pixels of one line.
    #[unit("px")]
    pub samples: u32,
    /// Bits of a value that the detector fills.
    pub bits: u32,
    /// Polynomial over the line, x from -1 to 1.
    #[unit("m")]
    pub wavelength: [f64; 4],
    #[unit("Hz")]
    pub line_rate: f64,
    #[unit("s")]
    pub exposure: f64,
}

impl Spectrometer {
    /// Wavelength of a pixel, m; one beyond the line is extrapolated.
    pub fn wavelength_of(&self, pixel: u32) -> f64 {
        let last = f64::from(self.samples.max(2) - 1);
        let x = 2.0 * f64::from(pixel) / last - 1.0;
        self.wavelength.iter().rev().fold(0.0, |sum, c| sum * x + c)
    }
}

/// A distance from the tip of a tool to a surface, along the tool.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Distance {
    /// When it was so: the middle of the exposure.
    pub stamp: Stamp,
    #[unit("m")]
    pub distance: f64,
    /// Velocity of the surface along the tool against the base, away from the tip positive; NaN: not known.
    #[unit("m/s")]
    pub velocity: f64,
    /// Standard deviation of `distance`.
    #[unit("m")]
    pub sigma: f64,
    /// The surface's echo above the noise, dB; 0 without one.
    pub snr_db: f64,
    /// False: there was no surface to be seen, and the rest is at best a prediction.
    pub valid: Flag,
    pub reserved: [u8; 7],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_line_has_its_time_and_headers_that_make_no_sense_have_none() {
        let header =
            AScanHeader { stamp: Stamp::from_ns(1_000), line_period: 250e-6, ..AScanHeader::default() };
        assert_eq!(header.stamp_of(0), Some(header.stamp));
        assert_eq!(header.stamp_of(4), Some(Stamp::from_ns(1_001_000)));
        for line_period in [f64::NAN, f64::INFINITY, -1e-3, 1e300, 1.1] {
            assert_eq!(AScanHeader { line_period, ..header }.stamp_of(1), None, "{line_period}");
        }
        assert_eq!(AScanHeader { stamp: Stamp::INVALID, ..header }.stamp_of(0), None);
        assert_eq!(AScanHeader { stamp: Stamp::from_ns(u64::MAX - 10), ..header }.stamp_of(1), None);
    }
}
