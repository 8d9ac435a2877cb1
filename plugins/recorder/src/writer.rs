//! The thread that writes: blocks become an MCAP file, closed properly whatever happens to the disk.
//!
//! Invariant: nothing is handed to the file for which, with everything that has to come behind it, there is no room; what was
//! taken is in the file at most [`FLUSH`] later.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{McapError, WriteOptions};

use crate::block::{Block, Head, Kind, Returns};
use crate::compress;
use crate::orders::{Channel, Codec, News, Opening, Order, Written};
use crate::room::Room;
use crate::sink::{Sink, Word};

/// A message is in the file after so long.
const FLUSH: Duration = Duration::from_millis(10);
/// Without anything to flush it looks up so often.
const IDLE: Duration = Duration::from_millis(50);
/// A chunk is closed when it holds so many bytes.
const CHUNK: u64 = 64 << 10;
/// What the end of a file takes beside its indexes, bytes: statistics, offsets, footer, what is lost.
const TAIL: u64 = 128 << 10;
/// Of a message in a chunk beside its bytes: record, index entry.
const PER_MESSAGE: u64 = 64;
/// Of a chunk: its record and index in the data, its index in the summary.
const PER_CHUNK: u64 = 512;
/// Of a channel: per chunk in index and summary.
const PER_CHANNEL: u64 = 48;

/// Why a recording ends that finds no more room.
pub(crate) const FULL: &str = "the disk is full: there is room for the end of the file alone";

/// The writer's thread, from begin to end.
pub(crate) struct Writer {
    returns: Returns,
    news: Sender<News>,
    channels: Vec<Channel>,
    metadata: Vec<(String, BTreeMap<String, String>)>,
    lost: Vec<(String, u64)>,
    /// Held from before a recording, oldest first.
    held: VecDeque<Block>,
    held_bytes: u64,
    /// How long and how much is held.
    hold_ns: u64,
    hold_bytes: u64,
    file: Option<OpenFile>,
}

struct OpenFile {
    mcap: mcap::Writer<NoSeek<Sink>>,
    path: PathBuf,
    written: Arc<Written>,
    codec: Codec,
    room: Room,
    word: Arc<Word>,
    /// The file's number of each channel of ours.
    ids: Vec<u16>,
    messages: u64,
    /// Messages that could not be compressed, per channel.
    spoiled: BTreeMap<u32, u64>,
    /// In the chunk that is open.
    pending: u64,
    /// When the first of what may not be in the file yet was taken.
    pending_since: Option<Instant>,
    /// What the summary will take.
    summary: u64,
    scratch: Vec<u8>,
}

/// Why a file ends before anybody asked for it.
enum Broken {
    Full,
    Other(String),
}

impl From<McapError> for Broken {
    fn from(why: McapError) -> Broken {
        Broken::Other(why.to_string())
    }
}

impl From<io::Error> for Broken {
    fn from(why: io::Error) -> Broken {
        Broken::Other(why.to_string())
    }
}

impl Writer {
    pub(crate) fn new(returns: Returns, news: Sender<News>, (hold_ns, hold_bytes): (u64, u64)) -> Writer {
        Writer {
            returns,
            news,
            channels: Vec::new(),
            metadata: Vec::new(),
            lost: Vec::new(),
            held: VecDeque::new(),
            held_bytes: 0,
            hold_ns,
            hold_bytes,
            file: None,
        }
    }

    /// Until the step's end is gone; what is open then is closed. `every` is called about ten times a second.
    pub(crate) fn run(mut self, orders: &Receiver<Order>, mut every: impl FnMut()) {
        let mut looked = Instant::now();
        loop {
            let since = self.file.as_ref().and_then(|file| file.pending_since);
            match orders.recv_timeout(since.map_or(IDLE, |since| FLUSH.saturating_sub(since.elapsed()))) {
                Ok(order) => self.carry_out(order),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            let due = |file: &OpenFile| file.pending_since.is_some_and(|since| since.elapsed() >= FLUSH);
            if self.file.as_ref().is_some_and(due)
                && let Some(file) = &mut self.file
                && let Err(broken) = file.flush()
            {
                self.broke(broken);
            }
            if looked.elapsed() >= Duration::from_millis(100) {
                looked = Instant::now();
                every();
            }
        }
        self.close("the recorder was stopped");
    }

    fn carry_out(&mut self, order: Order) {
        match order {
            Order::Channel(channel) => {
                if let Some(file) = &mut self.file
                    && let Err(broken) = file.add(&channel)
                {
                    self.broke(broken);
                }
                self.channels.push(*channel);
            }
            Order::Block(block) => {
                self.returns.arrived(&block);
                if self.file.is_some() {
                    self.write(&block);
                    self.returns.give(block);
                } else {
                    self.hold(block);
                }
            }
            Order::Metadata(name, values) => {
                if let Some(file) = &mut self.file
                    && let Err(broken) = file.metadata(&name, &values)
                {
                    self.broke(broken);
                }
                self.metadata.retain(|(old, _)| *old != name);
                self.metadata.push((name, values));
            }
            Order::Open(opening) => self.open(*opening),
            Order::Lost(lost) => self.lost = lost,
            Order::Close(why) => self.close(&why),
        }
    }

    fn write(&mut self, block: &Block) {
        let Some(file) = &mut self.file else { return };
        for (head, bytes) in block.messages() {
            if let Err(broken) = file.message(head, bytes) {
                self.broke(broken);
                return;
            }
        }
        file.written.messages.store(file.messages, Ordering::Relaxed);
        file.written.bytes.store(file.word.len.load(Ordering::Relaxed) + file.pending, Ordering::Relaxed);
    }

    /// Keeps what came before a recording, as long and as much as was asked for.
    fn hold(&mut self, block: Block) {
        let newest_ns = block.newest_ns();
        self.held_bytes += block.len() as u64;
        self.held.push_back(block);
        while let Some(oldest) = self.held.front() {
            let old = oldest.newest_ns().saturating_add(self.hold_ns) < newest_ns;
            if self.hold_ns > 0 && !old && self.held_bytes <= self.hold_bytes {
                break;
            }
            let Some(oldest) = self.held.pop_front() else { break };
            self.held_bytes -= oldest.len() as u64;
            self.returns.give(oldest);
        }
    }

    fn open(&mut self, opening: Opening) {
        self.close("another recording was begun");
        self.lost.clear();
        let (path, since_ns) = (opening.path.clone(), opening.since_ns);
        match OpenFile::new(opening, &self.channels, &self.metadata) {
            Ok(file) => self.file = Some(file),
            Err(broken) => {
                let why = match broken {
                    Broken::Full => "there is no room on the disk".to_owned(),
                    Broken::Other(why) => why,
                };
                self.tell(News::Ended { why, path, messages: 0, bytes: 0, lost: 0, whole: false });
                return;
            }
        }
        let held = std::mem::take(&mut self.held);
        self.held_bytes = 0;
        for block in held {
            if block.newest_ns() >= since_ns {
                self.write(&block);
            }
            self.returns.give(block);
        }
    }

    fn broke(&mut self, broken: Broken) {
        match broken {
            Broken::Full => self.close(FULL),
            Broken::Other(why) => {
                // Nothing more can be written: the file is what it is, and readers that read from the begin read it.
                if let Some(file) = self.file.take() {
                    let (path, messages) = (file.path.clone(), file.messages);
                    let lost = self.lost_of(&file);
                    let bytes = file.give_up();
                    self.tell(News::Ended { why, path, messages, bytes, lost, whole: false });
                }
            }
        }
    }

    fn close(&mut self, why: &str) {
        let Some(file) = self.file.take() else { return };
        let (path, messages) = (file.path.clone(), file.messages);
        let lost = self.lost_of(&file);
        let written = file.written.clone();
        let (bytes, whole, told) = file.finish(why, &self.lost, &self.channels);
        let why = told.unwrap_or_else(|| why.to_owned());
        written.bytes.store(bytes, Ordering::Relaxed);
        self.tell(News::Ended { why, path, messages, bytes, lost, whole });
    }

    /// Of the recording in this file, as far as it was told.
    fn lost_of(&self, file: &OpenFile) -> u64 {
        file.all_spoiled() + self.lost.iter().map(|(_, n)| n).sum::<u64>()
    }

    fn tell(&self, news: News) {
        let _ = self.news.send(news);
    }
}

impl OpenFile {
    fn new(
        opening: Opening,
        channels: &[Channel],
        metadata: &[(String, BTreeMap<String, String>)],
    ) -> Result<OpenFile, Broken> {
        let mut room = Room::new(opening.file.try_clone()?);
        if !room.ensure(2 * TAIL)? {
            return Err(Broken::Full);
        }
        let word = Arc::new(Word::default());
        let file = Sink::new(opening.file, word.clone());
        let options = WriteOptions::new()
            .compression(None)
            .profile("trocar")
            .library(concat!("trocar-recorder ", env!("CARGO_PKG_VERSION")))
            .chunk_size(None)
            .disable_seeking(true)
            // Each chunk has its own: a second one over the same bytes finds nothing more.
            .calculate_data_section_crc(false);
        let mcap = options.create(NoSeek::new(file))?;
        let mut file = OpenFile {
            mcap,
            path: opening.path,
            written: opening.written,
            codec: opening.codec,
            room,
            word,
            ids: Vec::new(),
            messages: 0,
            spoiled: BTreeMap::new(),
            pending: 0,
            pending_since: None,
            summary: 0,
            scratch: Vec::new(),
        };
        for channel in channels {
            file.add(channel)?;
        }
        for (name, values) in metadata {
            file.metadata(name, values)?;
        }
        file.mcap.flush()?;
        Ok(file)
    }

    /// Makes sure of the room for `more` bytes and for everything that has to follow them.
    fn room_for(&mut self, more: u64) -> Result<(), Broken> {
        let open_chunk = self.pending + PER_CHUNK + PER_CHANNEL * self.ids.len() as u64;
        let end = self.word.len.load(Ordering::Relaxed)
            + open_chunk
            + more
            + self.summary
            + open_chunk_summary(self.ids.len())
            + TAIL;
        if self.room.ensure(end)? { Ok(()) } else { Err(Broken::Full) }
    }

    fn add(&mut self, channel: &Channel) -> Result<(), Broken> {
        let metadata: usize = channel.metadata.iter().map(|(k, v)| k.len() + v.len() + 16).sum();
        let bytes =
            (channel.topic.len() + channel.schema.len() + channel.schema_data.len() + metadata + 128) as u64;
        self.room_for(2 * bytes)?;
        self.summary += bytes;
        let schema = self.mcap.add_schema(&channel.schema, channel.schema_encoding, &channel.schema_data)?;
        let id = self.mcap.add_channel(schema, &channel.topic, channel.encoding, &channel.metadata)?;
        self.ids.push(id);
        Ok(())
    }

    fn metadata(&mut self, name: &str, values: &BTreeMap<String, String>) -> Result<(), Broken> {
        let bytes: usize = values.iter().map(|(k, v)| k.len() + v.len() + 16).sum();
        self.room_for(bytes as u64 + 256)?;
        self.summary += 128;
        self.flush()?;
        self.mcap.write_metadata(&Metadata { name: name.to_owned(), metadata: values.clone() })?;
        self.word.urgent.store(true, Ordering::Relaxed);
        self.close_chunk()
    }

    fn message(&mut self, head: &Head, bytes: &[u8]) -> Result<(), Broken> {
        let Some(id) = self.ids.get(head.channel as usize).copied() else { return Ok(()) };
        let mut scratch = std::mem::take(&mut self.scratch);
        let data = match head.kind {
            Kind::Ready => bytes,
            kind @ Kind::Pixels { .. } => {
                scratch.clear();
                if !compress::encode(self.codec, kind, head.publish_ns, bytes, &mut scratch) {
                    *self.spoiled.entry(head.channel).or_default() += 1;
                    self.scratch = scratch;
                    return Ok(());
                }
                &scratch
            }
        };
        let done = self.put(head, id, data);
        self.scratch = scratch;
        done
    }

    fn put(&mut self, head: &Head, channel_id: u16, data: &[u8]) -> Result<(), Broken> {
        self.room_for(data.len() as u64 + PER_MESSAGE)?;
        let header = MessageHeader {
            channel_id,
            // The format has 32 bits for it: the count goes on from 0 there.
            sequence: head.seq as u32,
            log_time: head.log_ns,
            publish_time: head.publish_ns,
        };
        self.mcap.write_to_known_channel(&header, data)?;
        self.messages += 1;
        self.pending += data.len() as u64 + PER_MESSAGE;
        self.pending_since.get_or_insert_with(Instant::now);
        if self.pending >= CHUNK { self.close_chunk() } else { Ok(()) }
    }

    fn all_spoiled(&self) -> u64 {
        self.spoiled.values().sum()
    }

    /// What is in the chunk goes on its way.
    fn close_chunk(&mut self) -> Result<(), Broken> {
        if self.pending > 0 {
            self.summary += open_chunk_summary(self.ids.len());
            self.pending = 0;
        }
        self.mcap.flush()?;
        if self.word.stored.load(Ordering::Relaxed) == self.word.len.load(Ordering::Relaxed) {
            self.pending_since = None;
        }
        Ok(())
    }

    /// All that was taken is in the file.
    fn flush(&mut self) -> Result<(), Broken> {
        if self.pending_since.take().is_some() {
            self.word.urgent.store(true, Ordering::Relaxed);
            self.close_chunk()?;
        }
        Ok(())
    }

    /// Closes the file: its length, whether it is whole, and what went wrong instead of the reason.
    fn finish(
        mut self,
        why: &str,
        lost: &[(String, u64)],
        channels: &[Channel],
    ) -> (u64, bool, Option<String>) {
        let mut all: BTreeMap<String, u64> = lost.iter().cloned().collect();
        for (channel, n) in &self.spoiled {
            if let Some(channel) = channels.get(*channel as usize) {
                *all.entry(channel.topic.clone()).or_default() += n;
            }
        }
        let total: u64 = all.values().sum();
        let wall_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |t| t.as_nanos());
        let mut end = BTreeMap::from([
            ("reason".to_owned(), why.to_owned()),
            ("messages".to_owned(), self.messages.to_string()),
            ("lost".to_owned(), total.to_string()),
            ("closed_unix_ns".to_owned(), wall_ns.to_string()),
        ]);
        // As many as there is room for at the end; the sum has them all.
        let mut room = (TAIL / 2) as usize;
        for (topic, n) in all.iter().filter(|(_, n)| **n > 0) {
            let Some(left) = room.checked_sub(topic.len() + 64) else { break };
            room = left;
            end.insert(format!("lost:{topic}"), n.to_string());
        }
        let record = Metadata { name: "trocar.end".to_owned(), metadata: end };
        let done = self
            .mcap
            .flush()
            .and_then(|()| self.mcap.write_metadata(&record))
            .and_then(|()| self.mcap.finish().map(|_| ()));
        let (bytes, closed) = self.mcap.into_inner().into_inner().close();
        let done = done.and(closed.map_err(McapError::from));
        let told = done.err().map(|e| format!("{why}; the file could not be closed: {e}"));
        self.room.trim(bytes);
        (bytes, told.is_none(), told)
    }

    /// Leaves the file as it is, and tells its length; nothing of what waits is written, and a summary is not tried.
    fn give_up(self) -> u64 {
        let stored = self.mcap.into_inner().into_inner().stored();
        self.room.trim(stored);
        stored
    }
}

fn open_chunk_summary(channels: usize) -> u64 {
    PER_CHUNK + PER_CHANNEL * channels as u64
}

#[cfg(test)]
#[path = "writer_tests.rs"]
mod tests;
