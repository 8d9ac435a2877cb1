//! A-scans out of the frames they come in.
//!
//! Invariant: A-scans that come out have a time and values; a frame of anything else is recognised before any
//! of it is used.

use trocar_sdk::data::{AScanHeader, SampleFormat};
use trocar_sdk::prelude::*;

use crate::taken::can_be;

/// Conversion of A-scans to grey.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grey {
    /// Black, dB.
    pub low_db: f32,
    /// White, dB.
    pub high_db: f32,
}

impl Grey {
    /// Returns the conversion for black and white as they are configured, dB.
    ///
    /// # Errors
    /// Not finite, or less than 1 dB apart.
    pub fn of([low, high]: [f64; 2]) -> Result<Grey, String> {
        if low.is_finite() && high.is_finite() && high - low >= 1.0 {
            Ok(Grey { low_db: low as f32, high_db: high as f32 })
        } else {
            Err(format!("range_db: {low} to {high} is no range: the second is at least 1 dB above the first"))
        }
    }
}

impl Default for Grey {
    fn default() -> Grey {
        Grey { low_db: 45.0, high_db: 95.0 }
    }
}

/// The values of one A-scan.
#[derive(Clone, Copy, Debug)]
pub enum AScan<'a> {
    /// Grey already.
    Bytes(&'a [u8]),
    /// dB, f32 in the machine's byte order.
    Decibels(&'a [u8], Grey),
}

/// Returns the A-scans of a frame that is taken at `now`, each with the middle of its exposure; none if the
/// frame holds something else, does not say when it was taken, or says a time that is still to come.
pub fn ascans<'a>(
    frame: &'a FrameView<'_, AScanHeader>,
    grey: Grey,
    now: Stamp,
) -> Option<impl Iterator<Item = (Stamp, AScan<'a>)> + use<'a>> {
    let header = *frame.header();
    let of: fn(&'a [u8], Grey) -> AScan<'a> = match header.format {
        SampleFormat::U8 => |bytes, _| AScan::Bytes(bytes),
        SampleFormat::F32 => AScan::Decibels,
        _ => return None,
    };
    // The last line's time is the furthest: where that can be, all can.
    let last = (header.lines as usize).saturating_sub(1);
    let in_time = header.stamp_of(last).is_some_and(|stamp| can_be(stamp, now));
    let lines = frame.lines().ok().filter(|_| in_time)?;
    Some(lines.iter().enumerate().map_while(move |(i, bytes)| Some((header.stamp_of(i)?, of(bytes, grey)))))
}
