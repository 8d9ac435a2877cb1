//! Configuration of a recorder, and the values it refuses.
//!
//! Invariant: what is refused is refused before anything of it is used.

use trocar_sdk::RateLimit;
use trocar_sdk::prelude::*;

use crate::orders::Codec;

/// Inputs that are configured, at most.
const TOPICS: usize = 1024;
/// Longest delay, pre-trigger time and duration, s.
pub(crate) const LONGEST_S: f64 = 86_400.0;

#[derive(Config)]
pub(crate) struct RecorderConfig {
    /// Directory of the recordings; nothing outside of it is written
    #[config(default = ".")]
    pub(crate) directory: String,
    /// A file to record to as soon as it is started; "" waits for `start`
    #[config(default = "")]
    pub(crate) path: String,
    /// Names of the inputs; connect each to an output
    #[config(default = [])]
    pub(crate) topics: Vec<String>,
    /// Source of each input, `process/component/port`, which names its topic; nothing: the graph is asked
    #[config(default = [])]
    pub(crate) sources: Vec<String>,
    /// Keeps only every so many-th sample of each input; nothing: all
    #[config(default = [])]
    pub(crate) every: Vec<u64>,
    /// Keeps at most so many samples per second of each input; 0 or nothing: all
    #[config(default = [])]
    pub(crate) max_rate_hz: Vec<f64>,
    /// Encoding of video: as it is, smaller without loss, or as JPEG
    #[config(default = "raw", one_of = ["raw", "qoi", "jpeg"])]
    pub(crate) video: String,
    /// Quality of JPEG, from 1 to 100
    #[config(min = 1, max = 100, default = 85)]
    pub(crate) jpeg_quality: u32,
    /// Time before `start` that is kept and recorded, too
    #[config(min = 0.0, max = 3600.0, unit = "s", default = 0.0)]
    pub(crate) pre_trigger_s: f64,
    /// Memory for what is kept before `start`; where it is not enough, the oldest gives way
    #[config(min = 1, max = 65536, unit = "MB", default = 512)]
    pub(crate) pre_trigger_mb: u64,
    /// Memory for samples that wait to be written, the last quarter of it not for frames; samples without
    /// room are lost, and counted
    #[config(min = 8, max = 65536, unit = "MB", default = 256)]
    pub(crate) buffer_mb: u64,
}

impl RecorderConfig {
    /// Checks what cannot be said of single settings.
    ///
    /// # Errors
    /// A sentence that names the setting and what to do.
    pub(crate) fn check(&self) -> Result {
        if self.topics.len() > TOPICS {
            return Err(
                format!("topics: {} are too many, there is room for {TOPICS}", self.topics.len()).into()
            );
        }
        for (key, len) in [
            ("sources", self.sources.len()),
            ("every", self.every.len()),
            ("max_rate_hz", self.max_rate_hz.len()),
        ] {
            if len > self.topics.len() {
                let topics = self.topics.len();
                return Err(format!("{key}: {len} items for {topics} topics: give as many, or fewer").into());
            }
        }
        if let Some(at) = self.every.iter().position(|every| *every == 0) {
            return Err(format!("every[{at}]: 0 keeps nothing; 1 keeps all").into());
        }
        for (at, rate) in self.max_rate_hz.iter().enumerate() {
            rate_limit(&format!("max_rate_hz[{at}]"), *rate)?;
        }
        Ok(())
    }

    pub(crate) fn codec(&self) -> Codec {
        match self.video.as_str() {
            "qoi" => Codec::Qoi,
            "jpeg" => Codec::Jpeg(self.jpeg_quality.clamp(1, 100) as u8),
            _ => Codec::Raw,
        }
    }
}

/// A time that was asked for, ns.
///
/// # Errors
/// The number is no duration, or too long.
pub(crate) fn seconds(what: &str, s: f64) -> Result<u64> {
    if s.is_finite() && (0.0..=LONGEST_S).contains(&s) {
        return Ok((s * 1e9) as u64);
    }
    Err(format!("{what}: {s} s is not between 0 s and {LONGEST_S} s").into())
}

/// The limit that keeps at most so many samples a second; 0 Hz keeps all.
///
/// # Errors
/// The number is no rate.
pub(crate) fn rate_limit(what: &str, rate_hz: f64) -> Result<RateLimit> {
    if rate_hz == 0.0 || (1e-4..=1e6).contains(&rate_hz) {
        return Ok(RateLimit::new(rate_hz));
    }
    Err(format!("{what}: {rate_hz} Hz is no rate: give 0.0001 Hz to 1000000 Hz, or 0 for all").into())
}
