//! The records of an MCAP file and of its chunks, one after the other. Each length is checked against the
//! bytes there are.
//!
//! Invariant: a length is believed only as far as bytes come for it: no arithmetic on a length can overflow,
//! and no memory is taken ahead.

use std::io::{self, Read};

/// Magic bytes at the beginning and the end of a file.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Opcode and length.
const HEAD: usize = 9;

/// Reads the records of a file in their order.
pub(super) struct Records<R> {
    from: R,
    body: Vec<u8>,
    came: u64,
    begun: bool,
}

/// Why there is no other record.
#[derive(Debug)]
pub(super) enum Broken<'a> {
    NoMagic,
    /// The file ends inside of a record: what is there of its body.
    CutOff {
        opcode: Option<u8>,
        body: &'a [u8],
    },
    Io(io::Error),
}

impl<R: Read> Records<R> {
    pub(super) fn new(from: R) -> Records<R> {
        Records { from, body: Vec::new(), came: 0, begun: false }
    }

    /// Returns the number of bytes read so far.
    pub(super) fn came(&self) -> u64 {
        self.came
    }

    /// The next one's opcode and body; none where the file ends between two.
    ///
    /// # Errors
    /// The file is none, ends inside of one, or cannot be read.
    pub(super) fn next(&mut self) -> Result<Option<(u8, &[u8])>, Broken<'_>> {
        if !self.begun {
            if !self.magic().map_err(Broken::Io)? {
                return Err(Broken::NoMagic);
            }
            self.begun = true;
        }
        self.fill(HEAD as u64).map_err(Broken::Io)?;
        let Some((opcode, len)) = head(&self.body) else {
            let (opcode, body) = (None, &self.body[..]);
            return if body.is_empty() { Ok(None) } else { Err(Broken::CutOff { opcode, body }) };
        };
        self.fill(len).map_err(Broken::Io)?;
        if self.body.len() as u64 == len {
            return Ok(Some((opcode, &self.body)));
        }
        Err(Broken::CutOff { opcode: Some(opcode), body: &self.body })
    }

    /// Tells whether the next bytes are the magic ones.
    ///
    /// # Errors
    /// What the system says.
    pub(super) fn magic(&mut self) -> io::Result<bool> {
        self.fill(MAGIC.len() as u64)?;
        Ok(self.body == MAGIC)
    }

    /// The next so many bytes, or as many as there are.
    fn fill(&mut self, len: u64) -> io::Result<()> {
        self.body.clear();
        let n = self.from.by_ref().take(len).read_to_end(&mut self.body)?;
        self.came = self.came.saturating_add(n as u64);
        Ok(())
    }
}

fn head(bytes: &[u8]) -> Option<(u8, u64)> {
    let (opcode, rest) = bytes.split_first()?;
    Some((*opcode, u64::from_le_bytes(*rest.first_chunk()?)))
}

/// The first record in the bytes of a chunk, and what follows it; none where no whole one is left.
pub(super) fn split(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (opcode, len) = head(bytes)?;
    let (body, rest) = bytes.get(HEAD..)?.split_at_checked(usize::try_from(len).ok()?)?;
    Some((opcode, body, rest))
}

/// A chunk's header, and what follows it.
pub(super) struct Chunk<'a> {
    pub(super) crc: u32,
    pub(super) compression: &'a [u8],
    /// Length of the records, as they are in the file, B.
    pub(super) len: u64,
    pub(super) records: &'a [u8],
}

impl Chunk<'_> {
    /// None where the header is not all there.
    pub(super) fn of(body: &[u8]) -> Option<Chunk<'_>> {
        // The rest is behind two times and the length without compression.
        let rest = body.get(24..)?;
        let (crc, rest) = rest.split_first_chunk()?;
        let (n, rest) = rest.split_first_chunk()?;
        let (compression, rest) = rest.split_at_checked(usize::try_from(u32::from_le_bytes(*n)).ok()?)?;
        let (len, records) = rest.split_first_chunk()?;
        Some(Chunk { crc: u32::from_le_bytes(*crc), compression, len: u64::from_le_bytes(*len), records })
    }
}
