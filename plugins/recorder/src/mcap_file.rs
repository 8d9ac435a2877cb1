//! An MCAP file as it is written: small messages together in chunks, each large one a chunk of its own around
//! bytes that are not copied for it. The crate's own writer copies each message twice.
//!
//! Invariant: the file consists of whole records, except for the last one; the places of other records that
//! they name are right. Chunks carry their checksum, except for those around a frame that is held: its bytes
//! are never read here.

use std::collections::BTreeMap;
use std::io::{self, Cursor};

use binrw::BinWrite;
use mcap::MAGIC;
use mcap::records::{
    Channel, ChunkIndex, DataEnd, Footer, Header, MessageHeader, MessageIndexEntry, Metadata, MetadataIndex,
    SchemaHeader, Statistics, SummaryOffset, op,
};

use crate::block::LARGE;
use crate::sink::Sink;

/// Length of a record's opcode and length field.
const RECORD_HEAD: u64 = 9;
/// Length of a message's record behind its head and before its bytes.
const MESSAGE_HEAD: u64 = 22;
/// Length of a chunk: its record up to its messages, and its index in the summary without its part for each
/// channel.
const CHUNK_HEAD: u64 = RECORD_HEAD + 8 + 8 + 8 + 4 + 4 + 8;
const CHUNK_INDEX: u64 = RECORD_HEAD + 4 * 8 + 4 + 8 + 4 + 2 * 8;
/// Length of an index of messages, up to those.
const INDEX_HEAD: u64 = RECORD_HEAD + 2 + 4;
/// Length that a chunk's index and the statistics take for each channel.
const PER_CHANNEL: u64 = 2 + 8;

/// Whether a message is a chunk of its own: one of its parts is large.
pub(crate) fn is_alone(parts: [&[u8]; 2]) -> bool {
    parts.iter().any(|part| part.len() >= LARGE)
}

/// A file that is open.
pub(crate) struct McapFile {
    sink: Sink,
    schemas: Vec<(SchemaHeader, Vec<u8>)>,
    channels: Vec<Channel>,
    chunk: Chunk,
    /// Bytes that one record after the other is put together in.
    scratch: Vec<u8>,
    chunks: Vec<ChunkIndex>,
    metadata: Vec<MetadataIndex>,
    counts: BTreeMap<u16, u64>,
    /// Log times of all messages.
    times: Option<(u64, u64)>,
    /// Length of the summary so far, bytes.
    summary: u64,
}

/// Messages that go into the file together.
#[derive(Default)]
struct Chunk {
    bytes: Vec<u8>,
    times: Option<(u64, u64)>,
    /// By channel: when, and where in the chunk.
    entries: BTreeMap<u16, Vec<MessageIndexEntry>>,
}

fn widen(times: &mut Option<(u64, u64)>, at: u64) {
    let (first, last) = times.unwrap_or((at, at));
    *times = Some((first.min(at), last.max(at)));
}

/// Appends a record whose content `write` appends.
fn record(
    to: &mut Vec<u8>,
    opcode: u8,
    write: impl FnOnce(&mut Vec<u8>) -> io::Result<()>,
) -> io::Result<()> {
    to.push(opcode);
    let at = to.len();
    to.extend([0; 8]);
    write(to)?;
    let len = (to.len() - at - 8) as u64;
    to[at..at + 8].copy_from_slice(&len.to_le_bytes());
    Ok(())
}

/// Appends what the crate says a record's content is.
fn content(to: &mut Vec<u8>, fields: &impl Fields) -> io::Result<()> {
    let mut bytes = Cursor::new(Vec::new());
    fields.write_le(&mut bytes).map_err(io::Error::other)?;
    to.append(bytes.get_mut());
    Ok(())
}

/// The crate's descriptions of records.
trait Fields: for<'a> BinWrite<Args<'a> = ()> {}
impl<T: for<'a> BinWrite<Args<'a> = ()>> Fields for T {}

fn string(to: &mut Vec<u8>, text: &str) {
    to.extend((text.len() as u32).to_le_bytes());
    to.extend_from_slice(text.as_bytes());
}

/// Writes the head of a chunk that is not compressed and holds so many bytes.
fn chunk_head(to: &mut Vec<u8>, (first, last): (u64, u64), crc: u32, len: u64) {
    to.push(op::CHUNK);
    to.extend((CHUNK_HEAD - RECORD_HEAD + len).to_le_bytes());
    for word in [first, last, len] {
        to.extend(word.to_le_bytes());
    }
    to.extend(crc.to_le_bytes());
    string(to, "");
    to.extend(len.to_le_bytes());
}

/// Writes the head of a message with so many bytes.
fn message_head(to: &mut Vec<u8>, header: &MessageHeader, len: usize) {
    to.push(op::MESSAGE);
    to.extend((MESSAGE_HEAD + len as u64).to_le_bytes());
    to.extend(header.channel_id.to_le_bytes());
    to.extend(header.sequence.to_le_bytes());
    to.extend(header.log_time.to_le_bytes());
    to.extend(header.publish_time.to_le_bytes());
}

impl McapFile {
    pub(crate) fn new(sink: Sink, profile: &str, library: &str) -> io::Result<McapFile> {
        let mut file = McapFile {
            sink,
            schemas: Vec::new(),
            channels: Vec::new(),
            chunk: Chunk::default(),
            scratch: Vec::new(),
            chunks: Vec::new(),
            metadata: Vec::new(),
            counts: BTreeMap::new(),
            times: None,
            summary: 0,
        };
        file.sink.put(MAGIC)?;
        let header = Header { profile: profile.to_owned(), library: library.to_owned() };
        file.put(op::HEADER, |to| content(to, &header))?;
        Ok(file)
    }

    /// All that was written, and what waits to become a chunk, bytes.
    pub(crate) fn len(&self) -> u64 {
        self.sink.len() + self.pending()
    }

    /// Length of what waits to become a chunk, bytes.
    pub(crate) fn pending(&self) -> u64 {
        self.chunk.bytes.len() as u64
    }

    /// Length of what follows if the file ends now, except for the end's own metadata and what is equally
    /// long in every file.
    pub(crate) fn end_len(&self) -> u64 {
        let entries: usize = self.chunk.entries.values().map(Vec::len).sum();
        let channels = self.chunk.entries.len() as u64;
        self.summary + CHUNK_HEAD + CHUNK_INDEX + channels * (INDEX_HEAD + PER_CHANNEL) + 16 * entries as u64
    }

    fn put(&mut self, opcode: u8, write: impl FnOnce(&mut Vec<u8>) -> io::Result<()>) -> io::Result<()> {
        self.scratch.clear();
        record(&mut self.scratch, opcode, write)?;
        self.sink.put(&self.scratch)
    }

    /// A topic: its number. Topics of the same schema share it.
    ///
    /// # Errors
    /// The error of the disk, or there are more than a file can have.
    pub(crate) fn add(
        &mut self,
        topic: &str,
        encoding: &str,
        metadata: &BTreeMap<String, String>,
        (name, schema_encoding, data): (&str, &str, &[u8]),
    ) -> io::Result<u16> {
        let same = |(old, bytes): &(SchemaHeader, Vec<u8>)| {
            old.name == name && old.encoding == schema_encoding && bytes == data
        };
        let number = |n: usize| {
            u16::try_from(n).map_err(|_| io::Error::other("a file has 65535 topics and schemas at most"))
        };
        let schema_id = match self.schemas.iter().find(|old| same(old)) {
            Some((known, _)) => known.id,
            None => {
                let id = number(self.schemas.len() + 1)?;
                let header = SchemaHeader { id, name: name.to_owned(), encoding: schema_encoding.to_owned() };
                self.put(op::SCHEMA, |to| schema(to, &header, data))?;
                self.summary += self.scratch.len() as u64;
                self.schemas.push((header, data.to_vec()));
                id
            }
        };
        let channel = Channel {
            id: number(self.channels.len())?,
            schema_id,
            topic: topic.to_owned(),
            message_encoding: encoding.to_owned(),
            metadata: metadata.clone(),
        };
        self.put(op::CHANNEL, |to| content(to, &channel))?;
        // The channel is counted in the statistics, too.
        self.summary += self.scratch.len() as u64 + PER_CHANNEL;
        let id = channel.id;
        self.channels.push(channel);
        Ok(id)
    }

    /// Behind everything that came before.
    pub(crate) fn metadata(&mut self, record: &Metadata) -> io::Result<()> {
        self.close_chunk()?;
        let offset = self.sink.len();
        self.put(op::METADATA, |to| content(to, record))?;
        let length = self.sink.len() - offset;
        self.summary += RECORD_HEAD + 8 + 8 + 4 + record.name.len() as u64;
        self.metadata.push(MetadataIndex { offset, length, name: record.name.clone() });
        Ok(())
    }

    /// A message in two parts.
    pub(crate) fn message(&mut self, header: &MessageHeader, [begin, rest]: [&[u8]; 2]) -> io::Result<()> {
        let len = begin.len() + rest.len();
        *self.counts.entry(header.channel_id).or_default() += 1;
        widen(&mut self.times, header.log_time);
        if is_alone([begin, rest]) {
            self.close_chunk()?;
            return self.alone(header, [begin, rest]);
        }
        let chunk = &mut self.chunk;
        widen(&mut chunk.times, header.log_time);
        let entry = MessageIndexEntry { log_time: header.log_time, offset: chunk.bytes.len() as u64 };
        chunk.entries.entry(header.channel_id).or_default().push(entry);
        message_head(&mut chunk.bytes, header, len);
        chunk.bytes.extend_from_slice(begin);
        chunk.bytes.extend_from_slice(rest);
        Ok(())
    }

    /// A message as a chunk.
    fn alone(&mut self, header: &MessageHeader, [begin, rest]: [&[u8]; 2]) -> io::Result<()> {
        let len = begin.len() + rest.len();
        let chunk_len = RECORD_HEAD + MESSAGE_HEAD + len as u64;
        let times = (header.log_time, header.log_time);
        let mut head = std::mem::take(&mut self.scratch);
        head.clear();
        let mut message = Vec::new();
        message_head(&mut message, header, len);
        let mut sum = crc32fast::Hasher::new();
        if rest.is_empty() {
            sum.update(&message);
            sum.update(begin);
        }
        chunk_head(&mut head, times, sum.finalize(), chunk_len);
        head.append(&mut message);
        // Bytes that lie in a frame are not copied.
        let placed = if rest.len() >= LARGE {
            head.extend_from_slice(begin);
            self.sink.place(&head, rest)
        } else {
            self.sink.place(&head, begin).and_then(|begins| self.sink.put(rest).map(|()| begins))
        };
        self.scratch = head;
        let entry = MessageIndexEntry { log_time: header.log_time, offset: 0 };
        let entries = BTreeMap::from([(header.channel_id, vec![entry])]);
        self.index(placed?, times, chunk_len, &entries)
    }

    /// Writes what waits into the file as a chunk.
    pub(crate) fn close_chunk(&mut self) -> io::Result<()> {
        let Some(times) = self.chunk.times.take() else { return Ok(()) };
        let mut chunk = std::mem::take(&mut self.chunk);
        let begins = self.sink.len();
        self.scratch.clear();
        chunk_head(&mut self.scratch, times, crc32fast::hash(&chunk.bytes), chunk.bytes.len() as u64);
        self.sink.put(&self.scratch)?;
        self.sink.put(&chunk.bytes)?;
        self.index(begins, times, chunk.bytes.len() as u64, &chunk.entries)?;
        chunk.bytes.clear();
        chunk.entries.values_mut().for_each(Vec::clear);
        self.chunk = chunk;
        Ok(())
    }

    /// Behind a chunk: where its messages are.
    fn index(
        &mut self,
        chunk_start_offset: u64,
        (message_start_time, message_end_time): (u64, u64),
        len: u64,
        entries: &BTreeMap<u16, Vec<MessageIndexEntry>>,
    ) -> io::Result<()> {
        let ends = self.sink.len();
        let mut message_index_offsets = BTreeMap::new();
        for (channel, entries) in entries.iter().filter(|(_, entries)| !entries.is_empty()) {
            message_index_offsets.insert(*channel, self.sink.len());
            self.put(op::MESSAGE_INDEX, |to| {
                to.extend(channel.to_le_bytes());
                to.extend((16 * entries.len() as u32).to_le_bytes());
                for entry in entries {
                    to.extend(entry.log_time.to_le_bytes());
                    to.extend(entry.offset.to_le_bytes());
                }
                Ok(())
            })?;
        }
        self.summary += CHUNK_INDEX + PER_CHANNEL * message_index_offsets.len() as u64;
        self.chunks.push(ChunkIndex {
            message_start_time,
            message_end_time,
            chunk_start_offset,
            chunk_length: ends - chunk_start_offset,
            message_index_offsets,
            message_index_length: self.sink.len() - ends,
            compression: String::new(),
            compressed_size: len,
            uncompressed_size: len,
        });
        Ok(())
    }

    /// Sends on what waits; with `urgent` all of it is in the file afterwards. Returns whether all of it is
    /// in the file.
    pub(crate) fn flush(&mut self, urgent: bool) -> io::Result<bool> {
        self.close_chunk()?;
        self.sink.flush(urgent)
    }

    /// Writes the end of the file: its index and statistics.
    pub(crate) fn finish(&mut self) -> io::Result<()> {
        self.close_chunk()?;
        self.put(op::DATA_END, |to| content(to, &DataEnd { data_section_crc: 0 }))?;
        let summary_start = self.sink.len();
        let mut summary = Summary { file: self, sum: crc32fast::Hasher::new(), groups: Vec::new() };
        summary.write()?;
        let Summary { mut sum, groups, .. } = summary;
        let summary_offset_start = self.sink.len();
        for group in &groups {
            self.put(op::SUMMARY_OFFSET, |to| content(to, group))?;
            sum.update(&self.scratch);
        }
        let mut footer = Footer { summary_start, summary_offset_start, summary_crc: 0 };
        let mut bytes = Vec::new();
        record(&mut bytes, op::FOOTER, |to| content(to, &footer))?;
        // The sum is of all before itself.
        sum.update(&bytes[..bytes.len() - 4]);
        footer.summary_crc = sum.finalize();
        self.put(op::FOOTER, |to| content(to, &footer))?;
        self.sink.put(MAGIC)
    }

    #[cfg(test)]
    pub(crate) fn go_direct(&mut self) -> bool {
        self.sink.go_direct()
    }

    /// The file, once it was finished or is given up.
    pub(crate) fn into_sink(self) -> Sink {
        self.sink
    }
}

fn schema(to: &mut Vec<u8>, header: &SchemaHeader, data: &[u8]) -> io::Result<()> {
    content(to, header)?;
    to.extend((data.len() as u32).to_le_bytes());
    to.extend_from_slice(data);
    Ok(())
}

/// The summary while it is written.
struct Summary<'f> {
    file: &'f mut McapFile,
    sum: crc32fast::Hasher,
    groups: Vec<SummaryOffset>,
}

impl Summary<'_> {
    fn write(&mut self) -> io::Result<()> {
        let statistics = Statistics {
            message_count: self.file.counts.values().sum(),
            schema_count: self.file.schemas.len() as u16,
            channel_count: self.file.channels.len() as u32,
            attachment_count: 0,
            metadata_count: self.file.metadata.len() as u32,
            chunk_count: self.file.chunks.len() as u32,
            message_start_time: self.file.times.map_or(0, |(first, _)| first),
            message_end_time: self.file.times.map_or(0, |(_, last)| last),
            channel_message_counts: std::mem::take(&mut self.file.counts),
        };
        let schemas = std::mem::take(&mut self.file.schemas);
        self.group(op::SCHEMA, &schemas, |to, (header, data)| schema(to, header, data))?;
        let channels = std::mem::take(&mut self.file.channels);
        self.group(op::CHANNEL, &channels, content)?;
        self.group(op::STATISTICS, &[statistics], content)?;
        let chunks = std::mem::take(&mut self.file.chunks);
        self.group(op::CHUNK_INDEX, &chunks, content)?;
        let metadata = std::mem::take(&mut self.file.metadata);
        self.group(op::METADATA_INDEX, &metadata, content)
    }

    /// Records of one kind.
    fn group<T>(
        &mut self,
        group_opcode: u8,
        all: &[T],
        write: fn(&mut Vec<u8>, &T) -> io::Result<()>,
    ) -> io::Result<()> {
        let group_start = self.file.sink.len();
        for one in all {
            self.file.put(group_opcode, |to| write(to, one))?;
            self.sum.update(&self.file.scratch);
        }
        let group_length = self.file.sink.len() - group_start;
        if group_length > 0 {
            self.groups.push(SummaryOffset { group_opcode, group_start, group_length });
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "mcap_file_tests.rs"]
mod tests;
