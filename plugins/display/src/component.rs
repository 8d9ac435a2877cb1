//! The component `display`: counts what arrives and how old it is, and shows it where that is asked for.
//!
//! Invariant: frames + gaps is what the source sent since the first frame shown; showing never changes what
//! is counted.

use trocar_sdk::RateLimit;
use trocar_sdk::data::{ImageHeader, StereoHeader};
use trocar_sdk::prelude::*;

use crate::freshness::taken;
use crate::latency::{Histogram, Latency};
use crate::mjpeg::{Clock, Encoder, Stream};
use crate::server::{Server, Serving};
use crate::viewing::{Allowance, Browser, Viewing};
use crate::window::{Settings, Window};

/// Most frames taken in one step, so that a fast source cannot hold a step for ever.
const BURST: usize = 8;

#[derive(Config)]
struct DisplayConfig {
    /// Port of 127.0.0.1 at which a browser sees the frames: `/` lists the displays, `/stream/NAME` shows
    /// one, with `/left` or `/right` behind it one eye's. 0 is any free one. Displays of a process may share
    /// a port. None: not at all
    #[config(min = 0, max = 65535, default = None)]
    mjpeg_port: Option<u16>,
    /// NAME in the address: letters, digits, `_`, `-`; empty for the component's own
    #[config(default = "")]
    name: String,
    /// Most pictures per second for a browser; each costs the step one copy of the frame. While nobody looks,
    /// up to 16 MB/s are copied, so that who comes sees the newest frame
    #[config(live, min = 0.1, max = 240.0, unit = "Hz", default = 15.0)]
    mjpeg_hz: f64,
    /// Quality of the browser's pictures
    #[config(min = 1, max = 100, unit = "%", default = 75)]
    mjpeg_quality: u8,
    /// A picture this old, by its stamp, is marked in browser and window, by a red frame and how old it is;
    /// 0: never, for pictures that come now and then
    #[config(live, min = 0.0, max = 3600.0, unit = "s", default = 0.5)]
    stale_after_s: f64,
    /// Whether a window is opened
    #[config(default = false)]
    window: bool,
    /// Widest image that is shown in browser or window; larger ones are counted only
    #[config(min = 1, max = 16384, unit = "px", default = 1920)]
    max_width: usize,
    /// Highest image that is shown there
    #[config(min = 1, max = 16384, unit = "px", default = 1080)]
    max_height: usize,
}

/// Takes frames as a screen would: off-screen for tests and measurements, as MJPEG for a browser, in a
/// window.
#[derive(Component)]
#[component(model = "on_signal", provides("screen"))]
pub struct Display {
    /// Pairs to show
    #[input(optional)]
    image: In<Frame<StereoHeader>>,
    /// Single images to show, instead
    #[input(optional)]
    picture: In<Frame<ImageHeader>>,
    /// People have closed the window.
    #[event("screen")]
    window_closed: Event<u64>,
    /// No browser can come: somebody else kept this port. Once after a Start; everything else goes on.
    #[event("screen")]
    mjpeg_refused: Event<u32>,
    /// Frames shown since Start.
    #[state]
    frames: u64,
    /// Frames lost on the way since the first one shown.
    #[state]
    gaps: u64,
    /// Frames since Start that came only after the one before had become stale.
    #[state]
    stalls: u64,
    /// Age of the last frame when it was ready to be shown.
    #[state]
    #[unit("ms")]
    latency_ms: f64,
    /// The same of all frames since Start or `reset_latency`.
    #[state]
    latency: Latency,
    /// Width of one image of the last frame.
    #[state]
    #[unit("px")]
    width: u32,
    #[state]
    #[unit("px")]
    height: u32,
    /// Whether browsers can see the frames: OFF, WAITING (somebody has the port, it is tried again),
    /// LISTENING, REFUSED.
    #[state]
    mjpeg: Serving,
    /// Port at which a browser sees the frames; 0 without one.
    #[state]
    mjpeg_port: u32,
    /// Browsers that look.
    #[state]
    viewers: u32,
    /// Pictures made for browsers since Start.
    #[state]
    pictures: u64,
    /// Whether a window is open.
    #[state]
    window_open: Flag,
    #[config]
    cfg: DisplayConfig,
    #[host]
    host: Host,
    /// Sequence number of the last frame of either input; 0 = none yet.
    last_seq: [u64; 2],
    /// Stamp of the last frame.
    last: Stamp,
    histogram: Histogram,
    viewing: Viewing,
}

#[provides("screen")]
impl Display {
    /// Frames shown since Start.
    #[read]
    fn frames(s: &DisplayState) -> u64 {
        s.frames
    }

    /// Age of the frames when they were ready to be shown: median, 99th percentile, oldest.
    #[read]
    fn latency(s: &DisplayState) -> Latency {
        s.latency
    }

    /// Forgets the ages so far.
    #[command]
    fn reset_latency(&mut self) {
        self.histogram.clear();
        self.latency = Latency::default();
    }
}

impl Display {
    /// Shows frames where that is asked for; where one thing does not work, nothing is shown.
    fn open(&mut self) -> Result {
        self.close();
        self.last = Stamp::INVALID;
        let opened = self.show_in_browser().and_then(|()| self.show_in_window());
        if opened.is_err() {
            self.close();
        }
        opened
    }

    fn show_in_browser(&mut self) -> Result {
        let Some(port) = self.cfg.mjpeg_port else { return Ok(()) };
        let stream = std::sync::Arc::new(Stream::new(&self.name()));
        let place = Server::at(port)?.show(stream.clone())?;
        let thread = format!("{} mjpeg", self.own_name());
        let (encoder, giver) =
            Encoder::start(&thread, stream.clone(), self.max_bytes(), self.cfg.mjpeg_quality, self.clock())?;
        let (pace, kept) = (RateLimit::UNLIMITED, Allowance::default());
        self.viewing.browser = Some(Browser { place, _encoder: encoder, giver, stream, pace, kept });
        self.tell_serving();
        Ok(())
    }

    fn show_in_window(&mut self) -> Result {
        if self.cfg.window {
            let title = format!("trocar {}", self.name());
            let thread = format!("{} window", self.own_name());
            let (max_bytes, clock) = (self.max_bytes(), self.clock());
            let settings = Settings { title, thread, width: 1280, height: 480, max_bytes, clock };
            self.viewing.screen = Some(Window::open(settings)?);
            self.window_open = Flag::TRUE;
        }
        Ok(())
    }

    fn clock(&self) -> Clock {
        Clock { host: self.host.clone(), freshness: self.viewing.freshness.clone() }
    }

    /// The component's, without that of its process.
    fn own_name(&self) -> &str {
        self.host.instance_name().rsplit('/').next().unwrap_or_default()
    }

    fn name(&self) -> String {
        if self.cfg.name.is_empty() { self.own_name().to_owned() } else { self.cfg.name.clone() }
    }

    fn tell_serving(&mut self) {
        let Some(browser) = &self.viewing.browser else { return };
        let (serving, port) = browser.place.serving();
        if serving == Serving::REFUSED && self.mjpeg != serving {
            self.mjpeg_refused.emit(browser.place.port().into());
        }
        (self.mjpeg, self.mjpeg_port) = (serving, port.into());
    }

    fn max_bytes(&self) -> usize {
        2 * 3 * self.cfg.max_width * self.cfg.max_height
    }

    fn close(&mut self) {
        self.viewing = Viewing::default();
        self.viewing.freshness.limit(self.cfg.stale_after_s);
        (self.mjpeg, self.mjpeg_port) = (Serving::OFF, 0);
        (self.viewers, self.window_open) = (0, Flag::FALSE);
    }

    /// Counts a frame that was taken, and shown if need be.
    fn count(&mut self, input: usize, seq: u64, stamp: Stamp) {
        self.frames += 1;
        let last = std::mem::replace(&mut self.last_seq[input], seq);
        // A number that went back is a new source, not a loss.
        if last > 0 && seq > last {
            self.gaps += seq - last - 1;
        }
        // With what it cost to copy it.
        let now = self.host.now();
        let before = std::mem::replace(&mut self.last, taken(stamp, now));
        let waited_s = if before.is_valid() { now.seconds_since(before) } else { 0.0 };
        self.stalls += u64::from(self.cfg.stale_after_s > 0.0 && waited_s > self.cfg.stale_after_s);
        let age_s = now.seconds_since(stamp);
        self.latency_ms = age_s * 1e3;
        self.histogram.count(age_s);
    }
}

impl Component for Display {
    fn configure(&mut self) -> Result {
        let named = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
        if !self.cfg.name.chars().all(named) || self.cfg.name.len() > 63 {
            let name = &self.cfg.name;
            return Err(format!(
                "name: {name:?} has other than up to 63 letters, digits, `_` and `-`: leave them out"
            )
            .into());
        }
        self.viewing.freshness.limit(self.cfg.stale_after_s);
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.frames, self.gaps, self.last_seq, self.pictures) = (0, 0, [0; 2], 0);
        self.stalls = 0;
        self.reset_latency();
        self.open()
    }

    fn resume(&mut self) -> Result {
        self.open()
    }

    fn stop(&mut self) -> Result {
        self.close();
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let (now, mjpeg_hz) = (tick.now(), self.cfg.mjpeg_hz);
        for _ in 0..BURST {
            let Some(frame) = self.image.next() else { break };
            (self.width, self.height) = (frame.header().width, frame.header().height);
            self.viewing.show(frame.header(), frame.bytes(), now, mjpeg_hz);
            let (seq, stamp) = (frame.seq(), frame.stamp());
            self.count(0, seq, stamp);
        }
        for _ in 0..BURST {
            let Some(frame) = self.picture.next() else { break };
            let ImageHeader { stamp, index, width, height, stride, format } = *frame.header();
            (self.width, self.height) = (width, height);
            let both = StereoHeader { stamp, index, width, height, stride, format, right_offset: 0 };
            self.viewing.show(&both, frame.bytes(), now, mjpeg_hz);
            let (seq, stamp) = (frame.seq(), frame.stamp());
            self.count(1, seq, stamp);
        }
        self.latency = self.histogram.told();
        self.tell_serving();
        if let Some(browser) = &self.viewing.browser {
            self.viewers = browser.stream.viewers();
            self.pictures = browser.stream.pictures();
        }
        if let Some((window, _)) = &self.viewing.screen
            && self.window_open.get()
            && !window.is_open()
        {
            self.window_open = Flag::FALSE;
            self.window_closed.emit(self.frames);
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "component_tests.rs"]
mod tests;
