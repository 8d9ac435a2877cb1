//! What the sources of real frames share: from a feed's frame to the output, and from its trouble to the operating state.
//!
//! Invariant: a device's trouble is the device's: the component stays ACTIVE, says FAULT with the reason, and goes on when
//! frames come again.

use trocar_sdk::data::{CameraGeometry, OperatingMode, OperatingState, StereoHeader};
use trocar_sdk::prelude::*;

use crate::feed::{Feed, Notice};
use crate::layout::Layout;

/// Frames of an output's pool: one in the making, the rest held by readers.
pub(crate) const SLOTS: u32 = 6;

/// What became of the frames.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct Sent {
    /// Frames sent since Start.
    pub emitted: u64,
    /// Frames not sent since Start: readers held all frames, or the step came too late.
    pub left_out: u64,
    /// How often the device failed since Start.
    pub failures: u64,
}

/// The ports and columns that a step of a live source works on.
pub(crate) struct Live<'a> {
    pub(crate) image: &'a mut Out<Frame<StereoHeader>>,
    pub(crate) frame_dropped: &'a mut Event<u64>,
    pub(crate) changed: &'a mut Event<OperatingState>,
    pub(crate) sent: &'a mut Sent,
    pub(crate) operating_state: &'a mut OperatingState,
    pub(crate) geometry: &'a mut CameraGeometry,
    /// Of the frame before.
    pub(crate) last: &'a mut Last,
}

/// Number and stamp of the frame sent before.
#[derive(Clone, Copy, Default)]
pub(crate) struct Last {
    stamp: Stamp,
    /// Number that comes next.
    next: u64,
}

impl Live<'_> {
    /// One step: what happened to the device, and at most one frame.
    pub(crate) fn step(&mut self, feed: &mut Feed, layout: &Layout, now: Stamp) {
        while let Some(notice) = feed.notice() {
            let (state, message) = match notice {
                Notice::Runs => (OperatingMode::ENABLED, Text::new("")),
                Notice::Failed(why) => {
                    self.sent.failures += 1;
                    (OperatingMode::FAULT, why)
                }
            };
            self.tell(state, message, now);
        }
        let Some(shot) = feed.next() else { return };
        let gap = shot.number.saturating_sub(self.last.next);
        self.last.next = shot.number + 1;
        if gap > 0 {
            self.sent.left_out += gap;
            self.frame_dropped.emit(self.sent.left_out);
        }
        let index = self.sent.emitted + self.sent.left_out;
        if self.last.stamp.is_valid() && shot.stamp > self.last.stamp {
            self.geometry.fps = (gap + 1) as f64 / shot.stamp.seconds_since(self.last.stamp);
        }
        self.last.stamp = shot.stamp;
        match self.image.loan() {
            Ok(mut loan) => {
                *loan.header_mut() = layout.header(shot.stamp, index);
                if let Some(room) = loan.bytes_mut().get_mut(..shot.bytes.len()) {
                    room.copy_from_slice(&shot.bytes);
                }
                loan.commit(shot.bytes.len(), shot.stamp);
                self.sent.emitted += 1;
            }
            Err(_) => {
                self.sent.left_out += 1;
                self.frame_dropped.emit(self.sent.left_out);
            }
        }
        feed.give_back(shot.bytes);
    }

    /// Changes the operating state, and tells.
    pub(crate) fn tell(&mut self, state: OperatingMode, message: Text<128>, now: Stamp) {
        *self.operating_state =
            OperatingState { stamp: now, state, is_homed: true.into(), message, ..OperatingState::default() };
        self.changed.emit(*self.operating_state);
    }
}
