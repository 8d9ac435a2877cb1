//! A link from one output to one input: the newest sample only, or a bounded queue; plain bytes or frames.
//!
//! The writer never waits for the reader, nor the reader for the writer. Every sample is taken or counted as
//! dropped: with nothing queued, `pushed = taken + dropped`. A slot has one owner at any time: writer, queue
//! or reader; its index moves between them by one atomic operation.

mod fifo;
mod here;
mod latest;
mod leases;
mod reader;
mod remote;
mod slots;
mod writer;

use std::sync::Arc;

pub use reader::{Sample, StreamReader};
pub use remote::{POOLS_PER_LINK, RemotePools};
pub use writer::{Pushed, StreamWriter};

pub use crate::pool::RemoteViews;

use crate::region::{Layout, Place, Plain, told};
use crate::sync::{AtomicU32, AtomicU64, Ordering, Padded};
use fifo::Fifo;
use here::Here;
use latest::Latest;
use remote::{Arriving, Lending};
use slots::Slots;

/// Kind of the samples of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payload {
    /// Up to this many bytes, copied in.
    Plain { bytes: usize },
    /// Pooled frames, passed by handle. A link keeps up to 2 (latest) or depth + 1 (fifo) of them lent, a
    /// fifo fewer where its pool would run out, see [`StreamWriter::push_frame`].
    Frame,
}

/// Which samples a link keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Queue {
    /// The newest.
    Latest,
    /// Up to `depth` (at least 1) in order.
    Fifo { depth: usize, drop: DropPolicy },
}

/// Which sample a full queue gives up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DropPolicy {
    DropOldest,
    DropNewest,
}

/// Data that travels beside every sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Meta {
    /// Ns of the monotonic clock.
    pub stamp_ns: u64,
    /// Time it was written, or its stamp where that is earlier: no sample is younger. Of the same clock, ns.
    pub came_ns: u64,
    /// The output's count of samples; a gap at the reader equals what this link dropped.
    pub seq: u64,
}

/// Counters of a link, in samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamStats {
    /// Offered by the writer.
    pub pushed: u64,
    /// Samples the reader has seen, each counted once.
    pub taken: u64,
    /// Offered and never to be seen.
    pub dropped: u64,
    /// Part of the dropped ones whose place a newer one took, where only the newest is kept or looked at.
    pub skipped: u64,
}

/// A handle to a link's counters, for any thread; it does not keep the link's samples.
#[derive(Clone)]
pub struct StreamCounters(Arc<Counters>);

impl StreamCounters {
    /// Each counter is exact, together they are of nearly one moment.
    pub fn stats(&self) -> StreamStats {
        let read = |a: &AtomicU64| a.load(Ordering::Relaxed);
        let Counters { writer, reader } = &*self.0;
        let turned_away = read(&writer.0.turned_away);
        let skipped = [read(&writer.0.passed_over), read(&reader.0.skipped)];
        StreamStats {
            taken: sum([read(&reader.0.taken)]),
            dropped: sum([read(&writer.0.dropped), turned_away, skipped[0], skipped[1]]),
            skipped: sum(skipped),
            pushed: sum([read(&writer.0.pushed), turned_away, read(&reader.0.pushed_here)]),
        }
    }
}

/// A link and its two ends, both in this process.
pub fn stream_link(payload: Payload, queue: Queue) -> (StreamWriter, StreamReader) {
    let counters = Layout::on_heap(Counters::lay_out);
    let link = Layout::on_heap(|layout| Link::lay_out(layout, payload, queue, Some(&counters)));
    let link = Arc::new(link);
    (StreamWriter::new(Arc::clone(&link), None), StreamReader::new(link, None))
}

/// Makes the output's end of a link whose other end is in another process; the parts are what
/// [`remote_reader`] lays out.
pub fn remote_writer(
    layout: &mut Layout,
    payload: Payload,
    queue: Queue,
    pools: &Arc<RemotePools>,
) -> StreamWriter {
    let link = Link::lay_out(layout, payload, queue, None);
    let lending = (payload == Payload::Frame).then(|| Lending::lay_out(layout, link.places(), pools));
    StreamWriter::new(Arc::new(link), lending)
}

/// The input's end of a link whose other end is in another process.
pub fn remote_reader(
    layout: &mut Layout,
    payload: Payload,
    queue: Queue,
    views: &Arc<RemoteViews>,
) -> StreamReader {
    let link = Link::lay_out(layout, payload, queue, None);
    let arriving = match payload {
        Payload::Plain { bytes } => Arriving::plain(bytes),
        Payload::Frame => Arriving::frames(layout, views),
    };
    StreamReader::new(Arc::new(link), Some(arriving))
}

/// State both ends share.
struct Link {
    payload: Payload,
    slots: Slots,
    order: Order,
    /// Places of a latest link whose samples stay on their thread.
    here: Here,
    /// Which ends are gone, a word each.
    reader_left: Place<AtomicU32>,
    writer_left: Place<AtomicU32>,
    counters: Arc<Counters>,
}

enum Order {
    Latest(Latest),
    Fifo(Fifo),
}

impl Link {
    /// Lays the link out, with counters of its own where none are given.
    fn lay_out(
        layout: &mut Layout,
        payload: Payload,
        queue: Queue,
        counters: Option<&Arc<Counters>>,
    ) -> Link {
        let bytes = match payload {
            Payload::Plain { bytes } => bytes,
            Payload::Frame => 0,
        };
        let order = match queue {
            Queue::Latest => Order::Latest(Latest::lay_out(layout)),
            Queue::Fifo { depth, drop } => Order::Fifo(Fifo::lay_out(layout, depth.max(1), drop)),
        };
        let slots = match &order {
            Order::Latest(_) => latest::SLOTS + here::SLOTS,
            Order::Fifo(fifo) => fifo.slots(),
        };
        Link {
            payload,
            slots: Slots::lay_out(layout, slots, bytes, payload == Payload::Frame),
            order,
            here: Here::new(),
            reader_left: layout.place(|| AtomicU32::new(0)),
            writer_left: layout.place(|| AtomicU32::new(0)),
            counters: counters.cloned().unwrap_or_else(|| Counters::lay_out(layout)),
        }
    }

    fn places(&self) -> usize {
        match &self.order {
            Order::Latest(_) => latest::SLOTS + here::SLOTS,
            Order::Fifo(fifo) => fifo.slots(),
        }
    }
}

/// Each end writes its own line.
struct Counters {
    writer: Place<Padded<WriterCounts>>,
    reader: Place<Padded<ReaderCounts>>,
}

#[repr(C)]
struct WriterCounts {
    pushed: AtomicU64,
    dropped: AtomicU64,
    /// Pushed by a thread that could not come in, and dropped.
    turned_away: AtomicU64,
    /// Unseen when the next one came, where only the newest is kept.
    passed_over: AtomicU64,
}

// SAFETY: atomic numbers.
unsafe impl Plain for WriterCounts {}

#[repr(C)]
struct ReaderCounts {
    taken: AtomicU64,
    skipped: AtomicU64,
    /// Pushed by the thread that reads.
    pushed_here: AtomicU64,
}

// SAFETY: atomic numbers.
unsafe impl Plain for ReaderCounts {}

impl Counters {
    fn lay_out(layout: &mut Layout) -> Arc<Self> {
        let zero = || AtomicU64::new(0);
        let writer = || {
            let [pushed, dropped, turned_away, passed_over] = std::array::from_fn(|_| zero());
            Padded(WriterCounts { pushed, dropped, turned_away, passed_over })
        };
        let reader = || Padded(ReaderCounts { taken: zero(), skipped: zero(), pushed_here: zero() });
        Arc::new(Self { writer: layout.place(writer), reader: layout.place(reader) })
    }
}

/// Sums counts of memory where another process may have written anything.
fn sum<const N: usize>(counts: [u64; N]) -> u64 {
    told(counts.into_iter().fold(0, u64::wrapping_add))
}

/// Counts where several threads may count at the same moment.
fn count(counter: &AtomicU64, n: u64) {
    counter.fetch_add(n, Ordering::Relaxed);
}

/// Counts where only one end, or the thread inside it, ever counts.
#[inline]
fn tally(counter: &AtomicU64, n: u64) {
    counter.store(counter.load(Ordering::Relaxed).wrapping_add(n), Ordering::Relaxed);
}
