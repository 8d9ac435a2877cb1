//! `phantom_source`: stereo pairs of the simulated eye.
//!
//! Invariant: an index is used up whether or not its pair could be sent; a pair is that of its stamp: the
//! world's time is the stamp, which is never in the future, and the tool stands where its last sample says it
//! is by then. What is drawn ahead is what would have been drawn.

use nalgebra::{Point3, Vector3};
use trocar_phantom::World;
use trocar_phantom::camera::{Rig, Tool};
use trocar_phantom::render::{Renderer, Scene, Side};
use trocar_sdk::data::{CameraGeometry, CartesianState, ImageHeader, PixelFormat, StereoHeader};
use trocar_sdk::prelude::*;

use crate::ahead::{Ahead, Bare, Tracing};
use crate::mosaic;
use crate::scenery::{StereoGeometry, geometry};

/// Frames of the output's pool: one in the making, the rest held by readers.
const SLOTS: u32 = 6;
/// Part of the period by which a pair that was drawn ahead may be older than its step.
const OLDEST: f64 = 0.25;

#[derive(Config)]
pub(crate) struct PhantomSourceConfig {
    /// Which world is simulated
    #[config(one_of = ["default", "no_membrane", "static", "static_no_membrane", "saccade", "step"], default = "default")]
    world: String,
    /// Seed of the world: phases of motion, texture, noise
    #[config(default = 1)]
    seed: u64,
    /// Pixels in a row of one image, an even number
    #[config(min = 32, max = 4096, unit = "px", default = 1024)]
    width: usize,
    /// Rows of one image, an even number
    #[config(min = 32, max = 4096, unit = "px", default = 768)]
    height: usize,
    /// Layout of the pixels in memory
    #[config(one_of = ["rgb8", "bayer_rg8", "yuyv"], default = "rgb8")]
    format: String,
    /// `rectified`: rows match, no lens errors. `toed_in`: what a microscope gives before rectification
    #[config(one_of = ["rectified", "toed_in"], default = "rectified")]
    rig: String,
    /// Every how many pairs the true disparity is sent; 0 = never. A rectified rig only
    #[config(min = 0, max = 1000, default = 0)]
    disparity_every: u64,
    /// Half the width of the tool
    #[config(min = 0.00005, max = 0.002, unit = "m", default = 0.0003)]
    tool_radius_m: f64,
    /// Length of the tool's shaft that is drawn
    #[config(min = 0.001, max = 0.1, unit = "m", default = 0.03)]
    tool_length_m: f64,
}

/// Takes stereo pairs of the simulated eye, at the rate of its execution.
#[derive(Component)]
#[component(model = "stream", rate_hz = 30, safety = "sensor")]
pub struct PhantomSource {
    /// The robot's true tip, in the world; without it no tool is to be seen
    #[input(optional, tag = "sim")]
    tip: In<CartesianState>,
    /// One pair per step
    #[output]
    image: Out<Frame<StereoHeader>>,
    /// True disparity of the left image: GRAY16, px · 256, 0 where the right eye does not see what the left
    /// one does.
    #[output(tag = "truth")]
    disparity: Out<Frame<ImageHeader>>,
    /// Pairs not sent since Start.
    #[event("camera")]
    frame_dropped: Event<u64>,
    /// Pairs sent since Start.
    #[state]
    emitted: u64,
    /// Pairs not sent since Start because readers held all frames.
    #[state]
    left_out: u64,
    /// Pairs sent since Start that were drawn before they were due, but for the tool.
    #[state]
    drawn_ahead: u64,
    /// Whether a tool was to be seen in the last pair.
    #[state]
    tool_shown: Flag,
    #[state]
    geometry: CameraGeometry,
    #[state]
    stereo_geometry: StereoGeometry,
    #[config]
    cfg: PhantomSourceConfig,
    #[host]
    host: Host,
    ahead: Option<Ahead>,
    tracing: Option<Tracing>,
    renderer: Option<Renderer>,
    /// World and rig that the renderer was made of.
    made_of: Option<(World, Rig)>,
    /// Disparity in the making.
    units: Vec<u16>,
}

/// Size and rate of the pairs, and what became of them.
#[provides("camera")]
impl PhantomSource {
    /// Size and rate of the pairs.
    #[read]
    fn camera_geometry(s: &PhantomSourceState) -> CameraGeometry {
        s.geometry
    }

    /// The two cameras: what a matcher and a rectifier have to know of them.
    #[read]
    fn stereo_geometry(s: &PhantomSourceState) -> StereoGeometry {
        s.stereo_geometry
    }

    /// Pairs sent since Start.
    #[read]
    fn emitted(s: &PhantomSourceState) -> u64 {
        s.emitted
    }
}

impl PhantomSource {
    fn own_name(&self) -> &str {
        self.host.instance_name().rsplit('/').next().unwrap_or_default()
    }

    /// Begins to draw ahead.
    fn begin(&mut self) -> Result {
        self.ahead = None;
        if let Some(tracing) = self.tracing.take() {
            self.renderer = tracing.done();
            if self.renderer.is_none() {
                self.made_of = None;
                return Err("tracing the picture at rest panicked: configure the source again".into());
            }
        }
        if let Some(renderer) = &self.renderer {
            self.ahead = Some(Ahead::start(&format!("{} ahead", self.own_name()), renderer.twin())?);
        }
        Ok(())
    }

    fn format(&self) -> PixelFormat {
        match self.cfg.format.as_str() {
            "bayer_rg8" => PixelFormat::BAYER_RG8,
            "yuyv" => PixelFormat::YUYV,
            _ => PixelFormat::RGB8,
        }
    }

    /// The tool as it stands at `now`.
    fn tool(&mut self, now: Stamp) -> Option<Tool> {
        // The tool stands still when its tip is not told any more.
        let pose = self.tip.latest()?.carried(now).ok()?.isometry;
        Some(Tool {
            tip: Point3::from(pose.translation.vector),
            axis: pose.rotation * Vector3::z_axis(),
            radius_m: self.cfg.tool_radius_m,
            length_m: self.cfg.tool_length_m.max(2.0 * self.cfg.tool_radius_m),
        })
    }
}

impl Component for PhantomSource {
    fn configure(&mut self) -> Result {
        let PhantomSourceConfig { width, height, .. } = self.cfg;
        if !width.is_multiple_of(2) || !height.is_multiple_of(2) {
            return Err(format!("width, height: {width} × {height} px; both must be even numbers").into());
        }
        let world = World::named(&self.cfg.world, self.cfg.seed)
            .ok_or_else(|| format!("world: {} is none of {}", self.cfg.world, World::NAMES.join(", ")))?;
        let rig = if self.cfg.rig == "toed_in" {
            Rig::toed_in(width, height)
        } else {
            Rig::rectified(width, height)
        };
        if !rig.rectified && self.cfg.disparity_every > 0 {
            return Err(
                "disparity_every: only a rectified rig has a disparity; set rig to rectified, or this to 0"
                    .into(),
            );
        }
        self.image.reserve(2 * width * height * self.format().bytes_per_pixel(), SLOTS)?;
        if self.cfg.disparity_every > 0 {
            self.disparity.reserve(2 * width * height, SLOTS)?;
            self.units = vec![0; width * height];
        }
        // Tracing takes some tenths of a second, so what is the same is kept, and the rest is waited for when
        // it is needed.
        if self.made_of != Some((world, rig)) {
            (self.renderer, self.made_of) = (None, None);
            self.tracing = Some(Tracing::begin(&format!("{} trace", self.own_name()), world, rig)?);
            self.made_of = Some((world, rig));
        }
        self.geometry = CameraGeometry { width: width as u32, height: height as u32, fps: 0.0 };
        self.stereo_geometry = geometry(&rig);
        Ok(())
    }

    fn start(&mut self) -> Result {
        (self.emitted, self.left_out, self.drawn_ahead) = (0, 0, 0);
        self.begin()
    }

    fn resume(&mut self) -> Result {
        self.begin()
    }

    fn stop(&mut self) -> Result {
        self.ahead = None;
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        let now = tick.now();
        let index = self.emitted + self.left_out;
        if tick.period_s() > 0.0 {
            self.geometry.fps = 1.0 / tick.period_s();
        }
        let period_s = tick.period_s();
        let fits = |stamp| (0.0..=OLDEST * period_s).contains(&now.seconds_since(stamp));
        let bare = self.ahead.as_mut().and_then(|ahead| ahead.take(index, fits));
        // The time of the picture: when it was due, or else now.
        let at = bare.as_ref().map_or(now, |bare| bare.stamp);
        let scene = Scene { t_s: at.ns() as f64 * 1e-9, number: index, tool: self.tool(at) };
        self.tool_shown = scene.tool.is_some().into();
        if self.renderer.is_none() {
            return Ok(());
        }
        let sent = self.draw(&scene, at, bare.as_ref());
        self.drawn_ahead += u64::from(bare.is_some() && sent);
        if let Some(ahead) = &mut self.ahead {
            bare.into_iter().for_each(|bare| ahead.give_back(bare));
            // On the grid where there is one: the step comes when it is due, or a little later.
            let due = tick.deadline();
            let last = if due.is_valid() && due <= now { due } else { now };
            if period_s > 0.0 {
                ahead.wish(Stamp::from_ns(last.ns() + (period_s * 1e9).round() as u64), index + 1);
            }
        }
        if !sent {
            self.left_out += 1;
            self.frame_dropped.emit(self.left_out);
            return Ok(());
        }
        self.emitted += 1;
        let every = self.cfg.disparity_every;
        if every > 0 && index.is_multiple_of(every) {
            self.send_disparity(&scene, at);
        }
        Ok(())
    }
}

impl PhantomSource {
    /// Draws a pair over the one that was drawn ahead, where there is one, and sends it; false where readers
    /// hold all frames.
    fn draw(&mut self, scene: &Scene, at: Stamp, bare: Option<&Bare>) -> bool {
        let format = self.format();
        let PhantomSourceConfig { width, height, .. } = self.cfg;
        let row_bytes = width * format.bytes_per_pixel();
        let (Some(renderer), Ok(mut loan)) = (&mut self.renderer, self.image.loan()) else { return false };
        *loan.header_mut() = StereoHeader {
            stamp: at,
            index: scene.number,
            width: width as u32,
            height: height as u32,
            stride: row_bytes as u32,
            format,
            right_offset: (height * row_bytes) as u64,
        };
        let room = loan.bytes_mut();
        for (side, begin) in [(Side::Left, 0), (Side::Right, height * row_bytes)] {
            let Some(to) = room.get_mut(begin..begin + height * row_bytes) else { continue };
            let take = |y: usize, rgb: &[u8]| {
                mosaic::write(format, y, rgb, &mut to[y * row_bytes..(y + 1) * row_bytes]);
            };
            match bare {
                Some(bare) => {
                    let half = bare.rgb.len() / 2;
                    renderer.draw_over(side, scene, &bare.rgb[half * side as usize..], take);
                }
                None => renderer.draw(side, scene, take),
            }
        }
        loan.commit(2 * height * row_bytes, at);
        true
    }

    /// Sends the true disparity of a pair, unless readers hold all frames.
    fn send_disparity(&mut self, scene: &Scene, at: Stamp) {
        let PhantomSourceConfig { width, height, .. } = self.cfg;
        let Some(renderer) = &mut self.renderer else { return };
        renderer.disparity(scene, &mut self.units);
        let Ok(mut loan) = self.disparity.loan() else { return };
        *loan.header_mut() = ImageHeader {
            stamp: at,
            index: scene.number,
            width: width as u32,
            height: height as u32,
            stride: 2 * width as u32,
            format: PixelFormat::GRAY16,
        };
        let (bytes, _) = loan.bytes_mut().as_chunks_mut::<2>();
        for (bytes, units) in bytes.iter_mut().zip(&self.units) {
            *bytes = units.to_ne_bytes();
        }
        loan.commit(2 * width * height, at);
    }
}

#[cfg(test)]
#[path = "phantom_source_tests.rs"]
mod tests;
