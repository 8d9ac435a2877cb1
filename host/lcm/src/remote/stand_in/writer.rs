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
use trocar_net::line::{Clock, Outbox};
use trocar_rt::pool::{Frame, FramePool, PoolFile};
use trocar_rt::segment::{Agreed, Stream, StreamShape};
use trocar_rt::stream::{Meta, Payload, RemotePools, RemoteViews, StreamWriter};

use super::{Kind, Link, StandIn, Take};

/// Slots of a pool beside those of the queue: one is filled, one is shown, and the reader may hold two.
const SLOTS_BESIDE: usize = 4;
/// Bytes of a pool, unless that is less than those slots: a long queue of large frames holds fewer of them.
const MOST_POOL: usize = 256 << 20;
/// Frames' room is made in steps of so many bytes.
const ROOM: usize = 64 << 10;

pub(super) struct AbsentWriter {
    stream: Stream<StreamWriter>,
    payload: Payload,
    slots: usize,
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
        shape: StreamShape,
        depth: usize,
        agreed: Agreed,
        views: Arc<RemoteViews>,
    ) -> io::Result<(AbsentWriter, OwnedFd)> {
        let pools = Arc::new(RemotePools::default());
        let stream = Stream::<StreamWriter>::create(shape, agreed, &pools)?;
        let memory =
            stream.fd().ok_or_else(|| io::Error::other("memory without a file"))?.try_clone_to_owned()?;
        let writer = AbsentWriter {
            stream,
            payload: shape.payload,
            // A queue keeps at most two frames for each slot that is free.
            slots: depth.saturating_add(depth / 2 + SLOTS_BESIDE),
            frames: Mutex::new(Frames { pool: None, pools, views }),
            no_room: AtomicU64::new(0),
        };
        Ok((writer, memory))
    }

    fn frame(&self, header: &[u8], bytes: &[u8]) -> Result<Frame, String> {
        let mut frames = self.frames.lock();
        let fits =
            |pool: &&Arc<FramePool>| pool.max_bytes() >= bytes.len() && pool.header_bytes() == header.len();
        let pool = match frames.pool.as_ref().filter(fits) {
            Some(pool) => pool.clone(),
            None => frames.make(self.slots, header.len(), bytes.len())?,
        };
        drop(frames);
        let mut frame = pool.loan().ok_or("all its slots are taken")?;
        let (to_header, to_bytes) = frame.parts_mut();
        to_header.copy_from_slice(header);
        to_bytes[..bytes.len()].copy_from_slice(bytes);
        Ok(frame.freeze(bytes.len()))
    }
}

impl Frames {
    /// Makes a pool for frames of this size, known to the reader.
    fn make(&mut self, slots: usize, header_bytes: usize, bytes: usize) -> Result<Arc<FramePool>, String> {
        let bytes = bytes.next_multiple_of(ROOM);
        let slots = slots.min(MOST_POOL / (header_bytes + bytes).max(1)).max(SLOTS_BESIDE) as u32;
        let pool = FramePool::new(slots, header_bytes, bytes).map_err(|e| e.to_string())?;
        let file = pool.file().ok_or("a pool without memory")?;
        let fd = file.fd().try_clone_to_owned().map_err(|e| e.to_string())?;
        let view = PoolFile::open(fd, file.shape()).map_err(|e| e.to_string())?;
        let place = self.pools.place_of(file.number()).ok_or("its frames came from too many pools")?;
        if !self.views.know(place as usize, view) {
            return Err("its headers have another length".into());
        }
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
                match self.frame(header, content.rest()) {
                    Ok(frame) => _ = self.stream.end.push_frame(frame, meta),
                    Err(_) => _ = self.no_room.fetch_add(1, Ordering::Relaxed),
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
