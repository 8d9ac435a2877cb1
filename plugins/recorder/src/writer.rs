//! The thread that writes: blocks become an MCAP file, closed properly whatever happens to the disk.
//!
//! Invariant: nothing is handed to the file unless there is room for it and for everything that has to come
//! behind it. What was taken is in the file at most [`FLUSH`] later.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use mcap::records::{MessageHeader, Metadata};

use crate::block::{Block, Head, Kind};
use crate::compress;
use crate::mcap_file::{McapFile, is_alone};
use crate::orders::{Channel, Codec, Ended, Missing, Opening, Order, Written};
use crate::room::Room;
use crate::sink::{MOST_FILLER, Sink};
use crate::way::Returns;

/// A message is in the file after so long.
const FLUSH: Duration = Duration::from_millis(10);
/// Without anything to flush it looks up so often.
const IDLE: Duration = Duration::from_millis(50);
/// A chunk is closed when it holds so many bytes.
const CHUNK: u64 = 64 << 10;
/// Length of a file's end beside its indexes, bytes: statistics, offsets, footer, what is lost.
const TAIL: u64 = 128 << 10;
/// Length of a message beside its bytes: record, index entry; of one that is a chunk of its own: the chunk's,
/// too.
const PER_MESSAGE: u64 = 64;
const PER_LARGE: u64 = 512 + MOST_FILLER as u64;

/// Why a recording ends that finds no more room.
pub(crate) const FULL: &str = "the disk is full: there is room for the end of the file alone";

/// The writer's thread, from begin to end.
pub(crate) struct Writer {
    returns: Returns,
    news: Sender<Ended>,
    channels: Vec<Channel>,
    metadata: Vec<(String, BTreeMap<String, String>)>,
    missing: Missing,
    /// From before a recording, oldest first.
    past: VecDeque<Block>,
    past_bytes: u64,
    /// Part of it that stays, in time and in bytes.
    most_past: (u64, u64),
    file: Option<OpenFile>,
}

struct OpenFile {
    mcap: McapFile,
    path: PathBuf,
    written: Arc<Written>,
    codec: Codec,
    room: Room,
    /// The file's number of each channel of ours.
    ids: Vec<u16>,
    messages: u64,
    /// Messages that could not be compressed, per channel.
    spoiled: BTreeMap<u32, u64>,
    /// When the first of what may not be in the file yet was taken.
    pending_since: Option<Instant>,
    scratch: Vec<u8>,
}

/// Why a file ends without being asked to.
enum Broken {
    Full,
    Other(String),
}

impl From<io::Error> for Broken {
    fn from(why: io::Error) -> Broken {
        Broken::Other(why.to_string())
    }
}

impl Writer {
    pub(crate) fn new(returns: Returns, news: Sender<Ended>, most_past: (u64, u64)) -> Writer {
        Writer {
            returns,
            news,
            channels: Vec::new(),
            metadata: Vec::new(),
            missing: Missing::default(),
            past: VecDeque::new(),
            past_bytes: 0,
            most_past,
            file: None,
        }
    }

    /// Runs until the step's end is gone; an open file is closed then. `every` is called about ten times a
    /// second.
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
            Order::Renamed(at, topic) => {
                if let Some(channel) = self.channels.get_mut(at) {
                    channel.topic = topic;
                }
            }
            Order::Block(block) => {
                self.returns.arrived(&block);
                if self.file.is_some() {
                    self.write(&block);
                    self.returns.give(block);
                } else {
                    self.keep_past(block);
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
            Order::Missing(missing, on_its_way) => {
                self.missing = missing;
                drop(on_its_way);
            }
            Order::Close(why) => self.close(&why),
        }
    }

    fn write(&mut self, block: &Block) {
        let Some(file) = &mut self.file else { return };
        for (head, parts) in block.messages() {
            if let Err(broken) = file.message(head, parts) {
                self.broke(broken);
                return;
            }
        }
        file.written.messages.store(file.messages, Ordering::Relaxed);
        file.written.bytes.store(file.mcap.len(), Ordering::Relaxed);
    }

    /// Keeps what came before a recording, as long and as much as was asked for.
    fn keep_past(&mut self, mut block: Block) {
        let (most_ns, most_bytes) = self.most_past;
        if most_ns > 0 {
            block.copy_held();
        }
        let newest_ns = block.newest_ns();
        self.past_bytes += block.len() as u64;
        self.past.push_back(block);
        while let Some(oldest) = self.past.front() {
            let old = oldest.newest_ns().saturating_add(most_ns) < newest_ns;
            if most_ns > 0 && !old && self.past_bytes <= most_bytes {
                break;
            }
            let Some(oldest) = self.past.pop_front() else { break };
            self.past_bytes -= oldest.len() as u64;
            self.returns.give(oldest);
        }
    }

    fn open(&mut self, opening: Opening) {
        self.close("another recording was begun");
        self.missing = Missing::default();
        let (path, since_ns) = (opening.path.clone(), opening.since_ns);
        match OpenFile::new(opening, &self.channels, &self.metadata) {
            Ok(file) => self.file = Some(file),
            Err(broken) => {
                let why = match broken {
                    Broken::Full => "there is no room on the disk".to_owned(),
                    Broken::Other(why) => why,
                };
                self.tell(Ended { why, path, messages: 0, bytes: 0, lost: 0, interrupted: 0, whole: false });
                return;
            }
        }
        let past = std::mem::take(&mut self.past);
        self.past_bytes = 0;
        for block in past {
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
                // Nothing more can be written: the file stays as it is, and readers that read from the begin
                // can read it.
                if let Some(file) = self.file.take() {
                    let (path, messages) = (file.path.clone(), file.messages);
                    let (lost, interrupted) = self.missing_of(&file);
                    let bytes = file.give_up();
                    self.tell(Ended { why, path, messages, bytes, lost, interrupted, whole: false });
                }
            }
        }
    }

    fn close(&mut self, why: &str) {
        let Some(file) = self.file.take() else { return };
        let (path, messages) = (file.path.clone(), file.messages);
        let (lost, interrupted) = self.missing_of(&file);
        let written = file.written.clone();
        let (bytes, whole, told) = file.finish(why, &self.missing, &self.channels);
        let why = told.unwrap_or_else(|| why.to_owned());
        written.bytes.store(bytes, Ordering::Relaxed);
        self.tell(Ended { why, path, messages, bytes, lost, interrupted, whole });
    }

    /// Lost and interrupted, of the recording in this file, as far as it was told.
    fn missing_of(&self, file: &OpenFile) -> (u64, u64) {
        let sum = |all: &[(String, u64)]| all.iter().map(|(_, n)| n).sum::<u64>();
        (file.all_spoiled() + sum(&self.missing.lost), sum(&self.missing.interrupted))
    }

    fn tell(&self, ended: Ended) {
        let _ = self.news.send(ended);
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
        let library = concat!("trocar-recorder ", env!("CARGO_PKG_VERSION"));
        let mut file = OpenFile {
            mcap: McapFile::new(Sink::new(opening.file), "trocar", library)?,
            path: opening.path,
            written: opening.written,
            codec: opening.codec,
            room,
            ids: Vec::new(),
            messages: 0,
            spoiled: BTreeMap::new(),
            pending_since: None,
            scratch: Vec::new(),
        };
        for channel in channels {
            file.add(channel)?;
        }
        for (name, values) in metadata {
            file.metadata(name, values)?;
        }
        file.mcap.flush(true)?;
        Ok(file)
    }

    /// Makes sure of the room for `more` bytes and for everything that has to follow them.
    fn room_for(&mut self, more: u64) -> Result<(), Broken> {
        let end = self.mcap.len() + more + self.mcap.end_len() + TAIL;
        if self.room.ensure(end)? { Ok(()) } else { Err(Broken::Full) }
    }

    fn add(&mut self, channel: &Channel) -> Result<(), Broken> {
        let metadata: usize = channel.metadata.iter().map(|(k, v)| k.len() + v.len() + 16).sum();
        let bytes =
            (channel.topic.len() + channel.schema.len() + channel.schema_data.len() + metadata + 128) as u64;
        self.room_for(2 * bytes)?;
        let schema = (channel.schema.as_str(), channel.schema_encoding, channel.schema_data.as_slice());
        self.ids.push(self.mcap.add(&channel.topic, channel.encoding, &channel.metadata, schema)?);
        Ok(())
    }

    fn metadata(&mut self, name: &str, values: &BTreeMap<String, String>) -> Result<(), Broken> {
        let bytes: usize = values.iter().map(|(k, v)| k.len() + v.len() + 16).sum();
        self.room_for(bytes as u64 + 256)?;
        self.mcap.metadata(&Metadata { name: name.to_owned(), metadata: values.clone() })?;
        self.pending_since.get_or_insert_with(Instant::now);
        self.flush()
    }

    /// In two parts, of which the second is a frame's.
    fn message(&mut self, head: &Head, [begin, rest]: [&[u8]; 2]) -> Result<(), Broken> {
        let Some(id) = self.ids.get(head.channel as usize).copied() else { return Ok(()) };
        let mut scratch = std::mem::take(&mut self.scratch);
        let data = match head.kind {
            Kind::Ready => [begin, rest],
            kind @ Kind::Pixels { .. } => {
                scratch.clear();
                let pixels = if rest.is_empty() { begin } else { rest };
                if !compress::encode(self.codec, kind, head.publish_ns, pixels, &mut scratch) {
                    *self.spoiled.entry(head.channel).or_default() += 1;
                    self.scratch = scratch;
                    return Ok(());
                }
                [scratch.as_slice(), &[]]
            }
        };
        let done = self.put(head, id, data);
        self.scratch = scratch;
        done
    }

    fn put(&mut self, head: &Head, channel_id: u16, parts: [&[u8]; 2]) -> Result<(), Broken> {
        let len = (parts[0].len() + parts[1].len()) as u64;
        self.room_for(len + if is_alone(parts) { PER_LARGE } else { PER_MESSAGE })?;
        let header = MessageHeader {
            channel_id,
            // The format has 32 bits for it: the count goes on from 0 there.
            sequence: head.seq as u32,
            log_time: head.log_ns,
            publish_time: head.publish_ns,
        };
        self.mcap.message(&header, parts)?;
        self.messages += 1;
        self.pending_since.get_or_insert_with(Instant::now);
        if self.mcap.pending() >= CHUNK { self.close_chunk(false) } else { Ok(()) }
    }

    fn all_spoiled(&self) -> u64 {
        self.spoiled.values().sum()
    }

    /// Sends on what is in the chunk.
    fn close_chunk(&mut self, urgent: bool) -> Result<(), Broken> {
        if self.mcap.flush(urgent)? {
            self.pending_since = None;
        }
        Ok(())
    }

    /// All that was taken is in the file.
    fn flush(&mut self) -> Result<(), Broken> {
        if self.pending_since.is_some() { self.close_chunk(true) } else { Ok(()) }
    }

    /// Closes the file: its length, whether it is whole, and what went wrong instead of the reason.
    fn finish(mut self, why: &str, missing: &Missing, channels: &[Channel]) -> (u64, bool, Option<String>) {
        let mut all: BTreeMap<String, u64> = missing.lost.iter().cloned().collect();
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
        let interrupted: u64 = missing.interrupted.iter().map(|(_, n)| n).sum();
        end.insert("interrupted".to_owned(), interrupted.to_string());
        // As many as there is room for at the end; the sums have them all.
        let mut room = (TAIL / 2) as usize;
        let lost = all.iter().filter(|(_, n)| **n > 0).map(|(topic, n)| ("lost", topic, *n));
        let cut = missing.interrupted.iter().map(|(topic, n)| ("interrupted", topic, *n));
        let silent = missing.silent.iter().map(|topic| ("messages", topic, 0));
        for (what, topic, n) in cut.chain(lost).chain(silent) {
            let Some(left) = room.checked_sub(topic.len() + 64) else { break };
            room = left;
            end.insert(format!("{what}:{topic}"), n.to_string());
        }
        let record = Metadata { name: "trocar.end".to_owned(), metadata: end };
        let done = self.mcap.metadata(&record).and_then(|()| self.mcap.finish());
        let (bytes, closed) = self.mcap.into_sink().close();
        let done = done.and(closed);
        let told = done.err().map(|e| format!("{why}; the file could not be closed: {e}"));
        self.room.trim(bytes);
        (bytes, told.is_none(), told)
    }

    /// Leaves the file as it is, and returns its length; nothing that waits is written, and no summary is
    /// tried.
    fn give_up(self) -> u64 {
        let stored = self.mcap.into_sink().stored();
        self.room.trim(stored);
        stored
    }
}

#[cfg(test)]
#[path = "writer_tests.rs"]
mod tests;
