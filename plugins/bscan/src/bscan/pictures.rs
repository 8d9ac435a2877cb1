//! The image of the scan: A-scans come in, columns and frames go out.
//!
//! Invariant: an A-scan belongs to the column of the tip's place when it was taken, not of its place when it
//! arrives.

use trocar_sdk::prelude::*;

use super::BScan;
use crate::ascans::ascans;
use crate::payloads::Phase;
use crate::taken::Taken;

/// Frames of A-scans of one step at most.
const BURST: usize = 32;

impl BScan {
    /// Puts A-scans where they belong.
    pub(super) fn draw(&mut self, now: Stamp) {
        for _ in 0..BURST {
            let Some(frame) = self.ascan.next() else { return };
            let Some(all) = ascans(&frame, self.grey, now) else {
                self.refused_frames += 1;
                continue;
            };
            let Some(line) = &self.line else { continue };
            for (taken, ascan) in all {
                // A-scans taken on the way to the line belong to no column.
                if self.progress.phase != Phase::SCAN || taken < self.since.phase {
                    continue;
                }
                let Some(gone_m) = self.gone.at(taken.ns()).filter(|gone_m| *gone_m >= 0.0) else { continue };
                self.taken.complete(&self.track);
                self.sending.saw(taken);
                let begins = self.scan.lines() == 0;
                let ended = self.scan.add((gone_m / line.pitch_m) as usize, ascan);
                if let Some((column, lines)) = ended {
                    self.column.write(&self.taken.column(self.progress.scan, column as u32, lines));
                }
                // One that was left out begins nothing.
                if ended.is_some() || (begins && self.scan.lines() == 1) {
                    self.taken = Taken::begin(taken, &self.track);
                }
            }
        }
    }

    /// Ends the column that grows.
    pub(super) fn end_column(&mut self) {
        if let Some((column, lines)) = self.scan.end() {
            self.taken.complete(&self.track);
            self.column.write(&self.taken.column(self.progress.scan, column as u32, lines));
        }
    }

    /// Sends the image of the scan as it is now.
    fn send_scan(&mut self) {
        let (pixels, size) = (self.scan.pixels(), (self.scan.width(), self.cfg.rows as usize));
        let sent = self.sending.send(&mut self.bscan_image, size, |room| room.copy_from_slice(pixels));
        self.left_out += u64::from(!sent);
    }

    /// Sends the image of a scan that goes on, when it is time.
    pub(super) fn send_if_due(&mut self, now: Stamp) {
        if self.progress.phase == Phase::SCAN && self.sending.is_due(now, self.cfg.image_rate_hz) {
            self.send_scan();
        }
    }

    /// Sends the whole image at the end of the line, when there are A-scans in it.
    pub(super) fn send_last(&mut self) {
        if self.sending.has_any() {
            self.send_scan();
        }
    }
}

#[cfg(test)]
#[path = "pictures_tests.rs"]
mod tests;
