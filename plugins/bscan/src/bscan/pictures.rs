//! The images of the scan: A-scans come in, columns and frames go out.
//!
//! Invariant: an A-scan belongs to the column where the tip was when it was taken, not where it is when it arrives.

use trocar_sdk::data::{Distance, ImageHeader, PixelFormat, Pose, SampleFormat};
use trocar_sdk::prelude::*;

use super::BScan;
use crate::image::{AScan, Grey};
use crate::payloads::{Phase, Progress, ScanColumn};

/// Frames of A-scans of one step at most.
const BURST: usize = 32;

impl BScan {
    /// Puts A-scans where they belong.
    pub(super) fn draw(&mut self) {
        let grey = Grey { low_db: self.cfg.range_db[0] as f32, high_db: self.cfg.range_db[1] as f32 };
        for _ in 0..BURST {
            let Some(frame) = self.ascan.next() else { return };
            let header = *frame.header();
            let is_known = matches!(header.format, SampleFormat::U8 | SampleFormat::F32);
            let Some(lines) = frame.lines().ok().filter(|_| is_known && header.stamp_of(0).is_some()) else {
                self.refused_frames += 1;
                continue;
            };
            for (i, bytes) in lines.iter().enumerate() {
                let ascan = match header.format {
                    SampleFormat::U8 => AScan::Bytes(bytes),
                    _ => AScan::Decibels(bytes, grey),
                };
                let Some(taken) = header.stamp_of(i) else { break };
                if self.rolling.lines() == 0 {
                    self.rolling_pose = self.poses.at(taken);
                }
                if let Some(lines) = self.rolling.add(ascan) {
                    let (none, ended) = (Progress::default(), (self.rolled as usize, lines));
                    tell(&self.mscan_column, &none, &self.last, self.rolling_pose, ended, taken);
                    self.rolled = self.rolled.wrapping_add(1);
                }
                let Some(line) = &self.line else { continue };
                // What was taken on the way to the line belongs to no column.
                if self.progress.phase != Phase::SCAN || taken < self.since.phase {
                    continue;
                }
                let Some(gone_m) = self.gone.at(taken.ns()).filter(|gone_m| *gone_m >= 0.0) else { continue };
                if let Some(ended) = self.scan.add((gone_m / line.pitch_m) as usize, ascan) {
                    tell(&self.column, &self.progress, &self.last, self.column_pose, ended, taken);
                }
                if self.scan.lines() == 1 {
                    self.column_pose = self.poses.at(taken);
                }
            }
        }
    }

    /// Ends the column that grows.
    pub(super) fn end_column(&mut self, now: Stamp) {
        if let Some(ended) = self.scan.end() {
            tell(&self.column, &self.progress, &self.last, self.column_pose, ended, now);
        }
    }

    /// Sends the image of the scan as it is now.
    pub(super) fn send_scan(&mut self, now: Stamp) {
        let pixels = self.scan.pixels();
        let header = self.header(now, 0, self.scan.width());
        let Ok(mut loan) = self.bscan_image.loan() else {
            self.left_out += 1;
            return;
        };
        *loan.header_mut() = header;
        if let Some(room) = loan.bytes_mut().get_mut(..pixels.len()) {
            room.copy_from_slice(pixels);
        }
        loan.commit(pixels.len(), now);
        self.image_index[0] += 1;
    }

    /// Sends the last moments.
    fn send_rolling(&mut self, now: Stamp) {
        let header = self.header(now, 1, self.cfg.mscan_columns as usize);
        let len = (self.cfg.mscan_columns * self.cfg.rows) as usize;
        let Ok(mut loan) = self.mscan_image.loan() else {
            self.left_out += 1;
            return;
        };
        *loan.header_mut() = header;
        if let Some(room) = loan.bytes_mut().get_mut(..len) {
            self.rolling.write(room);
        }
        loan.commit(len, now);
        self.image_index[1] += 1;
    }

    fn header(&self, stamp: Stamp, which: usize, width: usize) -> ImageHeader {
        ImageHeader {
            stamp,
            index: self.image_index[which],
            width: width as u32,
            height: self.cfg.rows,
            stride: width as u32,
            format: PixelFormat::GRAY8,
        }
    }

    /// Images that are due.
    pub(super) fn send_images(&mut self, now: Stamp) {
        let period_ns = (1e9 / self.cfg.image_rate_hz) as u64;
        if now >= self.next_image[1] {
            self.next_image[1] = Stamp::from_ns(now.ns() + period_ns);
            self.send_rolling(now);
        }
        if self.progress.phase == Phase::SCAN && now >= self.next_image[0] {
            self.next_image[0] = Stamp::from_ns(now.ns() + period_ns);
            self.send_scan(now);
        }
    }
}

/// A column is there.
fn tell(
    to: &Out<ScanColumn>,
    progress: &Progress,
    last: &Distance,
    pose: Pose,
    (column, lines): (usize, u32),
    stamp: Stamp,
) {
    to.write(&ScanColumn {
        stamp,
        scan: progress.scan,
        column: column as u32,
        lines,
        pose,
        distance: last.distance,
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_sdk::data::AScanHeader;
    use trocar_sdk::testing::Bench;

    #[test]
    fn frames_that_are_no_a_scans_are_counted() {
        let mut bench = Bench::<BScan>::new("{}");
        let header = |format, lines, samples| {
            let stamp = Stamp::from_ns(1_000);
            AScanHeader { stamp, lines, samples, format, ..AScanHeader::default() }
        };
        let bad = [
            header(SampleFormat::U8, 3, 4),
            header(SampleFormat::U16, 1, 4),
            header(SampleFormat::U8, u32::MAX, u32::MAX),
            AScanHeader { line_period: f64::NAN, ..header(SampleFormat::U8, 2, 4) },
        ];
        for header in bad {
            bench.push_frame("ascan", header, &[7; 8]);
        }
        bench.push_frame(
            "ascan",
            AScanHeader { stamp: Stamp::INVALID, ..header(SampleFormat::U8, 2, 4) },
            &[7; 8],
        );
        bench.push_frame("ascan", header(SampleFormat::U8, 2, 4), &[7; 8]);
        bench.step(1);
        assert_eq!(bench.state().refused_frames, bad.len() as u64 + 1, "all but the last one");
    }
}
