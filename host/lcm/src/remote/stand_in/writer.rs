//! Stands in for the output of an input that is here: puts what comes from the other machine into its queue.
//!
//! Invariant: the queue here is as long as the connection says; a frame for which its pool has no slot
//! free is dropped and counted.

use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::Mutex;
use trocar_lcm_api::LinkDetail;
use trocar_model::PortType;
use trocar_net::line::{Clock, MOST_BYTES, Outbox};
use trocar_rt::pool::{Frame, FramePool, PoolFile};
use trocar_rt::segment::{Agreed, Stream, StreamShape};
use trocar_rt::stream::{Meta, Payload, RemotePools, RemoteViews, StreamWriter};

use super::{Kind, Link, StandIn, Take};

/// Slots of a pool beside those of the queue: one is filled, one is shown, and the reader may hold two.
const SLOTS_BESIDE: usize = 4;
/// Bytes of a pool: a long queue of large frames holds fewer of them.
const MOST_POOL: usize = SLOTS_BESIDE * MOST_BYTES;
/// The longest frame with its header; something stays for the rest of its message.
pub(super) const MOST_FRAME: usize = MOST_BYTES - 4096;
/// Frames' room is made in steps of so many bytes.
const ROOM: usize = 64 << 10;

/// # Errors
/// Frames of this type can be longer than a line carries.
pub(super) fn carries(ty: &PortType) -> Result<(), String> {
    let (header, most) = frame_bytes(ty);
    match header.saturating_add(most) > MOST_FRAME {
        false => Ok(()),
        true => Err(format!("frames of up to {most} bytes are longer than a line carries: {MOST_FRAME}")),
    }
}

/// Bytes of a frame's header, and the most after it; 0: that is not known before one comes.
fn frame_bytes(ty: &PortType) -> (usize, usize) {
    match ty {
        PortType::Frame { header, max_bytes, .. } => (header.size(), *max_bytes),
        _ => (0, 0),
    }
}

pub(super) struct AbsentWriter {
    stream: Stream<StreamWriter>,
    payload: Payload,
    slots: usize,
    header_bytes: usize,
    /// Bytes of the longest frame; 0: not known.
    max_bytes: usize,
    frames: Mutex<Frames>,
    /// Frames for which there was no room.
    no_room: AtomicU64,
}

struct Frames {
    pool: Option<Arc<FramePool>>,
    pools: Arc<RemotePools>,
    views: Arc<RemoteViews>,
}

impl AbsentWriter {
    /// Makes it, and its memory.
    pub(super) fn create(
        ty: &PortType,
        (shape, depth): (StreamShape, usize),
        agreed: Agreed,
        views: Arc<RemoteViews>,
    ) -> io::Result<(AbsentWriter, OwnedFd)> {
        let pools = Arc::new(RemotePools::default());
        let stream = Stream::<StreamWriter>::create(shape, agreed, &pools)?;
        let memory =
            stream.fd().ok_or_else(|| io::Error::other("memory without a file"))?.try_clone_to_owned()?;
        let (header_bytes, max_bytes) = frame_bytes(ty);
        let writer = AbsentWriter {
            stream,
            header_bytes,
            max_bytes,
            payload: shape.payload,
            // A queue keeps at most two frames for each slot that is free.
            slots: depth.saturating_add(depth / 2 + SLOTS_BESIDE),
            frames: Mutex::new(Frames { pool: None, pools, views }),
            no_room: AtomicU64::new(0),
        };
        Ok((writer, memory))
    }

    /// Makes a frame here of one that came; `None` where there is no room for it.
    ///
    /// # Errors
    /// It is none of this connection.
    fn frame(&self, header: &[u8], bytes: &[u8]) -> Result<Option<Frame>, String> {
        if header.len() != self.header_bytes || (self.max_bytes > 0 && bytes.len() > self.max_bytes) {
            return Err(format!(
                "a frame of {} + {} bytes, which the output has not",
                header.len(),
                bytes.len()
            ));
        }
        let Some(mut frame) = self.pool_for(bytes.len()).and_then(|pool| pool.loan()) else {
            return Ok(None);
        };
        let (to_header, to_bytes) = frame.parts_mut();
        to_header.copy_from_slice(header);
        to_bytes[..bytes.len()].copy_from_slice(bytes);
        Ok(Some(frame.freeze(bytes.len())))
    }

    /// The pool for a frame of so many bytes, known to the reader. Frames that grow get one that is twice as
    /// long, so that there are few.
    fn pool_for(&self, bytes: usize) -> Option<Arc<FramePool>> {
        let mut frames = self.frames.lock();
        let before = frames.pool.as_ref().map_or(0, |pool| pool.max_bytes());
        if let Some(pool) = frames.pool.as_ref().filter(|_| before >= bytes) {
            return Some(pool.clone());
        }
        let most = match self.max_bytes {
            0 => bytes.max(2 * before).min(MOST_FRAME),
            most => most,
        };
        let pool = frames.make(self.slots, self.header_bytes, most.next_multiple_of(ROOM));
        let told = self.no_room.load(Ordering::Relaxed) > 0;
        pool.inspect_err(|e| {
            if !told {
                log::warn!("frames of a connection are dropped: no memory for them: {e}");
            }
        })
        .ok()
    }
}

impl Frames {
    fn make(&mut self, slots: usize, header_bytes: usize, bytes: usize) -> io::Result<Arc<FramePool>> {
        let slots = slots.min(MOST_POOL / (header_bytes + bytes).max(1)).max(SLOTS_BESIDE) as u32;
        let pool = FramePool::new(slots, header_bytes, bytes)?;
        let file = pool.file().ok_or_else(|| io::Error::other("a pool without memory"))?;
        let view = PoolFile::open(file.fd().try_clone_to_owned()?, file.shape())?;
        let place = self.pools.place_of(file.number()).filter(|place| self.views.know(*place as usize, view));
        place.ok_or_else(|| io::Error::other("they came from too many pools"))?;
        self.pool = Some(pool.clone());
        Ok(pool)
    }
}

impl StandIn for AbsentWriter {
    fn came(&self, kind: Kind, mut content: Take<'_>, clock: &Clock) -> Result<(), String> {
        let expected = if self.payload == Payload::Frame { Kind::Frame } else { Kind::Sample };
        if kind != expected {
            return Err(format!("{kind:?} of a writer"));
        }
        let [seq, stamp_ns, came_ns] = [content.u64()?, content.u64()?, content.u64()?];
        let meta = Meta { stamp_ns: clock.here(stamp_ns), came_ns: clock.here(came_ns), seq };
        match self.payload {
            Payload::Plain { bytes } => {
                let data = content.rest();
                if data.len() != bytes {
                    return Err(format!("a sample of {} bytes, where each has {bytes}", data.len()));
                }
                self.stream.end.push(data, meta);
            }
            Payload::Frame => {
                let header = content.u32()? as usize;
                let header = content.bytes(header)?;
                match self.frame(header, content.rest())? {
                    Some(frame) => _ = self.stream.end.push_frame(frame, meta),
                    None => _ = self.no_room.fetch_add(1, Ordering::Relaxed),
                }
            }
        }
        self.stream.newest_ns.set(meta.came_ns);
        self.stream.for_reader.notify();
        Ok(())
    }

    fn fill(&self, _: Link, _: &mut Outbox) -> bool {
        false
    }

    fn correct(&self, detail: &mut LinkDetail) {
        let stats = self.stream.end.stats();
        detail.dropped += stats.dropped.saturating_sub(stats.skipped) + self.no_room.load(Ordering::Relaxed);
        detail.skipped += stats.skipped;
        detail.came = stats.pushed + self.no_room.load(Ordering::Relaxed);
    }
}
