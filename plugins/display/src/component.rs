//! The component `display`: counts what arrives and how old it is, and shows it where that is asked for.
//!
//! Invariant: frames + gaps is what the source sent since the first frame shown; showing never changes what
//! is counted.

use std::sync::Arc;

use trocar_sdk::data::{ImageHeader, StereoHeader};
use trocar_sdk::prelude::*;

use crate::freshness::{Freshness, taken};
use crate::handoff::Giver;
use crate::latency::{Histogram, Latency};
use crate::window::{Settings, Window};

/// Most frames taken in one step, so that a fast source cannot hold a step for ever.
const BURST: usize = 8;

#[derive(Config)]
struct DisplayConfig {
    /// A picture this old is marked in the window and on the viewer's `/video`, by a red frame and how old it
    /// is; 0: never, for pictures that come now and then
    #[config(live, min = 0.0, max = 3600.0, unit = "s", default = 0.5)]
    stale_after_s: f64,
    /// Whether a window is opened
    #[config(default = false)]
    window: bool,
    /// Widest image that is shown in the window; larger ones are counted only
    #[config(min = 1, max = 16384, unit = "px", default = 1920)]
    max_width: usize,
    /// Highest image that is shown there
    #[config(min = 1, max = 16384, unit = "px", default = 1080)]
    max_height: usize,
}

/// Takes frames as a screen would: counts them, tells the viewer's `/video` which picture people look at, and
/// opens a window.
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
    screen: Screen,
}

/// The window that people look at.
#[derive(Default)]
struct Screen {
    window: Option<(Window, Giver)>,
    /// Age of the newest frame in the window; its thread has it, too.
    freshness: Arc<Freshness>,
}

impl Screen {
    /// Copies a frame for the window.
    fn show(&mut self, header: &StereoHeader, bytes: &[u8], now: Stamp) {
        if let Some((window, giver)) = &mut self.window
            && window.is_open()
            && giver.give(header, bytes)
        {
            self.freshness.renewed(header.stamp, now);
        }
    }
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
    /// Opens a window where that is asked for.
    fn open(&mut self) -> Result {
        self.close();
        self.last = Stamp::INVALID;
        if self.cfg.window {
            // The component's name without that of its process.
            let name = self.host.instance_name().rsplit('/').next().unwrap_or_default();
            let (title, thread) = (format!("trocar {name}"), format!("{name} window"));
            let max_bytes = 2 * 3 * self.cfg.max_width * self.cfg.max_height;
            let (host, freshness) = (self.host.clone(), self.screen.freshness.clone());
            let settings = Settings { title, thread, width: 1280, height: 480, max_bytes, host, freshness };
            self.screen.window = Some(Window::open(settings)?);
            self.window_open = Flag::TRUE;
        }
        Ok(())
    }

    fn close(&mut self) {
        self.screen = Screen::default();
        self.screen.freshness.limit(self.cfg.stale_after_s);
        self.window_open = Flag::FALSE;
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
        self.screen.freshness.limit(self.cfg.stale_after_s);
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.frames, self.gaps, self.stalls, self.last_seq) = (0, 0, 0, [0; 2]);
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
        for _ in 0..BURST {
            let Some(frame) = self.image.next() else { break };
            (self.width, self.height) = (frame.header().width, frame.header().height);
            self.screen.show(frame.header(), frame.bytes(), tick.now());
            let (seq, stamp) = (frame.seq(), frame.stamp());
            self.count(0, seq, stamp);
        }
        for _ in 0..BURST {
            let Some(frame) = self.picture.next() else { break };
            (self.width, self.height) = (frame.header().width, frame.header().height);
            self.screen.show(&(*frame.header()).into(), frame.bytes(), tick.now());
            let (seq, stamp) = (frame.seq(), frame.stamp());
            self.count(1, seq, stamp);
        }
        self.latency = self.histogram.told();
        if let Some((window, _)) = &self.screen.window
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
