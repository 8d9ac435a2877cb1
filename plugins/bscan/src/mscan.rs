//! The component `mscan`: the last moments of an OCT as an image that rolls.
//!
//! Invariant: it commands nobody; what are no A-scans is counted, and the next good ones go on.

use trocar_sdk::data::{AScanHeader, ImageHeader, PixelFormat, SampleFormat};
use trocar_sdk::prelude::*;

use crate::image::{AScan, Grey, Rolling};

/// Frames of the output's pool.
const SLOTS: u32 = 6;

#[derive(Config)]
struct MScanConfig {
    /// Rows of the image: bins of an A-scan from the first
    #[config(min = 1, max = 4096, unit = "px", default = 512)]
    rows: u32,
    /// Columns of the image
    #[config(min = 1, max = 4096, unit = "px", default = 512)]
    columns: u32,
    /// A-scans of a column
    #[config(min = 1, max = 10000, default = 16)]
    lines: u32,
    /// Images per second, at most as many as steps
    #[config(live, min = 0.1, max = 100.0, unit = "Hz", default = 15.0)]
    image_rate_hz: f64,
    /// Black and white of A-scans in dB; those of bytes are taken as they are
    #[config(live, default = [45.0, 95.0])]
    range_db: [f64; 2],
}

/// Shows the A-scans of the last moments, the newest at the right (M-mode).
#[derive(Component)]
#[component(name = "mscan", rate_hz = 100)]
pub struct MScan {
    /// A-scans, f32 in dB or bytes
    #[input(fifo = 64)]
    ascan: In<Frame<AScanHeader>>,
    /// The last moments
    #[output]
    image: Out<Frame<ImageHeader>>,
    /// A-scans since Start.
    #[state]
    seen: u64,
    /// Frames since Start that were no A-scans.
    #[state]
    refused_frames: u64,
    /// Images since Start for which there was no frame.
    #[state]
    left_out: u64,
    #[config]
    cfg: MScanConfig,
    rolling: Rolling,
    built: Option<(u32, u32, u32)>,
    next: Stamp,
    index: u64,
}

impl MScan {
    fn draw(&mut self) {
        let grey = Grey { low_db: self.cfg.range_db[0] as f32, high_db: self.cfg.range_db[1] as f32 };
        while let Some(frame) = self.ascan.next() {
            let format = frame.header().format;
            let Some(lines) =
                frame.lines().ok().filter(|_| matches!(format, SampleFormat::U8 | SampleFormat::F32))
            else {
                self.refused_frames += 1;
                continue;
            };
            for bytes in lines.iter() {
                self.rolling.add(if format == SampleFormat::U8 {
                    AScan::Bytes(bytes)
                } else {
                    AScan::Decibels(bytes, grey)
                });
                self.seen += 1;
            }
        }
    }

    fn send(&mut self, now: Stamp) {
        let MScanConfig { rows, columns, .. } = self.cfg;
        let len = rows as usize * columns as usize;
        let Ok(mut loan) = self.image.loan() else {
            self.left_out += 1;
            return;
        };
        *loan.header_mut() = ImageHeader {
            stamp: now,
            index: self.index,
            width: columns,
            height: rows,
            stride: columns,
            format: PixelFormat::GRAY8,
        };
        if let Some(room) = loan.bytes_mut().get_mut(..len) {
            self.rolling.write(room);
        }
        loan.commit(len, now);
        self.index += 1;
    }
}

impl Component for MScan {
    fn configure(&mut self) -> Result {
        let MScanConfig { rows, columns, lines, range_db: [low, high], .. } = self.cfg;
        if !(low.is_finite() && high.is_finite() && high - low >= 1.0) {
            return Err(format!(
                "range_db: {low} to {high} is no range: the second is at least 1 dB above the first"
            )
            .into());
        }
        if self.built == Some((rows, columns, lines)) {
            return Ok(());
        }
        self.image.reserve(rows as usize * columns as usize, SLOTS)?;
        self.rolling = Rolling::new(columns as usize, rows as usize, lines);
        self.built = Some((rows, columns, lines));
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.seen, self.refused_frames, self.left_out, self.next) = (0, 0, 0, Stamp::INVALID);
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        self.draw();
        if tick.now() >= self.next {
            let period_ns = (1e9 / self.cfg.image_rate_hz) as u64;
            self.next = Stamp::from_ns(tick.now().ns() + period_ns);
            self.send(tick.now());
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "mscan_tests.rs"]
mod tests;
