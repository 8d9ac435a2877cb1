//! `display`: an off-screen display; counts what arrives and how old it is.
//!
//! Invariant: frames + gaps is what the source sent since the first frame shown.

use trocar_sdk::data::StereoHeader;
use trocar_sdk::prelude::*;

/// Takes frames as a screen would and shows nothing: the end of a video chain for tests and measurements.
#[derive(Component)]
#[component(model = "on_signal", provides("screen"))]
pub struct Display {
    /// Frames to show
    #[input]
    image: In<Frame<StereoHeader>>,
    /// Frames shown since Start.
    #[state]
    frames: u64,
    /// Frames lost on the way since the first one shown.
    #[state]
    gaps: u64,
    /// Age of the last frame when it was shown.
    #[state]
    #[unit("ms")]
    latency_ms: f64,
    /// Of one image of the last frame.
    #[state]
    #[unit("px")]
    width: u32,
    #[state]
    #[unit("px")]
    height: u32,
    /// Sequence number of the last frame; 0 = none yet.
    last_seq: u64,
}

#[provides("screen")]
impl Display {
    /// Frames shown since Start.
    #[read]
    fn frames(s: &DisplayState) -> u64 {
        s.frames
    }
}

impl Component for Display {
    fn start(&mut self) -> Result {
        (self.frames, self.gaps, self.last_seq) = (0, 0, 0);
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        for _ in 0..super::BURST {
            let Some(frame) = self.image.next() else { break };
            self.frames += 1;
            // A number that went back is a new source, not a loss.
            if self.last_seq > 0 && frame.seq() > self.last_seq {
                self.gaps += frame.seq() - self.last_seq - 1;
            }
            self.last_seq = frame.seq();
            self.latency_ms = tick.now().seconds_since(frame.stamp()) * 1e3;
            (self.width, self.height) = (frame.header().width, frame.header().height);
        }
        Ok(())
    }
}
