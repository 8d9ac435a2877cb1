//! The memory two processes share for one connection: the parts of a link behind each other in one block, the
//! same on both ends.
//!
//! Invariant: both ends lay out the same parts from numbers they agreed on before; the header only shows that
//! they did.

use std::io;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::sync::Arc;

use crate::mailbox::Mailbox;
use crate::region::{Layout, Place, Region, Table};
use crate::reply::ReplyPool;
use crate::state::{StateReader, StateWriter, remote_state_reader, remote_state_writer};
use crate::stream::{
    Payload, Queue, RemotePools, RemoteViews, StreamReader, StreamWriter, remote_reader, remote_writer,
};
use crate::sync::{AtomicU64, Ordering};
use crate::wake::Waker;

/// "trocarLK" of the first word.
const MAGIC: u64 = u64::from_le_bytes(*b"trocarLK");
/// Version of the order of the parts; both ends must have the same.
pub const LAYOUT: u32 = 3;
/// Rows of the table behind a read: its reader is never lapped by less than three publications.
const READ_ROWS: usize = 4;

/// Numbers both ends agreed on before there was memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Agreed {
    /// Hash of the types that pass.
    pub hash: u64,
    /// Number of this link: no two links, also of one connection, have the same.
    pub epoch: u64,
}

/// A number one end writes and the other one reads.
pub struct Word(Place<AtomicU64>);

impl Word {
    fn lay_out(layout: &mut Layout) -> Self {
        Word(layout.place(|| AtomicU64::new(0)))
    }

    #[inline]
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::SeqCst)
    }

    #[inline]
    pub fn set(&self, value: u64) {
        self.0.store(value, Ordering::SeqCst);
    }
}

/// Sizes of a connection of two interfaces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CallShape {
    /// Commands or events that may wait.
    pub depth: usize,
    pub commands: usize,
    /// The longest argument.
    pub arg_bytes: usize,
    pub reply_cells: usize,
    /// The longest result of a command.
    pub ret_bytes: usize,
    /// The longest sentence with it.
    pub text_bytes: usize,
    /// The longest payload of an event.
    pub event_bytes: usize,
    /// Bytes of the result of each read the server publishes.
    pub reads: Vec<usize>,
    /// Reads the client works out itself from the server's rows ([`Rows`]).
    pub own_reads: usize,
}

/// A connection of two interfaces; `R` is the object behind its reads at this end.
pub struct Calls<R> {
    /// The client pushes, the server drains.
    pub commands: Mailbox,
    pub replies: Arc<ReplyPool>,
    /// The server pushes, the client drains.
    pub events: Mailbox,
    pub reads: Vec<R>,
    /// Text of each failed read.
    pub whys: Vec<R>,
    /// Place in the server's description of each read the client works out itself, as the server tells it: 0
    /// nowhere, else its number and one.
    pub own_reads: Vec<Word>,
    /// State of the server, as it tells it.
    pub server: Word,
    /// Rung by the client.
    pub for_server: Arc<Waker>,
    /// Rung by the server.
    pub for_client: Arc<Waker>,
    region: Option<Arc<Region>>,
}

impl<R> Calls<R> {
    fn lay_out(
        layout: &mut Layout,
        shape: &CallShape,
        agreed: Agreed,
        read: impl Fn(&mut Layout, usize, usize) -> R,
    ) -> Self {
        let _header = header(layout, agreed);
        Calls {
            commands: Mailbox::lay_out(layout, shape.depth, shape.arg_bytes, shape.commands),
            replies: ReplyPool::lay_out(layout, shape.reply_cells, shape.ret_bytes, shape.text_bytes),
            events: Mailbox::lay_out(layout, shape.depth, shape.event_bytes, 0),
            reads: shape.reads.iter().map(|bytes| read(layout, *bytes, READ_ROWS)).collect(),
            whys: shape.reads.iter().map(|_| read(layout, shape.text_bytes, READ_ROWS)).collect(),
            own_reads: (0..shape.own_reads).map(|_| Word::lay_out(layout)).collect(),
            server: Word::lay_out(layout),
            for_server: Arc::new(Waker::lay_out(layout)),
            for_client: Arc::new(Waker::lay_out(layout)),
            region: layout.region(),
        }
    }

    /// The memory both ends share, for the other one.
    pub fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.region.as_ref().and_then(|region| region.fd())
    }
}

/// The server's end.
pub type ServedCalls = Calls<StateWriter>;
/// The client's end.
pub type RemoteCalls = Calls<StateReader>;

impl ServedCalls {
    /// Memory for a connection of these sizes.
    ///
    /// # Errors
    /// The machine has not that much.
    pub fn create(shape: &CallShape, agreed: Agreed) -> io::Result<Self> {
        let parts = |layout: &mut Layout| Self::lay_out(layout, shape, agreed, remote_state_writer);
        Ok(parts(&mut Layout::fresh(&Region::shared(Layout::measure(parts))?)))
    }
}

impl RemoteCalls {
    /// The memory the server made for a connection of these sizes.
    ///
    /// # Errors
    /// It is not that.
    pub fn open(fd: OwnedFd, shape: &CallShape, agreed: Agreed) -> io::Result<Self> {
        open(fd, |layout| Self::lay_out(layout, shape, agreed, remote_state_reader), agreed)
    }
}

/// The state rows of one component for all other processes. Only its own process writes them, which is why
/// they are memory of their own. `E` is this end.
pub struct Rows<E> {
    pub end: E,
    region: Option<Arc<Region>>,
}

impl<E> Rows<E> {
    fn lay_out(layout: &mut Layout, agreed: Agreed, end: impl FnOnce(&mut Layout) -> E) -> Self {
        let _header = header(layout, agreed);
        Rows { end: end(layout), region: layout.region() }
    }
}

impl Rows<StateWriter> {
    /// Memory for rows of so many bytes.
    ///
    /// # Errors
    /// The machine has not that much.
    pub fn create(row_bytes: usize, agreed: Agreed) -> io::Result<Self> {
        let end = |layout: &mut Layout| remote_state_writer(layout, row_bytes, READ_ROWS);
        let parts = |layout: &mut Layout| Self::lay_out(layout, agreed, end);
        Ok(parts(&mut Layout::fresh(&Region::shown(Layout::measure(parts))?)))
    }

    /// The memory, for other processes to look at.
    pub fn region(&self) -> Option<Arc<Region>> {
        self.region.clone()
    }
}

impl Rows<StateReader> {
    /// The memory a component's process made for rows of so many bytes.
    ///
    /// # Errors
    /// It is not that.
    pub fn open(fd: OwnedFd, row_bytes: usize, agreed: Agreed) -> io::Result<Self> {
        let end = |layout: &mut Layout| remote_state_reader(layout, row_bytes, READ_ROWS);
        let parts = |layout: &mut Layout| Self::lay_out(layout, agreed, end);
        let region = Region::look(fd, Layout::measure(parts))?;
        laid_out(&region, parts, agreed)
    }
}

/// Payload of a stream, and its queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamShape {
    pub payload: Payload,
    pub queue: Queue,
}

/// A stream; `E` is this end of it.
pub struct Stream<E> {
    pub end: E,
    /// Stamp of the newest sample, ns, as the writer says.
    pub newest_ns: Word,
    /// Rung by the writer.
    pub for_reader: Arc<Waker>,
    region: Option<Arc<Region>>,
}

impl<E> Stream<E> {
    fn lay_out(layout: &mut Layout, agreed: Agreed, end: impl FnOnce(&mut Layout) -> E) -> Self {
        let _header = header(layout, agreed);
        Stream {
            end: end(layout),
            newest_ns: Word::lay_out(layout),
            for_reader: Arc::new(Waker::lay_out(layout)),
            region: layout.region(),
        }
    }

    /// The memory both ends share, for the other one.
    pub fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.region.as_ref().and_then(|region| region.fd())
    }
}

impl Stream<StreamWriter> {
    /// Makes the memory for a stream; `pools` are those the reader is told of.
    ///
    /// # Errors
    /// The machine has not that much.
    pub fn create(shape: StreamShape, agreed: Agreed, pools: &Arc<RemotePools>) -> io::Result<Self> {
        let end = |layout: &mut Layout| remote_writer(layout, shape.payload, shape.queue, pools);
        let parts = |layout: &mut Layout| Self::lay_out(layout, agreed, end);
        Ok(parts(&mut Layout::fresh(&Region::shared(Layout::measure(parts))?)))
    }
}

impl Stream<StreamReader> {
    /// The memory the writer made; `views` are the pools this end was told of.
    ///
    /// # Errors
    /// It is not that.
    pub fn open(
        fd: OwnedFd,
        shape: StreamShape,
        agreed: Agreed,
        views: &Arc<RemoteViews>,
    ) -> io::Result<Self> {
        let end = |layout: &mut Layout| remote_reader(layout, shape.payload, shape.queue, views);
        open(fd, |layout| Self::lay_out(layout, agreed, end), agreed)
    }
}

fn header(layout: &mut Layout, agreed: Agreed) -> Table<AtomicU64> {
    let words = words(agreed);
    layout.table(words.len(), |i| AtomicU64::new(words[i]))
}

fn words(agreed: Agreed) -> [u64; 4] {
    [MAGIC, u64::from(LAYOUT), agreed.hash, agreed.epoch]
}

fn open<T>(fd: OwnedFd, parts: impl Fn(&mut Layout) -> T, agreed: Agreed) -> io::Result<T> {
    let region = Region::open(fd, Layout::measure(&parts))?;
    laid_out(&region, parts, agreed)
}

fn laid_out<T>(region: &Arc<Region>, parts: impl Fn(&mut Layout) -> T, agreed: Agreed) -> io::Result<T> {
    let said = header(&mut Layout::of_other_end(region), agreed);
    let what = ["its first word", "the version of its layout", "the hash of its types", "its epoch"];
    for (what, (said, agreed)) in what.iter().zip(said.iter().zip(words(agreed))) {
        let said = said.load(Ordering::Relaxed);
        if said != agreed {
            let why = format!("{what} is {said:#x}, agreed was {agreed:#x}");
            return Err(io::Error::new(io::ErrorKind::InvalidData, why));
        }
    }
    Ok(parts(&mut Layout::of_other_end(region)))
}
