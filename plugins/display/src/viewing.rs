//! The places where a display's frames are shown to people, and which frames are copied for them.
//!
//! Invariant: a frame is copied when it is due for those who look, or when the allowance for those who may
//! come has room for it.

use std::sync::Arc;

use trocar_sdk::RateLimit;
use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

use crate::freshness::Freshness;
use crate::handoff::Giver;
use crate::mjpeg::{Encoder, Stream};
use crate::server::Place;
use crate::window::Window;

/// Bytes copied while no browser looks, B/s, so that a late one sees the newest frame: images that come now
/// and then are all copied, a video a few times a second.
const KEPT_BYTES_PER_S: f64 = 16e6;
/// Most that is copied at once of smaller frames, B.
const KEPT_AT_ONCE: f64 = 1e6;

/// Browsers and the window, where frames are shown to people.
#[derive(Default)]
pub(crate) struct Viewing {
    pub(crate) browser: Option<Browser>,
    pub(crate) screen: Option<(Window, Giver)>,
    /// Age of the newest frame that can be shown; the threads that show it have it, too.
    pub(crate) freshness: Arc<Freshness>,
}

impl Viewing {
    /// Copies a frame for those who look.
    pub(crate) fn show(&mut self, header: &StereoHeader, bytes: &[u8], now: Stamp, mjpeg_hz: f64) {
        let was_stale = self.freshness.stale(now).is_some();
        let mut givers = self
            .screen
            .iter_mut()
            .map(|(_, giver)| giver)
            .chain(self.browser.iter_mut().map(|b| &mut b.giver));
        if givers.any(|giver| giver.takes(header, bytes)) {
            self.freshness.renewed(header.stamp, now);
        }
        if let Some((window, giver)) = &mut self.screen
            && window.is_open()
        {
            giver.give(header, bytes);
        }
        let Some(browser) = &mut self.browser else { return };
        browser.stream.limit(mjpeg_hz);
        // A picture that is marked as stale is replaced at once, whatever the pace.
        let due = browser.pace.at(mjpeg_hz).is_due(now.ns()) || was_stale;
        let wanted = due && browser.stream.viewers() > 0;
        if wanted || browser.kept.takes(bytes.len(), now) {
            let given = browser.giver.give(header, bytes);
            if given && wanted {
                browser.pace.keep(now.ns());
            }
        }
    }
}

/// Bytes that may be copied for no viewer in particular.
#[derive(Default)]
pub(crate) struct Allowance {
    bytes: f64,
    since: Stamp,
}

impl Allowance {
    pub(crate) fn takes(&mut self, bytes: usize, now: Stamp) -> bool {
        let bytes = bytes as f64;
        let passed_s = if self.since.is_valid() { now.seconds_since(self.since) } else { f64::INFINITY };
        self.since = now;
        self.bytes = (self.bytes + passed_s * KEPT_BYTES_PER_S).min(bytes.max(KEPT_AT_ONCE));
        let enough = self.bytes >= bytes;
        self.bytes -= if enough { bytes } else { 0.0 };
        enough
    }
}

/// The parts that show frames to browsers, dropped in this order: off the list, then no more pictures.
pub(crate) struct Browser {
    pub(crate) place: Place,
    pub(crate) _encoder: Encoder,
    pub(crate) giver: Giver,
    pub(crate) stream: Arc<Stream>,
    /// The pace of frames that are given because somebody looks.
    pub(crate) pace: RateLimit,
    pub(crate) kept: Allowance,
}
