//! The host's cell behind an output slot: its type, its links, its counts.
//!
//! Invariant: every write counts, read or not; state rows this thread owes are published before a sample
//! tells another thread of their values.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use parking_lot::Mutex;
use trocar_model::PortType;
use trocar_plugin_api::abi::{EXECUTED, INVALID_ARGUMENT, Outcome, UNBOUND};
use trocar_rt::cell::BindingCell;
use trocar_rt::os::{self, OsError};
use trocar_rt::pool::{Frame, FramePool, PoolFile};
use trocar_rt::stream::Meta;

use super::super::super::books::Misuse;
use super::super::super::{context, pending};
use super::super::host_table::HostContext;
use super::super::input::{InCell, Shown};
use super::super::inside::running;
use super::link::{OUTSIDE, OutLink};
use super::pools::Pools;

/// Most by which a stamp may be ahead of this machine's clock, ns: the translation of a device's time has
/// such an error.
const STAMP_BOUND_NS: u64 = 10_000_000;

/// Memory layout of an output's samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shape {
    /// Bytes of a plain sample or of a frame's header.
    pub(crate) bytes: usize,
    pub(crate) frame: bool,
    /// An untyped output without a type yet.
    pub(crate) unknown: bool,
}

impl Shape {
    pub(crate) fn of(ty: &PortType) -> Shape {
        match ty {
            PortType::Plain(t) => Shape { bytes: t.size(), frame: false, unknown: false },
            PortType::Frame { header, .. } => Shape { bytes: header.size(), frame: true, unknown: false },
            PortType::Any => Shape { bytes: 0, frame: false, unknown: true },
        }
    }
}

/// Present type and links of an output.
pub(crate) struct Outs {
    pub(crate) shape: Shape,
    /// The type of the samples; `None` for an untyped output that is not connected.
    ty: Option<PortType>,
    /// The same as manifest JSON, empty while unconnected.
    pub(super) described: Arc<str>,
    links: Vec<Arc<OutLink>>,
    /// Set when the component that owned the output is gone; then its shape is unknown.
    gone: Option<Arc<HostContext>>,
}

/// Host cell behind an output slot.
pub(crate) struct OutCell {
    pub(crate) outs: BindingCell<Outs>,
    /// Lets managers change it one after the other.
    editing: Mutex<()>,
    /// Source of frames.
    pub(super) pools: Pools,
    /// The component's inputs, whose samples may be passed on.
    pub(super) inputs: BindingCell<Vec<Arc<InCell>>>,
    /// The class gave no type: the type of the first connection holds while there is one.
    untyped: bool,
    /// Writes so far.
    pub(crate) seq: AtomicU64,
    /// Bytes so far, headers included.
    pub(crate) total_bytes: AtomicU64,
    /// For a tap: true once a reader was connected.
    listened: Arc<AtomicBool>,
    /// Its name, for what is told of it.
    name: Box<str>,
}

impl OutCell {
    pub(crate) fn new(name: &str, ty: &PortType) -> Self {
        let untyped = *ty == PortType::Any;
        let outs = Outs {
            shape: Shape::of(ty),
            ty: (!untyped).then(|| ty.clone()),
            described: "".into(),
            links: Vec::new(),
            gone: None,
        };
        OutCell {
            outs: BindingCell::new(Box::new(outs)),
            editing: Mutex::new(()),
            pools: Pools::default(),
            inputs: BindingCell::new(Box::default()),
            untyped,
            seq: AtomicU64::new(0),
            total_bytes: AtomicU64::new(0),
            listened: Arc::default(),
            name: name.into(),
        }
    }

    /// The type it has now, if any.
    pub(crate) fn shape(&self) -> Shape {
        self.outs.enter().shape
    }

    /// The type of the samples now; an untyped output has one as long as it is connected.
    pub(crate) fn passing(&self) -> Option<PortType> {
        self.outs.enter().ty.clone()
    }

    /// Adds a link whose samples have the given type; managers only.
    pub(crate) fn add(&self, link: Arc<OutLink>, ty: &PortType, described: &Arc<str>) {
        self.listened.store(true, Ordering::Relaxed);
        self.edit(|outs| {
            if link.connection != OUTSIDE {
                outs.described = described.clone();
            }
            outs.links.push(link);
            if self.untyped && outs.shape.unknown {
                outs.shape = Shape::of(ty);
                outs.ty = Some(ty.clone());
            }
        });
    }

    /// Removes links; managers only. An untyped output without connections has no type again.
    pub(crate) fn remove(&self, gone: impl Fn(&Arc<OutLink>) -> bool) {
        self.edit(|outs| {
            outs.links.retain(|l| !gone(l));
            if outs.links.iter().all(|l| l.connection == OUTSIDE) {
                outs.described = "".into();
                if self.untyped {
                    // A remaining reader from outside asked for the type that went.
                    outs.links.clear();
                    outs.shape = Shape::of(&PortType::Any);
                    outs.ty = None;
                    self.pools.change(None);
                }
            }
        });
    }

    /// Tells whether the output still writes to this link.
    pub(crate) fn has(&self, link: &Arc<OutLink>) -> bool {
        self.outs.enter().links.iter().any(|l| Arc::ptr_eq(l, link))
    }

    #[cfg(test)]
    pub(crate) fn readers(&self) -> usize {
        self.outs.enter().links.len()
    }

    fn edit(&self, f: impl FnOnce(&mut Outs)) {
        let _one = self.editing.lock();
        let now = self.outs.enter();
        let mut outs = Outs {
            shape: now.shape,
            ty: now.ty.clone(),
            described: now.described.clone(),
            links: now.links.clone(),
            gone: now.gone.clone(),
        };
        drop(now);
        f(&mut outs);
        self.outs.swap(Box::new(outs));
    }

    pub(crate) fn reclaim(&self) -> usize {
        self.outs.reclaim() + self.pools.reclaim() + self.inputs.reclaim()
    }

    /// (Re)makes the pool; not from `step`.
    ///
    /// # Errors
    /// There is no memory for it.
    pub(crate) fn make_pool(&self, max_bytes: usize, slots: u32) -> io::Result<()> {
        let pool = FramePool::new(slots, self.shape().bytes, max_bytes)?;
        self.pools.change(Some(pool));
        Ok(())
    }

    /// Warns the component whose code runs here, and whose output this is, that it got no pool.
    pub(super) fn tell_refused(&self, asked: &str) {
        let owner = running(|core| core.component()).flatten();
        match owner {
            Some(owner) => owner.warn(&format!("{}: {asked}", self.name)),
            None => log::error!("{asked}"),
        }
    }

    /// The memory of all its pools, for readers in another process.
    pub(crate) fn pool_files(&self) -> Vec<Arc<PoolFile>> {
        self.pools.files()
    }

    /// Locks the lending pool into memory, once; returns the reason of a failure. Managers only.
    pub(crate) fn lock_pool(&self) -> Option<OsError> {
        self.pools.lock()
    }

    /// Figures of the pool that lends now; `None` without a pool.
    #[cfg(test)]
    pub(crate) fn pool(&self) -> Option<trocar_rt::PoolStats> {
        self.pools.stats()
    }

    /// Loans that were refused, over all pools.
    pub(crate) fn exhausted(&self) -> u64 {
        self.pools.exhausted()
    }

    /// True once a reader was connected; for its tap.
    pub(crate) fn listened(&self) -> &Arc<AtomicBool> {
        &self.listened
    }

    /// Marks the output's component as gone. Frames that are out keep their pool.
    pub(crate) fn retire(&self, gone: &Arc<HostContext>) {
        self.edit(|outs| {
            *outs = Outs {
                shape: Shape::of(&PortType::Any),
                ty: None,
                described: "".into(),
                links: Vec::new(),
                gone: Some(gone.clone()),
            };
        });
        self.pools.retire();
        self.know(Vec::new());
    }

    /// Sets the inputs whose samples may be passed on through this output; managers only.
    pub(crate) fn know(&self, inputs: Vec<Arc<InCell>>) {
        self.inputs.swap(Box::new(inputs));
    }

    /// Bytes of so many of its samples: for frames, which have any length, by the mean of all that were
    /// written.
    pub(crate) fn bytes_of(&self, samples: u64, shape: Shape) -> u64 {
        if !shape.frame {
            return samples.saturating_mul(shape.bytes as u64);
        }
        let written = self.seq.load(Ordering::Relaxed).max(1);
        let total = self.total_bytes.load(Ordering::Relaxed);
        (total as f64 / written as f64 * samples as f64) as u64
    }

    fn next_meta(&self, stamp_ns: u64, bytes: usize) -> Meta {
        let seq = self.seq.load(Ordering::Relaxed) + 1;
        self.seq.store(seq, Ordering::Relaxed);
        self.total_bytes.store(self.total_bytes.load(Ordering::Relaxed) + bytes as u64, Ordering::Relaxed);
        let (stamp_ns, came_ns) = match stamp_ns {
            0 => {
                let now_ns = os::now_ns();
                (now_ns, now_ns)
            }
            past if past <= context::about_now_ns() => (past, past),
            // The stamp is of this step, or ahead: a sample stamped ahead of time is as old as its arrival.
            late => {
                let now_ns = os::now_ns();
                if late > now_ns.saturating_add(STAMP_BOUND_NS) {
                    self.note_ahead(late - now_ns);
                }
                (late, late.min(now_ns))
            }
        };
        Meta { stamp_ns, came_ns, seq }
    }

    /// Counts a sample with a stamp in the future; real-time.
    #[cold]
    #[inline(never)]
    fn note_ahead(&self, ahead_ns: u64) {
        let mut said = [0; 96];
        let room = said.len();
        let mut rest = said.as_mut_slice();
        // A longer text is cut.
        let _ = write!(rest, "{:.3} s ahead at {}", ahead_ns as f64 / 1e9, self.name);
        let len = room - rest.len();
        running(|core| core.books.failed(Misuse::StampedAhead, &said[..len]));
    }

    /// Publishes one plain sample of the output's size.
    pub(super) fn publish_plain(&self, outs: &Outs, value: &[u8], stamp_ns: u64) -> Outcome {
        if outs.links.is_empty() {
            self.count_unread(value.len());
            return UNBOUND;
        }
        outs.publish_owed();
        let meta = self.next_meta(stamp_ns, value.len());
        for link in &outs.links {
            link.push(value, meta);
        }
        EXECUTED
    }

    fn publish(&self, outs: &Outs, frame: Frame, stamp_ns: u64) -> Outcome {
        let bytes = outs.shape.bytes + frame.bytes().len();
        let Some((last, others)) = outs.links.split_last() else {
            self.count_unread(bytes);
            return UNBOUND;
        };
        outs.publish_owed();
        let meta = self.next_meta(stamp_ns, bytes);
        for link in others {
            link.push_frame(frame.clone(), meta);
        }
        // The last link gets the handle itself, so that a single reader is the frame's only owner.
        last.push_frame(frame, meta);
        EXECUTED
    }

    /// Counts a write without readers as a write: the next reader sees how many went before.
    fn count_unread(&self, bytes: usize) {
        let _ = self.next_meta(1, bytes);
    }
}

impl OutCell {
    /// Takes back frames that readers in other processes have released.
    #[cold]
    pub(crate) fn collect(&self) {
        self.outs.look(|outs| {
            outs.links.iter().for_each(|link| link.collect());
        });
    }
}

impl Outs {
    /// Publishes the state rows this thread owes before a sample tells another thread of their values. Links
    /// to observers do this themselves, when they push.
    #[inline]
    fn publish_owed(&self) {
        if !self.links.iter().all(|link| link.observes() || link.is_read_here()) {
            pending::publish();
        }
    }

    /// The outcome of a write while there is no type.
    #[cold]
    pub(super) fn unbound(&self) -> Outcome {
        if let Some(gone) = &self.gone {
            gone.note_late();
        }
        UNBOUND
    }

    /// Tells whether its component is gone.
    pub(super) fn is_gone(&self) -> bool {
        self.gone.is_some()
    }

    #[inline]
    pub(crate) fn is_unread(&self) -> bool {
        self.links.is_empty()
    }

    /// Offers the sample of a tap to every reader; zeros fill it up to the size of its samples.
    #[inline]
    pub(crate) fn tell(&self, head: &[u8], body: &[u8], meta: Meta) {
        for link in &self.links {
            link.push_parts(head, body, self.shape.bytes, meta);
        }
    }
}

impl OutCell {
    /// Publishes a sample that an input shows, a frame without a copy.
    pub(crate) fn forward(&self, shown: Shown<'_>, stamp_ns: u64) -> Outcome {
        match shown {
            Shown::Frame(frame) => self.forward_frame(frame, stamp_ns),
            Shown::Plain(value) => self.forward_plain(value, stamp_ns),
            Shown::Nothing => INVALID_ARGUMENT,
        }
    }

    /// Publishes a frame that some input holds; its header must be the output's.
    pub(super) fn forward_frame(&self, frame: Frame, stamp_ns: u64) -> Outcome {
        self.outs.look(|outs| match &outs.shape {
            shape if shape.unknown => outs.unbound(),
            shape if shape.frame && frame.header().len() == shape.bytes => {
                self.publish(outs, frame, stamp_ns)
            }
            _ => INVALID_ARGUMENT,
        })
    }

    /// Publishes a plain sample that some input holds.
    pub(super) fn forward_plain(&self, value: &[u8], stamp_ns: u64) -> Outcome {
        self.outs.look(|outs| match &outs.shape {
            shape if shape.unknown => outs.unbound(),
            shape if !shape.frame && value.len() == shape.bytes => self.publish_plain(outs, value, stamp_ns),
            _ => INVALID_ARGUMENT,
        })
    }
}
