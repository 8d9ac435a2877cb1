//! Code that the sources of real frames share: from a feed's frame to the output, and from its trouble to the
//! operating state.
//!
//! Invariant: a device's trouble is the device's: the component stays ACTIVE, says FAULT with the reason, and
//! goes on when frames come again.

use trocar_sdk::data::{CameraGeometry, OperatingMode, OperatingState, StereoHeader};
use trocar_sdk::prelude::*;

use crate::feed::{Again, Feed, Notice, Source};
use crate::layout::Layout;

/// Frames of an output's pool: one in the making, the rest held by readers.
const SLOTS: u32 = 6;

/// Counts of frames sent and left out, and of failures.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Sent {
    /// Frames sent since Start.
    pub emitted: u64,
    /// Frames not sent since Start: readers held all frames, or the step came too late.
    pub left_out: u64,
    /// Failures of the device since Start.
    pub failures: u64,
}

/// A real source while it lives: its device, and what its frames are.
#[derive(Default)]
pub(crate) struct Live {
    layout: Option<Layout>,
    feed: Option<Feed>,
    /// Stamp of the frame sent before, and the number that comes next.
    last: (Stamp, u64),
}

/// The ports and columns of a component that a live source works on: `live!` lends them.
pub(crate) struct Ports<'a> {
    pub(crate) image: &'a mut Out<Frame<StereoHeader>>,
    pub(crate) frame_dropped: &'a mut Event<u64>,
    pub(crate) changed: &'a mut Event<OperatingState>,
    pub(crate) sent: &'a mut Sent,
    pub(crate) operating_state: &'a mut OperatingState,
    pub(crate) restart_in_s: &'a mut f64,
    pub(crate) geometry: &'a mut CameraGeometry,
}

/// The live source of a component, and its ports.
macro_rules! live {
    ($component:expr) => {{
        let ports = $crate::live::Ports {
            image: &mut $component.image,
            frame_dropped: &mut $component.frame_dropped,
            changed: &mut $component.changed,
            sent: &mut $component.sent,
            operating_state: &mut $component.operating_state,
            restart_in_s: &mut $component.restart_in_s,
            geometry: &mut $component.geometry,
        };
        (&mut $component.live, ports)
    }};
}
pub(crate) use live;

impl Live {
    /// Makes room for frames of a layout.
    ///
    /// # Errors
    /// The host has not the memory.
    pub(crate) fn configure(&mut self, ports: Ports<'_>, layout: Layout) -> Result {
        ports.image.reserve(layout.frame_bytes(), SLOTS)?;
        *ports.geometry = CameraGeometry { width: layout.width, height: layout.height, fps: 0.0 };
        self.layout = Some(layout);
        Ok(())
    }

    /// Counts from 0.
    pub(crate) fn forget(&mut self, ports: Ports<'_>) {
        *ports.sent = Sent::default();
        *ports.operating_state = OperatingState::default();
    }

    /// Opens the device; `source` makes it of the layout of its frames.
    ///
    /// # Errors
    /// As [`Feed::open`].
    pub(crate) fn open<S: Source>(
        &mut self,
        ports: Ports<'_>,
        again: Option<Again>,
        host: &Host,
        source: impl FnOnce(Layout) -> S,
    ) -> Result {
        self.feed = None;
        (self.last, *ports.restart_in_s) = (Default::default(), 0.0);
        let Some(layout) = self.layout else { return Ok(()) };
        self.feed = Some(Feed::open(source(layout), layout.frame_bytes(), again, host.clone())?);
        Ok(())
    }

    /// Ends the device, and tells.
    ///
    /// # Errors
    /// Its thread panicked.
    pub(crate) fn stop(&mut self, mut ports: Ports<'_>, now: Stamp) -> Result {
        let ended = self.feed.take().map_or(Ok(()), |mut feed| feed.end());
        *ports.restart_in_s = 0.0;
        ports.tell(OperatingMode::DISABLED, Text::new(""), now);
        ended
    }

    /// The device goes with its thread, which is told to end and not waited for.
    pub(crate) fn halt(&self) {
        if let Some(feed) = &self.feed {
            feed.halt();
        }
    }

    /// One step: what happened to the device, and at most one frame.
    pub(crate) fn step(&mut self, mut ports: Ports<'_>, now: Stamp) {
        let Some((feed, layout)) = self.feed.as_mut().zip(self.layout.as_ref()) else { return };
        while let Some(notice) = feed.notice() {
            let (state, message, again_s) = match notice {
                Notice::Runs => (OperatingMode::ENABLED, Text::new(""), 0.0),
                Notice::Failed(why, again_s) => {
                    ports.sent.failures += 1;
                    (OperatingMode::FAULT, why, again_s)
                }
            };
            *ports.restart_in_s = again_s;
            ports.tell(state, message, now);
        }
        let Some(shot) = feed.next() else { return };
        let (before, next) = &mut self.last;
        let gap = shot.number.saturating_sub(*next);
        *next = shot.number + 1;
        if gap > 0 {
            ports.sent.left_out += gap;
            ports.frame_dropped.emit(ports.sent.left_out);
        }
        let index = ports.sent.emitted + ports.sent.left_out;
        if before.is_valid() && shot.stamp > *before {
            ports.geometry.fps = (gap + 1) as f64 / shot.stamp.seconds_since(*before);
        }
        // Two that were read at once are still one after the other.
        let least = if before.is_valid() { before.ns() + 1 } else { 0 };
        let stamp = Stamp::from_ns(shot.stamp.ns().max(least));
        *before = stamp;
        match ports.image.loan() {
            Ok(mut loan) => {
                *loan.header_mut() = layout.header(stamp, index);
                if let Some(room) = loan.bytes_mut().get_mut(..shot.bytes.len()) {
                    room.copy_from_slice(&shot.bytes);
                }
                loan.commit(shot.bytes.len(), stamp);
                ports.sent.emitted += 1;
            }
            Err(_) => {
                ports.sent.left_out += 1;
                ports.frame_dropped.emit(ports.sent.left_out);
            }
        }
        feed.give_back(shot.bytes);
    }
}

impl Ports<'_> {
    /// Changes the operating state, and tells.
    fn tell(&mut self, state: OperatingMode, message: Text<128>, now: Stamp) {
        *self.operating_state =
            OperatingState { stamp: now, state, is_homed: true.into(), message, ..OperatingState::default() };
        self.changed.emit(*self.operating_state);
    }
}
