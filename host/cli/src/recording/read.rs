//! An MCAP file from its first byte to its last good one.
//!
//! Invariant: no more memory is asked for than the file has bytes. Where a file is cut off or damaged,
//! everything before that place is given, and the place is told. A chunk gives nothing when its checksum does
//! not fit its bytes.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::{self, BufReader};
use std::path::Path;
use std::sync::Arc;

use mcap::records::{MessageHeader, op};

use super::fields::{Fields, Statistics, fields};
use super::records::{Broken, Chunk, Records, split};
use crate::failure::Failure;
use crate::units;

/// Bytes that are read at once.
const AT_ONCE: usize = 256 << 10;

/// A channel of the file.
#[derive(Clone, Debug, Default)]
pub(super) struct Channel {
    pub(super) topic: String,
    pub(super) encoding: String,
    /// Channels of one type share it.
    pub(super) schema: Arc<Schema>,
}

/// The description of a type.
#[derive(Debug, Default)]
pub(super) struct Schema {
    /// Counts the descriptions of the file; 0 is that of a channel without one.
    pub(super) number: usize,
    pub(super) name: String,
    pub(super) encoding: String,
    pub(super) data: Vec<u8>,
}

/// Receiver of a file's messages while it is read.
pub(super) trait Takes {
    /// Takes a message of a channel whose record came before.
    ///
    /// # Errors
    /// Ends the reading.
    fn message(&mut self, channel: &Channel, header: &MessageHeader, data: &[u8]) -> Result<(), Failure>;
    /// Tells that so many bytes were read.
    fn progress(&mut self, _bytes: u64) {}
}

/// Content of the file beside its messages.
#[derive(Clone, Debug, Default)]
pub(super) struct Whole {
    pub(super) profile: String,
    pub(super) library: String,
    pub(super) channels: BTreeMap<u16, Channel>,
    pub(super) metadata: Vec<(String, BTreeMap<String, String>)>,
    pub(super) bytes: u64,
    /// True: the file has its end; else it was cut off or is damaged, and `wrong` says how.
    pub(super) closed: bool,
    pub(super) wrong: String,
    /// Messages of channels that the file does not describe.
    pub(super) strays: u64,
    /// Chunks that gave nothing, since they are compressed or damaged; `wrong` says why.
    pub(super) unread_chunks: u64,
    /// The counts that the file has of itself.
    pub(super) statistics: Option<Statistics>,
    /// The part of the file that was read all the same.
    pub(super) remains: &'static str,
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
    // A recorder keeps its file locked as long as it writes; where nothing can be locked, this is not known.
    let written = matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock));
    let whole = Whole { bytes: there.len(), ..Whole::default() };
    let mut reading =
        Reading { whole, schemas: BTreeMap::new(), described: 0, unread: String::new(), begins_at: 0, takes };
    let mut records = Records::new(BufReader::with_capacity(AT_ONCE, file));
    let known = reading.all(&mut records).map_err(|unread| match unread {
        Unread::Io(why) => refused(&why),
        Unread::Asked(failure) => failure,
    })?;
    let Reading { mut whole, unread, .. } = reading;
    if !known {
        let why = if whole.wrong.is_empty() { "it is empty".to_owned() } else { whole.wrong };
        return Err(Failure::local(
            "NO_RECORDING",
            format!("{shown}: is no MCAP file: {why}"),
            "name a recording (.mcap)",
        ));
    }
    whole.say_wrong(written, records.came(), &unread);
    Ok(whole)
}

const CUT: &str = "the file ends inside of a record: its recorder was ended before it could close it";

/// Why no more is read.
enum Ended {
    Damage(String),
    /// Ended by the receiver of the messages.
    Asked(Failure),
}

/// Why a file gives nothing.
enum Unread {
    Io(io::Error),
    /// Ended by the receiver of the messages.
    Asked(Failure),
}

struct Reading<'a> {
    whole: Whole,
    schemas: BTreeMap<u16, Arc<Schema>>,
    /// Number of descriptions that came.
    described: usize,
    /// Why the first chunk that gave nothing did so.
    unread: String,
    /// The place of the record that is read, B.
    begins_at: u64,
    takes: &'a mut dyn Takes,
}

impl Reading<'_> {
    /// Reads the records up to the end of the file, or to the place where it is damaged; false: there is no
    /// record.
    fn all(&mut self, records: &mut Records<BufReader<File>>) -> Result<bool, Unread> {
        let mut known = false;
        loop {
            let begins_at = records.came();
            let ended = match records.next() {
                Ok(None) => break,
                Ok(Some((opcode, body))) => {
                    known = true;
                    self.begins_at = begins_at;
                    self.record(opcode, body)
                }
                Err(Broken::CutOff { opcode, body }) => {
                    // A chunk that a recorder was about to write has whole messages before the place
                    // where it was cut.
                    let chunk = opcode == Some(op::CHUNK);
                    let inside = if chunk { self.chunk(body, true) } else { Ok(()) };
                    inside.and(Err(Ended::Damage(CUT.to_owned())))
                }
                Err(Broken::NoMagic) => Err(Ended::Damage("it does not begin as one".to_owned())),
                Err(Broken::Io(why)) => return Err(Unread::Io(why)),
            };
            self.takes.progress(records.came());
            match ended {
                Ok(()) if self.whole.closed => {
                    self.whole.closed = records.magic().map_err(Unread::Io)?;
                    break;
                }
                Ok(()) => {}
                Err(Ended::Damage(why)) => {
                    self.whole.wrong = format!("near byte {}: {why}", records.came());
                    break;
                }
                Err(Ended::Asked(failure)) => return Err(Unread::Asked(failure)),
            }
        }
        Ok(known)
    }

    fn record(&mut self, opcode: u8, body: &[u8]) -> Result<(), Ended> {
        if opcode == op::CHUNK {
            return self.chunk(body, false);
        }
        let whole = &mut self.whole;
        match fields(opcode, body).map_err(|why| Ended::Damage(format!("damaged: {why}")))? {
            Fields::Header { profile, library } => {
                (whole.profile, whole.library) = (profile.to_owned(), library.to_owned());
            }
            Fields::Schema { id, name, encoding, data } => self.schema(id, name, encoding, data),
            Fields::Channel { id, schema, topic, encoding } => {
                let schema = self.schemas.get(&schema).cloned().unwrap_or_default();
                let channel = || Channel { topic: topic.to_owned(), encoding: encoding.to_owned(), schema };
                whole.channels.entry(id).or_insert_with(channel);
            }
            Fields::Message { header, data } => match whole.channels.get(&header.channel_id) {
                Some(channel) => self.takes.message(channel, &header, data).map_err(Ended::Asked)?,
                None => whole.strays += 1,
            },
            Fields::Metadata { name, values } => whole.metadata.push((name.to_owned(), values)),
            Fields::Statistics(statistics) => whole.statistics = Some(statistics),
            Fields::Footer => whole.closed = true,
            Fields::Other => {}
        }
        Ok(())
    }

    /// Keeps a description; the summary repeats those that came before, and they stay one.
    fn schema(&mut self, id: u16, name: &str, encoding: &str, data: &[u8]) {
        let same = |known: &Arc<Schema>| {
            (known.name.as_str(), known.encoding.as_str(), &known.data[..]) == (name, encoding, data)
        };
        if self.schemas.get(&id).is_some_and(same) {
            return;
        }
        self.described += 1;
        let (name, encoding, data) = (name.to_owned(), encoding.to_owned(), data.to_vec());
        self.schemas.insert(id, Arc::new(Schema { number: self.described, name, encoding, data }));
    }

    /// Goes on behind a chunk that gives nothing.
    fn leave_out(&mut self, why: impl FnOnce(u64) -> String) {
        self.whole.unread_chunks += 1;
        if self.unread.is_empty() {
            self.unread = why(self.begins_at);
        }
    }

    /// The records of a chunk; of one whose end is missing those that are there.
    fn chunk(&mut self, body: &[u8], cut: bool) -> Result<(), Ended> {
        let damage = |why: &str| Ended::Damage(format!("damaged: {why}"));
        let Some(chunk) = Chunk::of(body) else {
            return Err(damage("a chunk is shorter than its header"));
        };
        if !chunk.compression.is_empty() {
            let name = String::from_utf8_lossy(chunk.compression).chars().take(20).collect::<String>();
            self.leave_out(|_| {
                let help = "`mcap compress --compression none` makes others";
                format!("chunks compressed with {name:?} are not read here: {help}")
            });
            return Ok(());
        }
        let records = match usize::try_from(chunk.len).ok().and_then(|len| chunk.records.get(..len)) {
            Some(records) => records,
            None if cut => chunk.records,
            None => return Err(damage("a chunk is shorter than it says")),
        };
        // The sum is checked before anything in the chunk is believed. The sum of one that was cut off
        // cannot be known.
        if !cut && chunk.crc != 0 && crc32fast::hash(records) != chunk.crc {
            let why = "damaged: a chunk's checksum is another one than that of its bytes";
            self.leave_out(|at| format!("near byte {at}: {why}"));
            return Ok(());
        }
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
        Ok(())
    }
}

impl Whole {
    /// Says all that is wrong with a file of which so many bytes could be read; `written`: a recorder has it
    /// open. `unread`: why the first chunk that gave nothing did so.
    fn say_wrong(&mut self, written: bool, bytes: u64, unread: &str) {
        if !self.closed && written {
            self.wrong = format!("it is being written: this is what is there of it, {bytes} B");
        } else if !self.closed && self.wrong.is_empty() {
            self.wrong = format!(
                "the file ends after {bytes} B without its end: its recorder was ended before it could close it"
            );
        }
        self.remains = if self.wrong.is_empty() { "everything else" } else { "everything before that" };
        let mut all_wrong = Vec::new();
        if self.unread_chunks > 0 {
            all_wrong.push(format!("{} left out: {unread}", units::count(self.unread_chunks, "chunk")));
        }
        if self.strays > 0 {
            let strays = units::count(self.strays, "message");
            all_wrong.push(format!("{strays} left out: the file does not describe their channels"));
        }
        all_wrong.extend(Some(std::mem::take(&mut self.wrong)).filter(|wrong| !wrong.is_empty()));
        self.wrong = all_wrong.join("; ");
    }

    /// Returns all that the last metadata record of a name says.
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
