//! `pipe_source`: raw frames from the standard output of a child process, such as ffmpeg or GStreamer.
//!
//! Invariant: the child runs between Start and Stop and not a moment longer, also when the host is killed;
//! what it does, and why it ended, is told in the operating state.

use std::time::Duration;

use trocar_sdk::data::{CameraGeometry, OperatingState, StereoHeader};
use trocar_sdk::prelude::*;

use crate::child::Program;
use crate::feed::Again;
use crate::layout::Layout;
use crate::live::{Live, Sent, live};

#[derive(Config)]
struct PipeSourceConfig {
    /// Program and arguments, one by one; no shell looks at them. Its output is frames without anything
    /// between them
    command: Vec<String>,
    /// Pixels in a row of one image
    #[config(min = 1, max = 16384, unit = "px")]
    width: u32,
    /// Rows of one image
    #[config(min = 1, max = 16384, unit = "px")]
    height: u32,
    /// Layout of the pixels in memory
    #[config(one_of = ["gray8", "rgb8", "bgr8", "bayer_rg8", "yuyv"], default = "rgb8")]
    format: String,
    /// Layout of the pair in a frame. `mono`: one image for both eyes; `side_by_side`: rows twice as wide;
    /// `stacked`: the left image above the right one
    #[config(one_of = ["mono", "side_by_side", "stacked"], default = "mono")]
    layout: String,
    /// From the exposure to the last byte, where it is known: stamps are that much before the arrival
    #[config(min = 0.0, max = 10.0, unit = "s", default = 0.0)]
    delay_s: f64,
    /// A program that does not complete a frame for so long has stalled: it is ended
    #[config(min = 0.05, max = 3600.0, unit = "s", default = 5.0)]
    stall_s: f64,
    /// Whether the program is run again: when it ended or stalled, or did not start any more
    #[config(default = true)]
    restart: bool,
    /// Time from a failure to the next run; each time twice as long, until it ran for longer than that
    #[config(min = 0.01, max = 3600.0, unit = "s", default = 1.0)]
    restart_delay_s: f64,
    /// And never longer than this
    #[config(min = 0.01, max = 3600.0, unit = "s", default = 30.0)]
    restart_delay_max_s: f64,
}

/// Runs a program that writes raw frames, and sends each of them. With ffmpeg: `["ffmpeg", "-loglevel",
/// "error", "-i", "film.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]`.
#[derive(Component)]
#[component(model = "stream", rate_hz = 250, safety = "sensor", hardware, starts_programs)]
pub struct PipeSource {
    /// One frame per step at most, in the layout that the configuration says
    #[output]
    image: Out<Frame<StereoHeader>>,
    /// Frames not sent since Start.
    #[event("camera")]
    frame_dropped: Event<u64>,
    /// The device fails or runs again, and why.
    #[event("camera", name = "operating_state")]
    changed: Event<OperatingState>,
    #[state]
    sent: Sent,
    #[state]
    operating_state: OperatingState,
    /// After it failed: how long after that it is opened again; 0 while it runs, or where it is not.
    #[state]
    #[unit("s")]
    restart_in_s: f64,
    #[state]
    geometry: CameraGeometry,
    #[config]
    cfg: PipeSourceConfig,
    #[host]
    host: Host,
    live: Live,
}

/// Images, counts and state of the program.
#[provides("camera")]
impl PipeSource {
    /// Size of one image and the rate at which they come.
    #[read]
    fn camera_geometry(s: &PipeSourceState) -> CameraGeometry {
        s.geometry
    }

    /// Frames sent since Start.
    #[read]
    fn emitted(s: &PipeSourceState) -> u64 {
        s.sent.emitted
    }

    /// ENABLED while frames come, FAULT with the reason while the device fails, DISABLED otherwise.
    #[read]
    fn operating_state(s: &PipeSourceState) -> OperatingState {
        s.operating_state
    }
}

impl PipeSource {
    fn again(&self) -> Result<Option<Again>> {
        Again::of(self.cfg.restart, self.cfg.restart_delay_s, self.cfg.restart_delay_max_s)
    }

    fn open(&mut self) -> Result {
        let (again, host) = (self.again()?, self.host.clone());
        let cfg = &self.cfg;
        let source = |_| Program {
            command: cfg.command.clone(),
            stall: Duration::from_secs_f64(cfg.stall_s),
            delay_s: cfg.delay_s,
        };
        let (live, ports) = live!(self);
        live.open(ports, again, &host, source)
    }
}

impl Component for PipeSource {
    fn configure(&mut self) -> Result {
        if self.cfg.command.first().is_none_or(String::is_empty) {
            return Err("command: is empty; name a program and its arguments, [\"ffmpeg\", \"-i\", …]".into());
        }
        let layout = Layout::of(self.cfg.width, self.cfg.height, &self.cfg.format, &self.cfg.layout)?;
        self.again()?;
        let (live, ports) = live!(self);
        live.configure(ports, layout)
    }

    fn start(&mut self) -> Result {
        let (live, ports) = live!(self);
        live.forget(ports);
        self.open()
    }

    fn resume(&mut self) -> Result {
        self.open()
    }

    fn stop(&mut self) -> Result {
        let now = self.host.now();
        let (live, ports) = live!(self);
        live.stop(ports, now)
    }

    fn make_safe(&mut self) -> Result {
        self.live.halt();
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let (live, ports) = live!(self);
        live.step(ports, tick.now());
        Ok(())
    }
}

#[cfg(test)]
#[path = "pipe_source_tests.rs"]
mod tests;
