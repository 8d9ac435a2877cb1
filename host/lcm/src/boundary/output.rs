//! Outputs: the slots through which samples and frames leave a component.
//!
//! Invariant: an output never waits for a reader; every write counts, read or not, so a gap at a reader is
//! the number of samples it missed.

mod pools;
mod slots;

use std::io::Write;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering, fence};
use std::sync::{Arc, Mutex, PoisonError};

use trocar_model::PortType;
use trocar_plugin_api::abi::{EXECUTED, INVALID_ARGUMENT, Outcome, UNBOUND};
use trocar_rt::cell::BindingCell;
use trocar_rt::os;
use trocar_rt::pool::Frame;
use trocar_rt::segment::Word;
use trocar_rt::stream::{Meta, StreamWriter};
use trocar_rt::wake::Waker;

use super::super::context;
use super::super::instance::{Instance, Misuse};
use super::super::pending;
use super::host_table::HostContext;
use super::input::InCell;
use super::inside::{running, runs_kept};
use super::{late, told};
use pools::Pools;
pub(super) use slots::{cancel, commit, forward, loan, reserve, type_of, write, write_bytes};

/// Most by which a stamp may be ahead of this machine's clock, ns: the translation of a device's time has
/// such an error.
const STAMP_BOUND_NS: u64 = 10_000_000;
/// Connection number of readers from outside.
pub(crate) const OUTSIDE: u64 = 0;

/// The producer's end of one connection.
pub(crate) struct OutLink {
    /// The connection, or [`OUTSIDE`].
    pub(crate) connection: u64,
    writer: StreamWriter,
    consumer: Consumer,
    /// True for a reader that only observes: it is given samples when the writer's turn ends.
    observes: bool,
}

/// The reader of a link, and the way it is told that there is something to read.
pub(crate) enum Consumer {
    /// A component of this process; and the place for the stamp of the newest sample, for connections with a
    /// `max_age`.
    Here(Arc<Instance>, Option<Arc<AtomicU64>>),
    /// A component of another process; likewise, and the place for the number of the first sample it is
    /// offered.
    Far { bell: Arc<Waker>, newest_ns: Option<Word>, first: Arc<AtomicU64> },
    /// A reader outside, which polls.
    Outside,
}

impl OutLink {
    /// `observes`: its reader only looks on, see [`trocar_model::Ports::looks_on`].
    pub(crate) fn new(connection: u64, writer: StreamWriter, consumer: Consumer, observes: bool) -> Self {
        OutLink { connection, writer, consumer, observes }
    }
}

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
    described: Arc<str>,
    links: Vec<Arc<OutLink>>,
    /// Set when the component that owned the output is gone; then its shape is unknown.
    gone: Option<Arc<HostContext>>,
}

/// Host cell behind an output slot.
pub(crate) struct OutCell {
    pub(super) outs: BindingCell<Outs>,
    /// Lets managers change it one after the other.
    editing: Mutex<()>,
    /// Source of frames.
    pools: BindingCell<Pools>,
    /// Lets pools be changed one after the other.
    pooling: Mutex<()>,
    /// Number of the last pool that was locked or whose locking failed; 0 = none.
    locked: AtomicU64,
    /// The component's inputs, whose samples may be passed on.
    inputs: BindingCell<Vec<Arc<InCell>>>,
    /// The class gave no type: the type of the first connection holds while there is one.
    untyped: bool,
    /// Writes so far.
    pub(crate) seq: AtomicU64,
    /// Bytes so far, headers included.
    pub(crate) total_bytes: AtomicU64,
    /// Refused loans so far; counted here, as pools come and go.
    exhausted: AtomicU64,
    /// For a tap: true once a reader was connected.
    pub(super) listened: AtomicBool,
}

impl OutCell {
    pub(super) fn new(ty: &PortType) -> Self {
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
            pools: BindingCell::new(Box::default()),
            pooling: Mutex::new(()),
            locked: AtomicU64::new(0),
            inputs: BindingCell::new(Box::default()),
            untyped,
            seq: AtomicU64::new(0),
            total_bytes: AtomicU64::new(0),
            exhausted: AtomicU64::new(0),
            listened: AtomicBool::new(false),
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
                    self.change_pool(None);
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
        let _one = self.editing.lock().unwrap_or_else(PoisonError::into_inner);
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

    pub(super) fn reclaim(&self) -> usize {
        self.drop_pools();
        self.outs.reclaim() + self.pools.reclaim() + self.inputs.reclaim()
    }

    /// Marks the output's component as gone. Frames that are out keep their pool.
    pub(super) fn retire(&self, gone: &Arc<HostContext>) {
        self.edit(|outs| {
            *outs = Outs {
                shape: Shape::of(&PortType::Any),
                ty: None,
                described: "".into(),
                links: Vec::new(),
                gone: Some(gone.clone()),
            };
        });
        let one = self.pooling.lock().unwrap_or_else(PoisonError::into_inner);
        self.pools.swap(Box::default());
        drop(one);
        self.know(Vec::new());
    }

    /// Sets the inputs whose samples may be passed on through this output; managers only.
    pub(super) fn know(&self, inputs: Vec<Arc<InCell>>) {
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
        running(|instance| {
            let mut said = [0; 96];
            let room = said.len();
            let mut rest = said.as_mut_slice();
            instance.described.look(|set| {
                let name = set.slots.output_of(self).map(|i| set.ports.outputs[i].name.as_str());
                // A longer text is cut.
                let _ =
                    write!(rest, "{:.3} s ahead at {}", ahead_ns as f64 / 1e9, name.unwrap_or("an output"));
            });
            let len = room - rest.len();
            instance.counters.failed(Misuse::StampedAhead, &said[..len]);
        });
    }

    /// Publishes one plain sample of the output's size.
    fn publish_plain(&self, outs: &Outs, value: &[u8], stamp_ns: u64) -> Outcome {
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
            let far = outs.links.iter().filter(|link| matches!(link.consumer, Consumer::Far { .. }));
            far.for_each(|link| link.writer.collect());
        });
    }
}

impl Outs {
    /// Publishes the state rows this thread owes before a sample tells another thread of their values. Links
    /// to observers do this themselves, when they push.
    #[inline]
    fn publish_owed(&self) {
        if !self.links.iter().all(|link| link.observes || link.is_read_here()) {
            pending::publish();
        }
    }

    /// The outcome of a write while there is no type.
    #[cold]
    fn unbound(&self) -> Outcome {
        if let Some(gone) = &self.gone {
            gone.note_late();
        }
        UNBOUND
    }

    /// Tells whether its component is gone.
    fn is_gone(&self) -> bool {
        self.gone.is_some()
    }

    #[inline]
    pub(super) fn is_unread(&self) -> bool {
        self.links.is_empty()
    }

    /// Offers the sample of a tap to every reader; zeros fill it up to the size of its samples.
    #[inline]
    pub(super) fn tell(&self, head: &[u8], body: &[u8], meta: Meta) {
        for link in &self.links {
            link.begin(meta.seq);
            link.writer.push_parts(head, body, self.shape.bytes, meta);
            link.signal(meta.came_ns);
        }
    }
}

impl OutLink {
    /// Tells whether only this very thread can take the written sample: it holds the consumer's entry lock
    /// for its cycle.
    #[inline]
    fn is_read_here(&self) -> bool {
        matches!(&self.consumer, Consumer::Here(consumer, _) if consumer.object.is_kept_here())
    }

    /// Tells whether the reader observes from another thread.
    #[inline]
    fn is_watched(&self) -> bool {
        self.observes && !self.is_read_here()
    }

    #[inline]
    fn push(&self, value: &[u8], meta: Meta) {
        if self.is_watched() {
            // SAFETY: this link stands behind the output, which was looked at in this turn, if there is one.
            if runs_kept() && unsafe { late::sample(self, value, meta) } {
                return;
            }
            pending::publish();
        }
        self.push_now(value, meta);
    }

    #[inline]
    fn push_frame(&self, mut frame: Frame, meta: Meta) {
        if self.is_watched() {
            if runs_kept() {
                // SAFETY: as in `push`.
                match unsafe { late::frame(self, frame, meta) } {
                    None => return,
                    Some(given_back) => frame = given_back,
                }
            }
            pending::publish();
        }
        self.push_frame_now(frame, meta);
    }

    /// Pushes the frame now, to any kind of reader.
    #[inline]
    pub(crate) fn push_frame_now(&self, frame: Frame, meta: Meta) {
        self.begin(meta.seq);
        self.writer.push_frame(frame, meta);
        self.signal(meta.came_ns);
    }

    #[inline]
    pub(crate) fn push_now(&self, value: &[u8], meta: Meta) {
        if self.is_read_here() {
            // SAFETY: only the thread inside the component uses its reader, and this thread has the lock for
            // that until its cycle ends: no other thread is inside meanwhile, and the next holder of the lock
            // comes after.
            unsafe { self.writer.push_here(value, meta) };
        } else {
            self.begin(meta.seq);
            self.writer.push(value, meta);
        }
        self.signal(meta.came_ns);
    }

    /// Notes the number of the first sample for another process, before that sample is counted.
    #[inline(always)]
    fn begin(&self, seq: u64) {
        if let Consumer::Far { first, .. } = &self.consumer
            && first.load(Ordering::Relaxed) == 0
        {
            first.store(seq, Ordering::Relaxed);
            // Pairs with the fence of `ServerWires::offered`: a reader that finds the sample counted finds
            // its number.
            fence(Ordering::Release);
        }
    }

    #[inline(always)]
    fn signal(&self, came_ns: u64) {
        match &self.consumer {
            Consumer::Here(consumer, None) => Self::tell_of_sample(consumer),
            _ => self.signal_with_age(came_ns),
        }
    }

    /// Signals the consumer of this link.
    #[inline(always)]
    fn tell_of_sample(consumer: &Instance) {
        if !consumer.looks_for_samples() {
            // SAFETY: as in `push`.
            unsafe { told::signal(consumer) };
        }
    }

    // Kept apart, so that the common way stays small.
    #[inline(never)]
    fn signal_with_age(&self, came_ns: u64) {
        match &self.consumer {
            Consumer::Here(consumer, newest_ns) => {
                if let Some(newest_ns) = newest_ns {
                    newest_ns.store(came_ns, Ordering::Relaxed);
                }
                Self::tell_of_sample(consumer);
            }
            Consumer::Far { bell, newest_ns, .. } => {
                if let Some(newest_ns) = newest_ns {
                    newest_ns.set(came_ns);
                }
                context::wake(bell);
            }
            Consumer::Outside => {}
        }
    }
}

impl OutCell {
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
