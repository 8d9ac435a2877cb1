//! An MCAP file from its first byte to its last good one.
//!
//! Invariant: no more memory is asked for than the file has bytes; where a file is cut off or damaged, everything before
//! that place is given, and the place is told.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::BufReader;
use std::path::Path;

use mcap::McapError;
use mcap::records::{MessageHeader, Record, op};

use super::records::{Broken, Chunk, Records, split};
use crate::cli::failure::Failure;

/// Bytes that are read at once.
const AT_ONCE: usize = 256 << 10;

/// A channel of the file.
#[derive(Clone, Debug, Default)]
pub(super) struct Channel {
    pub(super) topic: String,
    pub(super) encoding: String,
    pub(super) schema: String,
    pub(super) schema_encoding: String,
    pub(super) schema_data: Vec<u8>,
}

/// What is told of a file while it is read.
pub(super) trait Takes {
    /// A message of a channel whose record came before.
    ///
    /// # Errors
    /// Ends the reading.
    fn message(&mut self, channel: &Channel, header: &MessageHeader, data: &[u8]) -> Result<(), Failure>;
    /// So many bytes were read.
    fn progress(&mut self, _bytes: u64) {}
}

/// What stands in the file beside its messages.
#[derive(Clone, Debug, Default)]
pub(super) struct Whole {
    pub(super) profile: String,
    pub(super) library: String,
    pub(super) channels: BTreeMap<u16, Channel>,
    pub(super) metadata: Vec<(String, BTreeMap<String, String>)>,
    pub(super) bytes: u64,
    /// It has its end; else it was cut off or is damaged, and `wrong` says how.
    pub(super) closed: bool,
    pub(super) wrong: String,
    /// Messages of channels that the file does not describe.
    pub(super) strays: u64,
}

/// Reads all of it.
///
/// # Errors
/// The file cannot be opened or is none of this kind, or `takes` ends it.
pub(super) fn read(path: &Path, takes: &mut dyn Takes) -> Result<Whole, Failure> {
    let shown = path.display();
    let refused = |why: &dyn std::fmt::Display| {
        Failure::local("IO", format!("{shown}: cannot be read: {why}"), "name a recording (.mcap)")
    };
    let file = File::open(path).map_err(|e| refused(&e))?;
    let there = file.metadata().map_err(|e| refused(&e))?;
    if !there.is_file() {
        return Err(refused(&"it is no file"));
    }
    // A recorder keeps its file locked as long as it writes; where nothing can be locked, nobody knows.
    let written = matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock));
    let mut reading =
        Reading { whole: Whole { bytes: there.len(), ..Whole::default() }, schemas: BTreeMap::new(), takes };
    let mut records = Records::new(BufReader::with_capacity(AT_ONCE, file));
    let mut known = false;
    loop {
        let ended = match records.next() {
            Ok(None) => break,
            Ok(Some((opcode, body))) => {
                known = true;
                reading.record(opcode, body)
            }
            Err(Broken::CutOff { opcode, body }) => {
                // What a recorder was about to write has whole messages before the place where it was cut.
                let chunk = opcode == Some(op::CHUNK);
                let inside = if chunk { reading.chunk(body, true) } else { Ok(()) };
                inside.and(Err(Ended::Damage(CUT.to_owned())))
            }
            Err(Broken::NoMagic) => Err(Ended::Damage("it does not begin as one".to_owned())),
            Err(Broken::Io(why)) => return Err(refused(&why)),
        };
        reading.takes.progress(records.came());
        match ended {
            Ok(()) if reading.whole.closed => {
                reading.whole.closed = records.magic().map_err(|e| refused(&e))?;
                break;
            }
            Ok(()) => {}
            Err(Ended::Damage(why)) => {
                reading.whole.wrong = format!("near byte {}: {why}", records.came());
                break;
            }
            Err(Ended::Asked(failure)) => return Err(failure),
        }
    }
    let mut whole = reading.whole;
    if !known {
        let why = if whole.wrong.is_empty() { "it is empty".to_owned() } else { whole.wrong };
        return Err(Failure::local(
            "NO_RECORDING",
            format!("{shown}: is no MCAP file: {why}"),
            "name a recording (.mcap)",
        ));
    }
    if !whole.closed && written {
        whole.wrong = format!("it is being written: this is what is there of it, {} B", records.came());
    } else if !whole.closed && whole.wrong.is_empty() {
        whole.wrong = format!(
            "the file ends after {} B without its end: its recorder was ended before it could close it",
            records.came()
        );
    }
    Ok(whole)
}

const CUT: &str = "the file ends inside of a record: its recorder was ended before it could close it";

/// Why no more is read.
enum Ended {
    Damage(String),
    /// By whoever takes the messages.
    Asked(Failure),
}

impl From<McapError> for Ended {
    fn from(why: McapError) -> Ended {
        Ended::Damage(format!("damaged: {why}"))
    }
}

struct Reading<'a> {
    whole: Whole,
    schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    takes: &'a mut dyn Takes,
}

impl Reading<'_> {
    fn record(&mut self, opcode: u8, body: &[u8]) -> Result<(), Ended> {
        // Indexes and attachments are not needed here: what is not parsed cannot be wrong.
        let needed = [op::HEADER, op::FOOTER, op::SCHEMA, op::CHANNEL, op::MESSAGE, op::METADATA];
        if opcode == op::CHUNK {
            return self.chunk(body, false);
        }
        if !needed.contains(&opcode) {
            return Ok(());
        }
        let whole = &mut self.whole;
        match mcap::parse_record(opcode, body)? {
            Record::Header(header) => (whole.profile, whole.library) = (header.profile, header.library),
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Record::Channel(channel) => {
                let (schema, schema_encoding, schema_data) =
                    self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                whole.channels.entry(channel.id).or_insert(Channel {
                    topic: channel.topic,
                    encoding: channel.message_encoding,
                    schema,
                    schema_encoding,
                    schema_data,
                });
            }
            Record::Message { header, data } => match whole.channels.get(&header.channel_id) {
                Some(channel) => self.takes.message(channel, &header, &data).map_err(Ended::Asked)?,
                None => whole.strays += 1,
            },
            Record::Metadata(metadata) => whole.metadata.push((metadata.name, metadata.metadata)),
            Record::Footer(_) => whole.closed = true,
            _ => {}
        }
        Ok(())
    }

    /// The records of a chunk; of one whose end is missing those that are there.
    fn chunk(&mut self, body: &[u8], cut: bool) -> Result<(), Ended> {
        let damage = |why: &str| Ended::Damage(format!("damaged: {why}"));
        let Some(chunk) = Chunk::of(body) else {
            return Err(damage("a chunk is shorter than its header"));
        };
        if !chunk.compression.is_empty() {
            let name = String::from_utf8_lossy(chunk.compression).chars().take(20).collect::<String>();
            return Err(Ended::Damage(format!(
                "chunks compressed with {name:?} are not read here: `mcap compress --compression none` makes others"
            )));
        }
        let records = match usize::try_from(chunk.len).ok().and_then(|len| chunk.records.get(..len)) {
            Some(records) => records,
            None if cut => chunk.records,
            None => return Err(damage("a chunk is shorter than it says")),
        };
        let mut rest = records;
        while let Some((opcode, body, after)) = split(rest) {
            // A chunk in a chunk is nothing that the format knows.
            if opcode != op::CHUNK {
                self.record(opcode, body)?;
            }
            rest = after;
        }
        if !rest.is_empty() && !cut {
            return Err(damage("a record is longer than its chunk"));
        }
        if !cut && chunk.crc != 0 && crc32fast::hash(records) != chunk.crc {
            return Err(damage("a chunk's checksum is another one than that of its bytes"));
        }
        Ok(())
    }
}

impl Whole {
    /// All that the last metadata record of a name says.
    pub(super) fn all(&self, name: &str) -> impl Iterator<Item = (&str, &str)> {
        let record = self.metadata.iter().rev().find(|(other, _)| other == name);
        record.into_iter().flat_map(|(_, all)| all).map(|(key, value)| (key.as_str(), value.as_str()))
    }

    /// A metadata record's value.
    pub(super) fn told(&self, name: &str, key: &str) -> Option<&str> {
        let record = self.metadata.iter().rev().find(|(other, _)| other == name)?;
        record.1.get(key).map(String::as_str)
    }
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
