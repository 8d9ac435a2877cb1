//! The thread that reads lines and makes records of them, and the step's end of it.
//!
//! Invariant: the step takes what is there and never waits; buffers go round. Where lines come faster than
//! steps take them, the newest is kept, and those between are counted. The thread ends with its `Reader`, and
//! with it whatever lines come from.

use std::os::fd::BorrowedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use trocar_imaging::side::Side;
use trocar_imaging::waits::{Again, Stop};
use trocar_sdk::prelude::*;

use crate::clock::Clock;
use crate::pieces::{LONGEST, Piece, Pieces};
use crate::plan::{Line, Plan};
use crate::way::{Got, Origin, Way};

/// Buffers beside those that wait: in the step's hands, kept back, being filled.
const SPARE: usize = 3;
/// Words that wait for the step; more are left out.
const NOTICES: usize = 8;
/// Bad lines are told at most so often; counted is each.
const TOLD: Duration = Duration::from_secs(1);
/// Time until a record that was kept back is offered again.
const OFFER: Duration = Duration::from_millis(2);
/// Longest sleep.
const SLEEP: Duration = Duration::from_secs(1);
/// Bytes of one look; the largest datagram fits.
const LOOK: usize = 65_536;
/// Datagrams that are taken between two looks at the word to stop.
const DATAGRAMS: usize = 64;
/// Characters of a bad line that are shown.
const SHOWN: usize = 64;

/// One line's values.
pub(crate) struct Shot {
    pub(crate) record: Vec<u8>,
    pub(crate) stamp: Stamp,
}

/// News for the step.
pub(crate) enum Notice {
    /// Lines come (again).
    Runs,
    /// Why none come, and after how long the source is opened again, s; 0: it is not.
    Failed(Text<128>, f64),
    /// A line that was not taken, and why.
    Bad(Text<256>),
}

/// Counted by the thread.
#[derive(Default)]
pub(crate) struct Counts {
    pub(crate) lines: AtomicU64,
    pub(crate) bad: AtomicU64,
    pub(crate) dropped: AtomicU64,
    pub(crate) clock_resets: AtomicU64,
    pub(crate) udp_port: AtomicU64,
}

/// The step's end.
pub(crate) struct Reader {
    filled: Receiver<Shot>,
    empty: SyncSender<Vec<u8>>,
    notices: Receiver<Notice>,
    pub(crate) counts: Arc<Counts>,
    side: Side,
}

impl Reader {
    /// Opens the source and begins to read; `queue` records wait at most. `again` says when a failed source
    /// is opened again.
    ///
    /// # Errors
    /// The origin cannot be opened.
    pub(crate) fn open(
        origin: Origin,
        plan: Arc<Plan>,
        queue: usize,
        again: Option<Again>,
        host: Host,
    ) -> Result<Reader> {
        let way = origin.open()?;
        let counts = Arc::<Counts>::default();
        let (filled_in, filled) = sync_channel(queue);
        let (empty, empty_out) = sync_channel(queue + SPARE);
        let (notices_in, notices) = sync_channel(NOTICES);
        for _ in 1..queue + SPARE {
            let _ = empty.try_send(plan.blank.clone());
        }
        let mut thread = Thread {
            filled: filled_in,
            empty: empty_out,
            notices: notices_in,
            counts: counts.clone(),
            spare: plan.blank.clone(),
            plan,
            kept: None,
            host: host.clone(),
            pieces: Pieces::default(),
            clock: Clock::default(),
            bad: None,
            told: None,
            runs: false,
        };
        let side = Side::begin(&host, "lines", "that reads lines", move |stop| {
            thread.supervise(&origin, way, stop, again);
        })?;
        Ok(Reader { filled, empty, notices, counts, side })
    }

    /// The oldest record that is there. Lock-free: nobody ever waits at the other end.
    pub(crate) fn next(&mut self) -> Option<Shot> {
        self.filled.try_recv().ok()
    }

    /// Gives a record's buffer back.
    pub(crate) fn give_back(&mut self, record: Vec<u8>) {
        let _ = self.empty.try_send(record);
    }

    pub(crate) fn notice(&mut self) -> Option<Notice> {
        self.notices.try_recv().ok()
    }

    /// Tells the thread to end, and does not wait for it.
    pub(crate) fn halt(&self) {
        self.side.halt();
    }

    /// Ends the thread and the source.
    ///
    /// # Errors
    /// The thread panicked.
    pub(crate) fn end(&mut self) -> Result {
        self.side.end()
    }
}

/// The thread's end.
struct Thread {
    filled: SyncSender<Shot>,
    empty: Receiver<Vec<u8>>,
    notices: SyncSender<Notice>,
    counts: Arc<Counts>,
    plan: Arc<Plan>,
    /// The buffer that the next line fills.
    spare: Vec<u8>,
    /// The newest record, while the queue is full.
    kept: Option<Shot>,
    host: Host,
    pieces: Pieces,
    clock: Clock,
    /// The last bad line that was not told yet.
    bad: Option<Text<256>>,
    /// When one was told last.
    told: Option<Instant>,
    runs: bool,
}

impl Thread {
    /// Reads, and opens the source again after it failed, until the word to stop.
    fn supervise(&mut self, origin: &Origin, first: Way, stop: &Stop, again: Option<Again>) {
        let (mut way, mut last) = (Some(first), None);
        let mut bytes = vec![0; LOOK];
        loop {
            let begun = Instant::now();
            let why = match way.take().map_or_else(|| origin.open(), Ok) {
                Ok(mut way) => self.pump(&mut way, origin.name(), &mut bytes, stop),
                Err(why) => why,
            };
            if stop.is_set() {
                return;
            }
            self.cut();
            self.clock.anew();
            let delay = again.map(|again| again.next(last, begun.elapsed()));
            last = delay;
            self.runs = false;
            let again_s = delay.unwrap_or_default().as_secs_f64();
            let _ = self.notices.try_send(Notice::Failed(Text::new(&why), again_s));
            if self.wait(delay, stop) {
                return;
            }
        }
    }

    /// Waits before the source is opened again, or for ever; tells whether it is the end.
    fn wait(&mut self, delay: Option<Duration>, stop: &Stop) -> bool {
        let begun = Instant::now();
        loop {
            self.offer();
            self.tell();
            let left = delay.map_or(SLEEP, |delay| delay.saturating_sub(begun.elapsed()));
            if stop.is_set() || left.is_zero() {
                return stop.is_set();
            }
            let _ = stop.poll(&[], left.min(self.pause()));
        }
    }

    /// Reads until the word to stop or the end; gives the reason.
    fn pump(&mut self, way: &mut Way, name: &str, bytes: &mut [u8], stop: &Stop) -> String {
        self.counts.udp_port.store(way.udp_port().into(), Ordering::Relaxed);
        loop {
            let pause = self.pause();
            let [ready, talks] = match way.files() {
                [Some(file), Some(besides)] => stop.poll(&[file, besides], pause),
                files => stop.poll(&files.into_iter().flatten().collect::<Vec<BorrowedFd<'_>>>(), pause),
            };
            if stop.is_set() {
                return String::new();
            }
            if talks {
                way.hear();
            }
            self.offer();
            for _ in 0..if ready { DATAGRAMS } else { 0 } {
                match way.read(bytes, name, stop) {
                    Got::Bytes(n) => {
                        self.push(&bytes[..n], false);
                        break;
                    }
                    Got::Datagram(n) => self.push(&bytes[..n], true),
                    Got::Nothing => break,
                    Got::Ended(why) => return why,
                }
            }
            self.tell();
        }
    }

    /// Takes what came just now; a line ends with a datagram.
    fn push(&mut self, bytes: &[u8], is_datagram: bool) {
        let arrival_ns = self.host.now().ns();
        let mut pieces = std::mem::take(&mut self.pieces);
        pieces.push(bytes, |piece| self.take(piece, arrival_ns));
        if is_datagram {
            pieces.end_of_datagram(|piece| self.take(piece, arrival_ns));
        }
        self.pieces = pieces;
    }

    /// The source has ended, perhaps in the middle of a line.
    fn cut(&mut self) {
        let mut pieces = std::mem::take(&mut self.pieces);
        pieces.end(|piece| self.take(piece, 0));
    }

    fn take(&mut self, piece: Piece<'_>, arrival_ns: u64) {
        self.counts.lines.fetch_add(1, Ordering::Relaxed);
        let (line, why) = match piece {
            Piece::Line(line) => match self.plan.read(line, &mut self.spare) {
                Ok(Line::Record(time)) => return self.record(time, arrival_ns),
                Ok(Line::Nothing) => {
                    self.counts.lines.fetch_sub(1, Ordering::Relaxed);
                    return;
                }
                Err(why) => (line, why),
            },
            Piece::TooLong(begin) => (begin, format!("longer than {LONGEST} B")),
            Piece::Unfinished(begin) => (begin, "the source ended in the middle of it".to_owned()),
        };
        self.counts.bad.fetch_add(1, Ordering::Relaxed);
        let number = self.counts.lines.load(Ordering::Relaxed);
        self.bad = Some(Text::new(&format!("line {number}: {why}: {}", shown(line))));
    }

    /// The spare buffer holds a record.
    fn record(&mut self, time: Option<f64>, arrival_ns: u64) {
        // Never 0, which says that there is no time.
        let stamp_ns = match time {
            Some(device_s) => self.clock.stamp(device_s, arrival_ns),
            None => arrival_ns.max(1),
        };
        self.counts.clock_resets.store(self.clock.resets, Ordering::Relaxed);
        for (output, begin) in self.plan.outputs.iter().zip(&self.plan.begins) {
            for at in &output.stamps {
                if let Some(place) = self.spare.get_mut(begin + at..begin + at + 8) {
                    place.copy_from_slice(&stamp_ns.to_le_bytes());
                }
            }
        }
        if !self.runs {
            self.runs = true;
            let _ = self.notices.try_send(Notice::Runs);
        }
        self.offer();
        let record = match self.kept.take() {
            // Still full: the newest takes the place of the one before.
            Some(old) => {
                self.counts.dropped.fetch_add(1, Ordering::Relaxed);
                std::mem::replace(&mut self.spare, old.record)
            }
            None => {
                let next = self.empty.try_recv().unwrap_or_else(|_| self.plan.blank.clone());
                std::mem::replace(&mut self.spare, next)
            }
        };
        self.kept = Some(Shot { record, stamp: Stamp::from_ns(stamp_ns) });
        self.offer();
    }

    /// Puts the record that is kept into the queue, where there is room.
    fn offer(&mut self) {
        let Some(shot) = self.kept.take() else { return };
        if let Err(TrySendError::Full(shot)) = self.filled.try_send(shot) {
            self.kept = Some(shot);
        }
    }

    /// Tells of a bad line, at a bounded rate.
    fn tell(&mut self) {
        if self.told.is_some_and(|told| told.elapsed() < TOLD) {
            return;
        }
        if let Some(bad) = self.bad.take() {
            self.told = Some(Instant::now());
            let _ = self.notices.try_send(Notice::Bad(bad));
        }
    }

    fn pause(&self) -> Duration {
        let tell = self.bad.as_ref().and(self.told).map(|told| TOLD.saturating_sub(told.elapsed()));
        let offer = self.kept.as_ref().map(|_| OFFER);
        tell.into_iter().chain(offer).fold(SLEEP, Duration::min)
    }
}

/// The begin of a line as people can read it.
fn shown(line: &[u8]) -> String {
    let text = String::from_utf8_lossy(&line[..line.len().min(4 * SHOWN)]);
    let cut: String = text.chars().take(SHOWN).collect();
    let more = if line.len() > cut.len() { "…" } else { "" };
    format!("\"{}\"{more}", cut.escape_debug())
}
