//! A link from one output to one input: the newest sample only, or a bounded queue; plain bytes or frames.
//!
//! The writer never waits for the reader, nor the reader for the writer. Every sample is taken or counted as
//! dropped: with nothing queued, `pushed = taken + dropped`. A slot has one owner at any time: writer, queue or
//! reader; its index moves between them by one atomic operation.

mod fifo;
mod here;
mod latest;
mod reader;
mod slots;
mod writer;

use std::sync::Arc;

pub use reader::{Sample, StreamReader};
pub use writer::{Pushed, StreamWriter};

use crate::exclusive::TryCell;
use crate::sync::{AtomicBool, AtomicU64, Ordering, Padded};
use fifo::Fifo;
use here::Here;
use latest::Latest;
use slots::Slots;

/// What the samples of a link are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payload {
    /// Up to this many bytes, copied in.
    Plain { bytes: usize },
    /// Pooled frames, passed by handle. A link keeps up to 2 (latest) or depth + 1 (fifo) of them lent, a fifo fewer where its
    /// pool would run out, see [`StreamWriter::push_frame`].
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

/// What travels beside every sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Meta {
    /// Ns of the monotonic clock.
    pub stamp_ns: u64,
    /// The output's count of samples; a gap at the reader equals what this link dropped.
    pub seq: u64,
}

/// Counters of a link, in samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamStats {
    /// Offered by the writer.
    pub pushed: u64,
    /// Seen by the reader for the first time.
    pub taken: u64,
    /// Offered and never to be seen.
    pub dropped: u64,
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
        StreamStats {
            taken: read(&reader.0.taken),
            dropped: read(&writer.0.dropped) + turned_away + read(&reader.0.skipped),
            pushed: read(&writer.0.pushed) + turned_away + read(&reader.0.pushed_here),
        }
    }
}

/// A link and its two ends.
pub fn stream_link(payload: Payload, queue: Queue) -> (StreamWriter, StreamReader) {
    let bytes = match payload {
        Payload::Plain { bytes } => bytes,
        Payload::Frame => 0,
    };
    let order = match queue {
        Queue::Latest => Order::Latest(Latest::new()),
        Queue::Fifo { depth, drop } => Order::Fifo(Fifo::new(depth.max(1), drop)),
    };
    let slots = match &order {
        Order::Latest(_) => latest::SLOTS + here::SLOTS,
        Order::Fifo(fifo) => fifo.slots(),
    };
    let link = Arc::new(Link {
        payload,
        slots: Slots::new(slots, bytes),
        order,
        here: Here::new(),
        reader_left: AtomicBool::new(false),
        writer_left: AtomicBool::new(false),
        counters: Arc::new(Counters::new()),
    });
    let writing = match &link.order {
        Order::Latest(_) => writer::End::Latest { back: latest::WRITERS },
        Order::Fifo(fifo) => writer::End::Fifo(fifo.writing()),
    };
    (StreamWriter { link: Arc::clone(&link), end: TryCell::new(writing) }, StreamReader::new(link))
}

/// What both ends share.
struct Link {
    payload: Payload,
    slots: Slots,
    order: Order,
    /// Of a latest link.
    here: Here,
    reader_left: AtomicBool,
    writer_left: AtomicBool,
    counters: Arc<Counters>,
}

#[expect(
    clippy::large_enum_variant,
    reason = "one per link, behind its Arc; a box would cost a hop per sample"
)]
enum Order {
    Latest(Latest),
    Fifo(Fifo),
}

/// Each end writes its own line.
struct Counters {
    writer: Padded<WriterCounts>,
    reader: Padded<ReaderCounts>,
}

struct WriterCounts {
    pushed: AtomicU64,
    dropped: AtomicU64,
    /// Pushed by whoever could not come in, and dropped.
    turned_away: AtomicU64,
}

struct ReaderCounts {
    taken: AtomicU64,
    skipped: AtomicU64,
    /// Pushed by the thread that reads.
    pushed_here: AtomicU64,
}

impl Counters {
    fn new() -> Self {
        let zero = || AtomicU64::new(0);
        Self {
            writer: Padded(WriterCounts { pushed: zero(), dropped: zero(), turned_away: zero() }),
            reader: Padded(ReaderCounts { taken: zero(), skipped: zero(), pushed_here: zero() }),
        }
    }
}

/// Counts where several may count at the same moment.
fn count(counter: &AtomicU64, n: u64) {
    counter.fetch_add(n, Ordering::Relaxed);
}

/// Counts where only one end, or whoever is inside it, ever counts.
#[inline]
fn tally(counter: &AtomicU64, n: u64) {
    counter.store(counter.load(Ordering::Relaxed) + n, Ordering::Relaxed);
}
