//! Frames from a thread that waits for a device to the component's step, without a lock.
//!
//! Invariant: the step takes what is there and never waits; buffers go round and are never freed on its side.
//! The thread ends with its `Feed`, and with it whatever the device is. A device that fails is told, and
//! opened again where that is asked for.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use trocar_imaging::side::Side;
pub(crate) use trocar_imaging::waits::{Again, Stop};
use trocar_sdk::prelude::*;

/// Buffers that go round: one being filled, the rest on their way.
const BUFFERS: usize = 4;
/// Words of trouble that wait for the step; more are left out.
const NOTICES: usize = 8;

/// A device that frames come from.
pub(crate) trait Source: Send + 'static {
    /// The open device.
    type Session: Send;
    /// # Errors
    /// Why it cannot be opened, and what to do.
    fn open(&self) -> std::result::Result<Self::Session, String>;
    /// Hands on frames until it is told to stop or the device fails; gives the reason.
    fn pump(&self, session: Self::Session, giver: &mut Giver, stop: &Stop) -> String;
}

/// One frame.
pub(crate) struct Shot {
    pub(crate) bytes: Vec<u8>,
    pub(crate) stamp: Stamp,
    /// Counts the device's frames from 0; one that found no buffer uses up its number.
    pub(crate) number: u64,
}

/// State of the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Notice {
    /// Frames come (again).
    Runs,
    /// Why none come, and after how long the device is opened again; 0: it is not.
    Failed(Text<128>, f64),
}

/// The component's end.
pub(crate) struct Feed {
    filled: Receiver<Shot>,
    empty: SyncSender<Vec<u8>>,
    notices: Receiver<Notice>,
    side: Side,
}

impl Feed {
    /// Opens the device and begins to take frames of `bytes` each. `again` says when a failed device is
    /// opened again.
    ///
    /// # Errors
    /// As [`Source::open`].
    pub(crate) fn open<S: Source>(source: S, bytes: usize, again: Option<Again>, host: Host) -> Result<Feed> {
        let session = source.open()?;
        let (filled_in, filled) = sync_channel(BUFFERS);
        let (empty, empty_out) = sync_channel(BUFFERS);
        let (notices_in, notices) = sync_channel(NOTICES);
        for _ in 1..BUFFERS {
            empty.try_send(vec![0; bytes]).map_err(|_| "there is room for all buffers")?;
        }
        let mut giver = Giver {
            filled: filled_in,
            empty: empty_out,
            notices: notices_in,
            spare: Some(vec![0; bytes]),
            host: host.clone(),
            number: 0,
            runs: false,
        };
        let side = Side::begin(&host, "frames", "of the device", move |stop| {
            supervise(&source, session, &mut giver, stop, again);
        })?;
        Ok(Feed { filled, empty, notices, side })
    }

    /// The oldest frame that is there. Lock-free: nobody ever waits at the other end.
    pub(crate) fn next(&mut self) -> Option<Shot> {
        self.filled.try_recv().ok()
    }

    /// Gives a frame's buffer back.
    pub(crate) fn give_back(&mut self, bytes: Vec<u8>) {
        // There is room for all buffers; a thread that has ended needs none.
        let _ = self.empty.try_send(bytes);
    }

    /// The next change of the device since the last asking, one after the other.
    pub(crate) fn notice(&mut self) -> Option<Notice> {
        self.notices.try_recv().ok()
    }

    /// Tells the thread to end, and does not wait for it.
    pub(crate) fn halt(&self) {
        self.side.halt();
    }

    /// Ends the thread and the device.
    ///
    /// # Errors
    /// The thread panicked.
    pub(crate) fn end(&mut self) -> Result {
        self.side.end()
    }
}

/// Runs the device, and opens it again after it failed, until it is told to stop.
fn supervise<S: Source>(source: &S, first: S::Session, giver: &mut Giver, stop: &Stop, again: Option<Again>) {
    let mut session = Some(first);
    let mut last = None;
    loop {
        let begun = Instant::now();
        let why = match session.take().map_or_else(|| source.open(), Ok) {
            Ok(open) => source.pump(open, giver, stop),
            Err(why) => why,
        };
        if stop.is_set() {
            return;
        }
        let delay = again.map(|again| again.next(last, begun.elapsed()));
        last = delay;
        giver.failed(&why, delay.unwrap_or_default());
        if delay.is_none_or(|delay| stop.wait(delay)) {
            return;
        }
    }
}

/// The thread's end.
pub(crate) struct Giver {
    filled: SyncSender<Shot>,
    empty: Receiver<Vec<u8>>,
    notices: SyncSender<Notice>,
    /// The buffer to fill; none only inside `give`.
    spare: Option<Vec<u8>>,
    host: Host,
    number: u64,
    runs: bool,
}

impl Giver {
    /// The buffer that the next frame goes into.
    pub(crate) fn room(&mut self) -> &mut [u8] {
        self.spare.as_deref_mut().unwrap_or_default()
    }

    /// Hands on what [`Giver::room`] holds, taken `delay_s` ago. Where the step has not given a buffer back,
    /// the frame is lost, and its number with it.
    pub(crate) fn give(&mut self, delay_s: f64) {
        let number = self.number;
        self.number += 1;
        if !self.runs {
            self.runs = true;
            let _ = self.notices.try_send(Notice::Runs);
        }
        let Ok(next) = self.empty.try_recv() else { return };
        let Some(bytes) = self.spare.replace(next) else { return };
        let now = self.host.now().ns();
        // Never 0, which says that there is no time.
        let stamp = Stamp::from_ns(now.saturating_sub((delay_s * 1e9) as u64).max(1));
        let _ = self.filled.try_send(Shot { bytes, stamp, number });
    }

    fn failed(&mut self, why: &str, again: Duration) {
        self.runs = false;
        let _ = self.notices.try_send(Notice::Failed(Text::new(why), again.as_secs_f64()));
    }
}
