//! One frame of spectra to one frame of A-scans, and to one of bytes.
//!
//! Invariant: all lines of a frame are processed, or none.

use trocar_oct_core::chain::Light;
use trocar_oct_core::decibel::shades;
use trocar_oct_core::grid::Grid;
use trocar_sdk::FrameLoan;
use trocar_sdk::data::{AScanHeader, LinesView, SampleFormat, SpectraHeader};
use trocar_sdk::prelude::*;

use super::{OctProcessor, Works};

impl OctProcessor {
    /// Processes one frame; returns the reason if it cannot be processed.
    pub(super) fn frame(&mut self, now: Stamp) -> Option<Result<(), &'static str>> {
        let frame = self.spectra.next()?;
        let Some(works) = &mut self.works else { return Some(Ok(())) };
        let header = *frame.header();
        let out = header_of(&header, works.chain.grid());
        let (samples, bins) = (works.chain.grid().samples(), out.samples as usize);
        let lines = match fits(&frame, &header, samples, self.cfg.max_lines) {
            Ok(lines) => lines,
            Err(why) => return Some(Err(why)),
        };
        let Ok(mut loan) = self.ascan.loan() else {
            self.left_out += u64::from(header.lines);
            return Some(Ok(()));
        };
        let mut bytes_loan = self.ascan_u8.loan().ok();
        *loan.header_mut() = out;
        if let Some(bytes) = &mut bytes_loan {
            *bytes.header_mut() = AScanHeader { format: SampleFormat::U8, ..out };
        }
        let shading = Shading {
            low: self.range.low as f32,
            high: self.range.high as f32,
            hidden: bins.min(self.cfg.hidden_bins as usize),
        };
        let before = works.light;
        let in_bytes = bytes_loan.as_mut().map_or(&mut [][..], FrameLoan::bytes_mut);
        let seen = works.lines(&lines, loan.bytes_mut(), in_bytes, &shading);
        let last = works.light;
        let count = header.lines as usize * bins;
        loan.commit(4 * count, header.stamp);
        bytes_loan.map(|loan| loan.commit(count, header.stamp));
        self.processed += u64::from(header.lines);
        let span_s = header.line_period * f64::from(header.lines.saturating_sub(1));
        self.latency = now.seconds_since(header.stamp) - span_s;
        self.dark_lines += seen.dark;
        self.saturated_lines += seen.saturated;
        self.tell(before, last);
        if let Some(lines) = seen.captured {
            self.background_done.emit(lines);
        }
        Some(Ok(()))
    }

    /// Tells when the light of the last line of a frame is another one than that of the last line before.
    fn tell(&self, before: Light, now: Light) {
        for (of, event) in [(Light::Dark, &self.dark), (Light::Saturated, &self.saturated)] {
            if (now == of) != (before == of) {
                event.emit(Flag::from(now == of));
            }
        }
    }
}

/// Shades of decibels as bytes: the decibels of 0 and 255, and the number of first bins that stay black.
struct Shading {
    low: f32,
    high: f32,
    hidden: usize,
}

/// Counts and news of the lines of a frame.
#[derive(Default)]
struct Seen {
    dark: u64,
    saturated: u64,
    /// Lines that a background was taken of, when it was finished in this frame.
    captured: Option<u32>,
}

impl Works {
    /// Processes lines to decibels and, as far as `bytes` has room, to bytes.
    fn lines(
        &mut self,
        lines: &LinesView<'_>,
        decibels: &mut [u8],
        bytes: &mut [u8],
        shading: &Shading,
    ) -> Seen {
        let bins = self.chain.grid().bins();
        let mut seen = Seen::default();
        for (i, line) in lines.iter().enumerate() {
            let missing = self.chain.background().missing();
            let Ok(light) = self.chain.line(line, &mut self.ascan) else { continue };
            if missing == 1 && self.chain.background().missing() == 0 {
                seen.captured = Some(self.capture);
            }
            if light == Light::Good {
                self.search.see(&self.chain);
            }
            seen.dark += u64::from(light == Light::Dark);
            seen.saturated += u64::from(light == Light::Saturated);
            self.light = light;
            let at = i * bins;
            if let Some(room) = decibels.get_mut(4 * at..4 * (at + bins)) {
                for (db, room) in self.ascan.iter().zip(room.as_chunks_mut::<4>().0) {
                    *room = db.to_ne_bytes();
                }
            }
            if let Some(room) = bytes.get_mut(at..at + bins) {
                shades(&self.ascan, shading.low, shading.high, room);
                room[..shading.hidden].fill(0);
            }
        }
        seen
    }
}

/// Header of the A-scans that are made of these spectra.
fn header_of(spectra: &SpectraHeader, grid: &Grid) -> AScanHeader {
    AScanHeader {
        stamp: spectra.stamp,
        index: spectra.index,
        lines: spectra.lines,
        samples: grid.bins() as u32,
        format: SampleFormat::F32,
        line_period: spectra.line_period,
        bin: grid.bin_m(),
        first: 0.0,
        ..AScanHeader::default()
    }
}

/// The lines of a frame that can be processed, or why it cannot.
fn fits<'a>(
    frame: &'a FrameView<'_, SpectraHeader>,
    header: &SpectraHeader,
    samples: usize,
    max_lines: u32,
) -> Result<LinesView<'a>, &'static str> {
    if header.format != SampleFormat::U16 {
        return Err(
            "its values are no u16: connect a spectrometer, whose values are what the detector counted",
        );
    }
    if header.samples as usize != samples {
        return Err(
            "its lines have another number of pixels: configure samples as the spectrometer has them",
        );
    }
    if header.lines > max_lines {
        return Err(
            "it has more lines than max_lines: configure a larger one, or smaller frames of the source",
        );
    }
    frame.lines().map_err(|_| "its bytes are fewer than its header says: the source is wrong")
}
