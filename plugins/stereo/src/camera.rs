//! `camera`: a camera of this machine, through Video4Linux.
//!
//! Invariant: the device is open between Start and Stop only; one that fails or is unplugged is told, and
//! looked for again.

use std::time::Duration;

use trocar_sdk::data::{CameraGeometry, OperatingState, StereoHeader};
use trocar_sdk::prelude::*;

use crate::feed::Again;
use crate::layout::Layout;
use crate::live::{Live, Sent, live};
use crate::v4l2::V4l2;

#[derive(Config)]
struct CameraConfig {
    /// The camera's file
    #[config(default = "/dev/video0")]
    device: String,
    /// Pixels in a row of one image
    #[config(min = 1, max = 16384, unit = "px", default = 640)]
    width: u32,
    /// Rows of one image
    #[config(min = 1, max = 16384, unit = "px", default = 480)]
    height: u32,
    /// Layout of the pixels in memory; `mjpg`: the camera sends JPEGs, which become RGB8
    #[config(one_of = ["gray8", "rgb8", "bgr8", "bayer_rg8", "yuyv", "mjpg"], default = "yuyv")]
    format: String,
    /// Layout of the pair in a frame. `mono`: one image for both eyes; `side_by_side`: rows twice as wide;
    /// `stacked`: the left image above the right one
    #[config(one_of = ["mono", "side_by_side", "stacked"], default = "mono")]
    layout: String,
    /// From the exposure to the last byte, where it is known: stamps are that much before the arrival
    #[config(min = 0.0, max = 10.0, unit = "s", default = 0.0)]
    delay_s: f64,
    /// Images per second to ask the camera for; 0 leaves it its own
    #[config(min = 0, max = 1000, unit = "Hz", default = 30)]
    fps: u32,
    /// A camera that gives nothing for so long has stalled
    #[config(min = 0.05, max = 3600.0, unit = "s", default = 2.0)]
    stall_s: f64,
    /// Whether a device that failed is opened again
    #[config(default = true)]
    restart: bool,
    /// Time from a failure to the next try; each time twice as long, until it ran for longer than that
    #[config(min = 0.01, max = 3600.0, unit = "s", default = 1.0)]
    restart_delay_s: f64,
    /// And never longer than this
    #[config(min = 0.01, max = 3600.0, unit = "s", default = 30.0)]
    restart_delay_max_s: f64,
}

/// Takes the images of a camera such as `/dev/video0`.
#[derive(Component)]
#[component(model = "stream", rate_hz = 250, safety = "sensor", hardware)]
pub struct Camera {
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
    cfg: CameraConfig,
    #[host]
    host: Host,
    live: Live,
}

/// Images, counts and state of the camera.
#[provides("camera")]
impl Camera {
    /// Size of one image and the rate at which they come.
    #[read]
    fn camera_geometry(s: &CameraState) -> CameraGeometry {
        s.geometry
    }

    /// Frames sent since Start.
    #[read]
    fn emitted(s: &CameraState) -> u64 {
        s.sent.emitted
    }

    /// ENABLED while frames come, FAULT with the reason while the device fails, DISABLED otherwise.
    #[read]
    fn operating_state(s: &CameraState) -> OperatingState {
        s.operating_state
    }
}

impl Camera {
    fn again(&self) -> Result<Option<Again>> {
        Again::of(self.cfg.restart, self.cfg.restart_delay_s, self.cfg.restart_delay_max_s)
    }

    fn open(&mut self) -> Result {
        let (again, host) = (self.again()?, self.host.clone());
        let cfg = &self.cfg;
        let source = |layout| V4l2 {
            device: cfg.device.clone().into(),
            layout,
            compressed: cfg.format == "mjpg",
            fps: cfg.fps,
            stall: Duration::from_secs_f64(cfg.stall_s),
            delay_s: cfg.delay_s,
        };
        let (live, ports) = live!(self);
        live.open(ports, again, &host, source)
    }
}

impl Component for Camera {
    fn configure(&mut self) -> Result {
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
#[path = "camera_tests.rs"]
mod tests;
