//! One frame of spectra to one frame of A-scans, and to one of bytes.
//!
//! Invariant: all lines of a frame are processed, or none.

use trocar_oct_core::chain::Light;
use trocar_oct_core::decibel::shades;
use trocar_sdk::data::{AScanHeader, LinesView, SampleFormat, SpectraHeader};
use trocar_sdk::prelude::*;

use super::OctProcessor;

impl OctProcessor {
    /// Processes one frame; returns the reason if it cannot be processed.
    pub(super) fn frame(&mut self, now: Stamp) -> Option<Result<(), &'static str>> {
        let frame = self.spectra.next()?;
        let Some(works) = &mut self.works else { return Some(Ok(())) };
        let (header, grid) = (*frame.header(), works.chain.grid());
        let (samples, bins) = (grid.samples(), grid.bins());
        let lines = match fits(&frame, &header, samples, self.cfg.max_lines) {
            Ok(lines) => lines,
            Err(why) => return Some(Err(why)),
        };
        let out = AScanHeader {
            stamp: header.stamp,
            index: header.index,
            lines: header.lines,
            samples: bins as u32,
            format: SampleFormat::F32,
            line_period: header.line_period,
            bin: grid.bin_m(),
            first: 0.0,
            ..AScanHeader::default()
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
        let (low, high) = (self.range.low as f32, self.range.high as f32);
        let before = works.light;
        let (mut last, mut lights) = (before, [0u64; 2]);
        let mut captured = None;
        for (i, line) in lines.iter().enumerate() {
            let missing = works.chain.background().missing();
            let Ok(light) = works.chain.line(line, &mut works.ascan) else { continue };
            if missing == 1 && works.chain.background().missing() == 0 {
                captured = Some(works.capture);
            }
            if light == Light::Good {
                works.search.see(&works.chain);
            }
            lights[0] += u64::from(light == Light::Dark);
            lights[1] += u64::from(light == Light::Saturated);
            last = light;
            let at = i * bins;
            if let Some(room) = loan.bytes_mut().get_mut(4 * at..4 * (at + bins)) {
                for (db, room) in works.ascan.iter().zip(room.as_chunks_mut::<4>().0) {
                    *room = db.to_ne_bytes();
                }
            }
            if let Some(room) = bytes_loan.as_mut().and_then(|b| b.bytes_mut().get_mut(at..at + bins)) {
                shades(&works.ascan, low, high, room);
                let hidden = bins.min(self.cfg.hidden_bins as usize);
                room[..hidden].fill(0);
            }
        }
        works.light = last;
        let count = header.lines as usize * bins;
        loan.commit(4 * count, header.stamp);
        bytes_loan.map(|loan| loan.commit(count, header.stamp));
        self.processed += u64::from(header.lines);
        let span_s = header.line_period * f64::from(header.lines.saturating_sub(1));
        self.latency = now.seconds_since(header.stamp) - span_s;
        self.dark_lines += lights[0];
        self.saturated_lines += lights[1];
        self.tell(before, last);
        if let Some(lines) = captured {
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
