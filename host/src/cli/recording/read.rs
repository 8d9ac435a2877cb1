//! An MCAP file from its first byte to its last good one.
//!
//! Invariant: no more memory is asked for than the file has bytes; where a file is cut off or damaged, everything before
//! that place is given, and the place is told.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use mcap::McapError;
use mcap::records::{MessageHeader, Record};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::cli::failure::Failure;

/// Bytes that are read at once, at least.
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
    let mut file = File::open(path).map_err(|e| refused(&e))?;
    let there = file.metadata().map_err(|e| refused(&e))?;
    if !there.is_file() {
        return Err(refused(&"it is no file"));
    }
    let len = there.len();
    let limit = usize::try_from(len).unwrap_or(usize::MAX);
    let options =
        LinearReaderOptions::default().with_validate_chunk_crcs(true).with_record_length_limit(limit.max(64));
    let mut reader = LinearReader::new_with_options(options);
    let mut whole = Whole { bytes: len, ..Whole::default() };
    let mut schemas: BTreeMap<u16, (String, String, Vec<u8>)> = BTreeMap::new();
    let mut came = 0u64;
    let mut known = false;
    loop {
        let event = match reader.next_event() {
            None => break,
            Some(Ok(event)) => event,
            Some(Err(why)) => {
                whole.wrong = told(&why, came);
                break;
            }
        };
        match event {
            LinearReadEvent::ReadRequest(need) => {
                // A length that is longer than the rest of the file is a lie, or its end is missing.
                let rest = len.saturating_sub(came);
                if need as u64 > rest.max(AT_ONCE as u64) {
                    whole.wrong =
                        format!("the file ends after {came} B inside of a record that needs {need} B more");
                    break;
                }
                let room =
                    reader.insert(need.max(AT_ONCE.min(usize::try_from(rest).unwrap_or(AT_ONCE)).max(1)));
                let n = file.read(room).map_err(|e| refused(&e))?;
                came += n as u64;
                reader.notify_read(n);
                takes.progress(came);
            }
            LinearReadEvent::Record { data, opcode } => {
                let record = match mcap::parse_record(opcode, data) {
                    Ok(record) => record,
                    Err(why) => {
                        whole.wrong = told(&why, came);
                        break;
                    }
                };
                known = true;
                match record {
                    Record::Header(header) => {
                        (whole.profile, whole.library) = (header.profile, header.library);
                    }
                    Record::Schema { header, data } => {
                        schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
                    }
                    Record::Channel(channel) => {
                        let (schema, schema_encoding, schema_data) =
                            schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                        whole.channels.entry(channel.id).or_insert(Channel {
                            topic: channel.topic,
                            encoding: channel.message_encoding,
                            schema,
                            schema_encoding,
                            schema_data,
                        });
                    }
                    Record::Message { header, data } => match whole.channels.get(&header.channel_id) {
                        Some(channel) => takes.message(channel, &header, &data)?,
                        None => whole.strays += 1,
                    },
                    Record::Metadata(metadata) => whole.metadata.push((metadata.name, metadata.metadata)),
                    Record::Footer(_) => whole.closed = true,
                    _ => {}
                }
            }
        }
    }
    if !known {
        let why = if whole.wrong.is_empty() { "it is empty".to_owned() } else { whole.wrong };
        return Err(Failure::local(
            "NO_RECORDING",
            format!("{shown}: is no MCAP file: {why}"),
            "name a recording (.mcap)",
        ));
    }
    if !whole.closed && whole.wrong.is_empty() {
        whole.wrong = format!(
            "the file ends after {came} B without its end: its recorder was ended before it could close it"
        );
    }
    Ok(whole)
}

fn told(why: &McapError, at: u64) -> String {
    match why {
        McapError::UnexpectedEof | McapError::UnexpectedEoc => {
            format!(
                "the file ends after {at} B inside of a record: its recorder was ended before it could close it"
            )
        }
        McapError::UnsupportedCompression(name) => {
            format!(
                "chunks compressed with {name} are not read here: `mcap compress --compression none` makes others"
            )
        }
        other => format!("damaged near byte {at}: {other}"),
    }
}

impl Whole {
    /// A metadata record's value.
    pub(super) fn told(&self, name: &str, key: &str) -> Option<&str> {
        let record = self.metadata.iter().rev().find(|(other, _)| other == name)?;
        record.1.get(key).map(String::as_str)
    }
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
