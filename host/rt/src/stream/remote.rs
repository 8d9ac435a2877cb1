//! Additions of a link whose other end is in another process.
//!
//! Frames stay in their owner's memory: the writer lends each one under a number and keeps it until the
//! reader has set that number's bit, or is gone with all it held. Plain samples are copied once, so that they
//! stay as they are. Invariant: nothing the other process writes is used before it was checked here.

use std::sync::{Arc, OnceLock};

use super::leases::{LEASES, Leases, returned};
use super::slots::{Content, Located};
use crate::buf::AlignedBuf;
use crate::pool::{Frame, FramePool, MOST_VIEWS, RemoteViews};
use crate::region::Layout;
use crate::sync::{AtomicBool, AtomicU64, Ordering};
use crate::wake::Waker;

/// Frames a link can always have lent: the one that is looked at, and the newest. Beyond, it has two at most
/// for each slot of their pool that is free, as a queue inside a process has, so that a reader that gives
/// none back stops only itself.
const ALWAYS: u64 = 3;
/// Pools whose frames one link can carry in its life.
pub const POOLS_PER_LINK: usize = MOST_VIEWS;

/// The pools whose frames this link carries, by their place on it. The writer gives a pool its place with its
/// first frame; a manager tells the other end, which leaves the frame where it is until then.
#[derive(Default)]
pub struct RemotePools {
    /// Numbers of pools by their place on the link; 0 = none.
    known: [AtomicU64; POOLS_PER_LINK],
    /// 1 when a frame came of one pool too many, and was not sent.
    overflowed: AtomicU64,
    /// Frames lent by this link; none of plain samples.
    leases: OnceLock<Arc<Leases>>,
    writer_left: AtomicBool,
    /// Rung when a pool got its place.
    bell: Option<Arc<Waker>>,
}

impl RemotePools {
    /// Rings this bell whenever there is a pool to be told of.
    pub fn ringing(bell: Arc<Waker>) -> Arc<Self> {
        Arc::new(Self { bell: Some(bell), ..Self::default() })
    }

    /// The place of the pool with this number: its own, or the next free one. For the writer, or before there
    /// is one.
    pub fn place_of(&self, number: u64) -> Option<u32> {
        for (place, known) in self.known.iter().enumerate() {
            match known.load(Ordering::Relaxed) {
                0 => {
                    known.store(number, Ordering::Release);
                    if let Some(bell) = &self.bell {
                        bell.notify();
                    }
                }
                other if other != number => continue,
                _ => {}
            }
            return Some(place as u32);
        }
        self.overflowed.store(1, Ordering::Relaxed);
        None
    }

    /// The number of the pool in this place.
    pub fn at(&self, place: usize) -> Option<u64> {
        let number = self.known.get(place)?.load(Ordering::Acquire);
        (number != 0).then_some(number)
    }

    /// Tells whether the writer is gone and the reader has let go of every frame it had. Until then the
    /// frames stay as they are, unless this is dropped.
    pub fn are_back(&self) -> bool {
        self.collect();
        self.writer_left.load(Ordering::Acquire) && self.leases.get().is_none_or(|leases| leases.out() == 0)
    }

    /// Takes back frames the reader has done with; each push does so too. Any thread; never waits, and no
    /// push is in its way.
    pub fn collect(&self) {
        if let Some(leases) = self.leases.get() {
            leases.collect();
        }
    }

    /// As [`RemotePools::collect`], of a link on which nothing was sent since the last call: for a thread
    /// that looks now and then.
    pub fn collect_if_idle(&self) {
        if let Some(leases) = self.leases.get() {
            leases.collect_if_idle();
        }
    }

    /// Tells whether frames came for whose pool there is no place left: the link has to be made anew.
    pub fn has_overflowed(&self) -> bool {
        self.overflowed.load(Ordering::Relaxed) != 0
    }
}

/// State of the writer that lends frames.
pub(super) struct Lending {
    leases: Arc<Leases>,
    /// The number to look at first.
    next: usize,
    /// The lease of the frame in each place.
    places: Box<[Option<u32>]>,
    pools: Arc<RemotePools>,
}

impl Lending {
    pub(super) fn lay_out(layout: &mut Layout, places: usize, pools: &Arc<RemotePools>) -> Self {
        let leases = Arc::new(Leases::lay_out(layout));
        // Skipped while only the length is measured.
        if layout.region().is_some() {
            let _ = pools.leases.set(Arc::clone(&leases));
        }
        Self { leases, next: 0, places: vec![None; places].into(), pools: Arc::clone(pools) }
    }

    pub(super) fn leases(&self) -> &Arc<Leases> {
        &self.leases
    }

    /// The writer goes; lent frames stay lent.
    pub(super) fn leave(&self) {
        self.pools.writer_left.store(true, Ordering::Release);
    }

    /// Lends a frame; `None` when too many are out, or there is no place for its pool.
    pub(super) fn lend(&mut self, frame: Frame) -> Option<Located> {
        let (number, slot) = frame.location();
        let pool = self.pools.place_of(number)?;
        let out = self.leases.out();
        if out >= ALWAYS && !frame.pool_has_free(out.div_ceil(2)) {
            return None;
        }
        let len = frame.bytes().len() as u64;
        let lease = self.leases.lend(frame, self.next)?;
        self.next = lease as usize + 1;
        Some(Located { lease, pool, slot: u64::from(slot), len })
    }

    /// Notes the lease of a frame that was put into this place. A frame the reader took out of it before
    /// stays lent.
    pub(super) fn put(&mut self, place: usize, lease: u32) {
        self.places[place] = Some(lease);
    }

    /// Takes a place back for the writer; its sample was unseen, or the reader has it.
    pub(super) fn came_back(&mut self, place: usize, unseen: bool) {
        if let Some(lease) = self.places[place].take()
            && unseen
        {
            self.leases.end(lease);
        }
    }
}

/// Way by which samples of another process arrive.
pub(super) enum Arriving {
    Plain(PrivateCopy),
    Frames(Arc<FramePool>, Arc<RemoteViews>),
}

/// Result of a look at a sample of another process.
pub(super) enum Admitted {
    Frame(Frame),
    /// Its pool is not mapped yet.
    Later,
    /// The sample cannot be what it is said to be.
    Never,
}

impl Arriving {
    pub(super) fn plain(bytes: usize) -> Self {
        Arriving::Plain(PrivateCopy { bytes, copy: AlignedBuf::new(bytes) })
    }

    pub(super) fn frames(layout: &mut Layout, views: &Arc<RemoteViews>) -> Self {
        Arriving::Frames(FramePool::borrowed(LEASES as u32, returned(layout), views), Arc::clone(views))
    }

    /// Returns the frame of a sample, where its description can be true.
    pub(super) fn admit(pool: &Arc<FramePool>, views: &RemoteViews, content: &Content) -> Admitted {
        let Located { lease, pool: view, slot, len } = content.frame;
        if views.is_awaited(view) {
            return Admitted::Later;
        }
        let (Ok(slot), Ok(len)) = (u32::try_from(slot), usize::try_from(len)) else { return Admitted::Never };
        pool.admit(lease, view, slot, len).map_or(Admitted::Never, Admitted::Frame)
    }
}

/// A sample that the other process cannot change any more.
pub(super) struct PrivateCopy {
    bytes: usize,
    copy: AlignedBuf,
}

impl PrivateCopy {
    /// Copies a sample; returns false for one that has not the link's size.
    pub(super) fn take(&mut self, data: &[u8]) -> bool {
        if data.len() != self.bytes {
            return false;
        }
        self.copy.as_mut_slice()[..data.len()].copy_from_slice(data);
        true
    }

    pub(super) fn data(&self) -> &[u8] {
        // SAFETY: `bytes` of the block are initialised, and written only through `&mut self`.
        unsafe { std::slice::from_raw_parts(self.copy.at(0), self.bytes) }
    }
}
