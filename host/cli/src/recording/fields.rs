//! The fields of a record, as far as they are needed here.
//!
//! Invariant: no memory is taken for a length before its bytes are there; names are bounded by [`NAME`].

use std::collections::BTreeMap;

use mcap::records::{MessageHeader, op};

/// Longest name of a type or an encoding, B: a file may have 65 535 channels that repeat it.
const NAME: usize = 4 << 10;

/// A record that is needed here.
pub(super) enum Fields<'a> {
    Header {
        profile: &'a str,
        library: &'a str,
    },
    Schema {
        id: u16,
        name: &'a str,
        encoding: &'a str,
        data: &'a [u8],
    },
    Channel {
        id: u16,
        schema: u16,
        topic: &'a str,
        encoding: &'a str,
    },
    Message {
        header: MessageHeader,
        data: &'a [u8],
    },
    Metadata {
        name: &'a str,
        values: BTreeMap<String, String>,
    },
    Statistics(Statistics),
    Footer,
    /// Indexes and attachments: nothing of them is read, so nothing in them can be wrong.
    Other,
}

/// The counts that a file has of itself, compressed or not.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Statistics {
    pub(super) messages: u64,
    /// ns of the recorder's clock.
    pub(super) first_ns: u64,
    pub(super) last_ns: u64,
    pub(super) of_channel: BTreeMap<u16, u64>,
}

/// Reads a record.
///
/// # Errors
/// Why it is none.
pub(super) fn fields(opcode: u8, body: &[u8]) -> Result<Fields<'_>, String> {
    let mut rest = Rest(body);
    let read = match opcode {
        op::HEADER => header(&mut rest),
        op::SCHEMA => schema(&mut rest),
        op::CHANNEL => channel(&mut rest),
        op::MESSAGE => message(&mut rest),
        op::METADATA => metadata(&mut rest),
        op::STATISTICS => statistics(&mut rest).map(Fields::Statistics),
        op::FOOTER => rest.array::<20>().map(|_| Fields::Footer),
        _ => Ok(Fields::Other),
    };
    read.map_err(|why| format!("record {opcode:#04x} of {} B: {why}", body.len()))
}

fn header<'a>(rest: &mut Rest<'a>) -> Result<Fields<'a>, String> {
    Ok(Fields::Header { profile: rest.text()?, library: rest.text()? })
}

fn schema<'a>(rest: &mut Rest<'a>) -> Result<Fields<'a>, String> {
    let (id, name, encoding) = (rest.u16()?, rest.name()?, rest.name()?);
    Ok(Fields::Schema { id, name, encoding, data: rest.block()? })
}

fn channel<'a>(rest: &mut Rest<'a>) -> Result<Fields<'a>, String> {
    let (id, schema) = (rest.u16()?, rest.u16()?);
    Ok(Fields::Channel { id, schema, topic: rest.text()?, encoding: rest.name()? })
}

fn message<'a>(rest: &mut Rest<'a>) -> Result<Fields<'a>, String> {
    let (channel_id, sequence) = (rest.u16()?, rest.u32()?);
    let (log_time, publish_time) = (rest.u64()?, rest.u64()?);
    let header = MessageHeader { channel_id, sequence, log_time, publish_time };
    Ok(Fields::Message { header, data: rest.0 })
}

fn metadata<'a>(rest: &mut Rest<'a>) -> Result<Fields<'a>, String> {
    let name = rest.text()?;
    let mut pairs = Rest(rest.block()?);
    let mut values = BTreeMap::new();
    while !pairs.0.is_empty() {
        values.insert(pairs.text()?.to_owned(), pairs.text()?.to_owned());
    }
    Ok(Fields::Metadata { name, values })
}

fn statistics(rest: &mut Rest<'_>) -> Result<Statistics, String> {
    let messages = rest.u64()?;
    // Numbers of schemas, channels, attachments, metadata records and chunks.
    rest.array::<18>()?;
    let (first_ns, last_ns) = (rest.u64()?, rest.u64()?);
    let mut pairs = Rest(rest.block()?);
    let mut of_channel = BTreeMap::new();
    while !pairs.0.is_empty() {
        of_channel.insert(pairs.u16()?, pairs.u64()?);
    }
    Ok(Statistics { messages, first_ns, last_ns, of_channel })
}

/// The bytes of a record that are not read yet.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (head, rest) =
            self.0.split_first_chunk().ok_or_else(|| "it ends inside of a field".to_owned())?;
        self.0 = rest;
        Ok(*head)
    }

    fn u16(&mut self) -> Result<u16, String> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, String> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind their length.
    fn block(&mut self) -> Result<&'a [u8], String> {
        let len = self.u32()?;
        let there = self.0.len();
        let split = usize::try_from(len).ok().and_then(|len| self.0.split_at_checked(len));
        let (block, rest) = split.ok_or_else(|| format!("a field says {len} B, and {there} B follow"))?;
        self.0 = rest;
        Ok(block)
    }

    fn text(&mut self) -> Result<&'a str, String> {
        std::str::from_utf8(self.block()?).map_err(|_| "a text is not UTF-8".to_owned())
    }

    fn name(&mut self) -> Result<&'a str, String> {
        let name = self.text()?;
        let over = || format!("a name of {} B is over the limit of {NAME} B", name.len());
        if name.len() <= NAME { Ok(name) } else { Err(over()) }
    }
}
