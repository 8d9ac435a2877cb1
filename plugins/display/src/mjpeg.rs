//! A display's pictures as JPEG, for whoever looks at them in a browser.
//!
//! Invariant: pictures are made only while somebody looks, and only the newest is kept: a slow viewer misses
//! some and holds up nobody. Who comes late sees the newest frame at once, also when no other ever comes; one
//! that is stale is marked.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use trocar_imaging::pixels::{Part, rgb};
use trocar_imaging::side;
use trocar_sdk::{Host, RateLimit, Result};

use crate::freshness::{Freshness, Stale};
use crate::handoff::{Giver, Taker, pair};
use crate::mark;

/// The encoder looks so often for a frame while somebody looks at its pictures.
const LOOKS: Duration = Duration::from_millis(2);
/// While nobody looks, the encoder checks so often for viewers, and for the newest frame to keep for the next
/// one.
const RESTS: Duration = Duration::from_millis(20);

/// A stream of pictures that a server shows under one name.
pub(crate) struct Stream {
    pub(crate) name: String,
    /// Number of viewers, at any part.
    viewers: AtomicU32,
    /// Most pictures of a part per second, the bits of an f64.
    most_hz: AtomicU64,
    parts: [Shown; 3],
    closed: AtomicBool,
    /// Pictures made.
    pictures: AtomicU64,
}

/// One part of a stream.
#[derive(Default)]
struct Shown {
    viewers: AtomicU32,
    /// Pictures so far, and the newest while it shows the newest frame or one shortly before.
    newest: Mutex<(u64, Option<Arc<Vec<u8>>>)>,
    news: Condvar,
}

impl Stream {
    pub(crate) fn new(name: &str) -> Stream {
        Stream {
            name: name.to_owned(),
            viewers: AtomicU32::new(0),
            most_hz: AtomicU64::new(f64::INFINITY.to_bits()),
            parts: Default::default(),
            closed: AtomicBool::new(false),
            pictures: AtomicU64::new(0),
        }
    }

    /// Number of viewers, at any part.
    pub(crate) fn viewers(&self) -> u32 {
        self.viewers.load(Ordering::Relaxed)
    }

    /// Makes no more pictures of a part per second.
    pub(crate) fn limit(&self, most_hz: f64) {
        self.most_hz.store(most_hz.to_bits(), Ordering::Relaxed);
    }

    /// Somebody looks at a part, until the guard is dropped.
    pub(crate) fn look(self: &Arc<Self>, part: Part) -> Viewer {
        self.viewers.fetch_add(1, Ordering::Relaxed);
        self.parts[part as usize].viewers.fetch_add(1, Ordering::Relaxed);
        Viewer { stream: self.clone(), part, seen: 0 }
    }

    /// No more pictures come; whoever waits is told.
    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Release);
        for part in &self.parts {
            let _held = held(&part.newest);
            part.news.notify_all();
        }
    }

    /// Pictures made since Start.
    pub(crate) fn pictures(&self) -> u64 {
        self.pictures.load(Ordering::Relaxed)
    }

    fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    fn is_seen(&self, part: Part) -> bool {
        self.parts[part as usize].viewers.load(Ordering::Relaxed) > 0
    }

    fn publish(&self, part: Part, picture: Vec<u8>) {
        let shown = &self.parts[part as usize];
        let mut newest = held(&shown.newest);
        *newest = (newest.0 + 1, Some(Arc::new(picture)));
        shown.news.notify_all();
        self.pictures.fetch_add(1, Ordering::Relaxed);
    }

    /// The picture of a part is old: who comes now gets a new one.
    fn forget(&self, part: Part) {
        held(&self.parts[part as usize].newest).1 = None;
    }
}

/// The data behind a lock are whole after each of its few lines, so a panic elsewhere spoils nothing.
fn held<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Somebody who looks.
pub(crate) struct Viewer {
    stream: Arc<Stream>,
    part: Part,
    /// Number of the picture seen last.
    seen: u64,
}

impl Viewer {
    /// The newest picture not seen before, waiting for it for a time; `None` when none came. An error when
    /// none will.
    ///
    /// # Errors
    /// The display has stopped.
    pub(crate) fn next(&mut self, wait: Duration) -> std::result::Result<Option<Arc<Vec<u8>>>, Closed> {
        let shown = &self.stream.parts[self.part as usize];
        let until = Instant::now() + wait;
        let mut newest = held(&shown.newest);
        loop {
            if self.stream.is_closed() {
                return Err(Closed);
            }
            if let (number, Some(picture)) = &*newest
                && *number > self.seen
            {
                self.seen = *number;
                return Ok(Some(picture.clone()));
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            newest = shown.news.wait_timeout(newest, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        self.stream.viewers.fetch_sub(1, Ordering::Relaxed);
        self.stream.parts[self.part as usize].viewers.fetch_sub(1, Ordering::Relaxed);
    }
}

/// The display has stopped.
#[derive(Debug)]
pub(crate) struct Closed;

/// The clock and the age of the newest picture, for a thread that shows it.
pub(crate) struct Clock {
    pub(crate) host: Host,
    pub(crate) freshness: Arc<Freshness>,
}

impl Clock {
    pub(crate) fn stale(&self) -> Option<Stale> {
        self.freshness.stale(self.host.now())
    }
}

/// The thread that makes the pictures of a stream; dropped, it ends.
pub(crate) struct Encoder {
    stream: Arc<Stream>,
    thread: Option<JoinHandle<()>>,
}

impl Encoder {
    /// Makes pictures of frames of up to `max_bytes` that come through the giver, in a thread of that name.
    ///
    /// # Errors
    /// The system has no thread for it.
    pub(crate) fn start(
        name: &str,
        stream: Arc<Stream>,
        max_bytes: usize,
        quality: u8,
        clock: Clock,
    ) -> Result<(Encoder, Giver)> {
        let (giver, taker) = pair(max_bytes);
        let seen = stream.clone();
        let thread = side::spawn(name, move || encode(&seen, taker, quality, &clock))
            .map_err(|why| format!("no thread for the pictures: {why}"))?;
        Ok((Encoder { stream, thread: Some(thread) }, giver))
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        self.stream.close();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Which frame a part shows, and which it may show next.
#[derive(Clone, Copy, Default)]
struct Made {
    /// Counts frames from 1; 0 = none.
    frame: u64,
    /// The newest frame that the pace was asked about.
    asked: u64,
    pace: RateLimit,
    /// Its mark, where it is stale.
    mark: Option<u64>,
}

fn encode(stream: &Stream, mut taker: Taker, quality: u8, clock: &Clock) {
    let mut pixels = Vec::new();
    let mut frame = 0;
    let mut made = [Made::default(); 3];
    let began = Instant::now();
    while !stream.is_closed() {
        frame += u64::from(taker.renew());
        let most_hz = f64::from_bits(stream.most_hz.load(Ordering::Relaxed));
        let now_ns = u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX);
        let stale = clock.stale().filter(|_| frame > 0);
        let mark = stale.map(Stale::turn);
        for (part, made) in Part::ALL.into_iter().zip(&mut made) {
            if !stream.is_seen(part) {
                if made.frame > 0 {
                    stream.forget(part);
                    *made = Made::default();
                }
                continue;
            }
            // Without a mark it is shown again only as a newer frame.
            let other = made.frame != frame || (mark.is_some() && made.mark != mark);
            let pace = made.pace.at(most_hz);
            // A frame that came too early is shown later, unless another one came by then.
            let due = (made.asked != frame && pace.is_due(now_ns)) || now_ns >= pace.due_ns();
            made.asked = frame;
            let turned = made.mark.is_some() != mark.is_some();
            if !other || !(due || turned) {
                continue;
            }
            made.pace.keep(now_ns);
            (made.frame, made.mark) = (frame, mark);
            let shown = taker.newest();
            // The giver gives whole frames only.
            let Ok((width, height)) = rgb(&shown.header, shown.bytes(), part, &mut pixels) else { continue };
            if let Some(stale) = stale {
                let images = (width / shown.header.width.max(1)).max(1);
                mark::draw(&mut pixels, (width as usize, height as usize), images as usize, stale);
            }
            if let Some(picture) = jpeg(&pixels, width, height, quality) {
                stream.publish(part, picture);
            }
        }
        std::thread::sleep(if stream.viewers() > 0 { LOOKS } else { RESTS });
    }
}

/// `None` for an image that is too large for the format.
fn jpeg(rgb: &[u8], width: u32, height: u32, quality: u8) -> Option<Vec<u8>> {
    let (width, height) = (u16::try_from(width).ok()?, u16::try_from(height).ok()?);
    let mut picture = Vec::with_capacity(rgb.len() / 8);
    let encoder = jpeg_encoder::Encoder::new(&mut picture, quality);
    encoder.encode(rgb, width, height, jpeg_encoder::ColorType::Rgb).ok()?;
    Some(picture)
}
