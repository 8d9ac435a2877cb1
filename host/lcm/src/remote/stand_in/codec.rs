//! Messages between two stand-ins.
//!
//! Each begins with its link (connection and epoch), numbers are little-endian, and what is longest comes
//! last. Times are of the sender's clock. Invariant: nothing is read beyond a message's end.

use trocar_net::line::Outbox;

/// Kinds of messages. Their numbers are what is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum Kind {
    /// [`super::super::words::Words`].
    Words = 1,
    /// The receiver of samples, or of calls and their answers, is ready.
    Ready = 2,
    /// A plain sample: number, stamp, when it came; its bytes.
    Sample = 3,
    /// A frame: number, stamp, when it came, bytes of its header; header and bytes.
    Frame = 4,
    /// A command: token, time, index, kind; its argument.
    Command = 5,
    /// Counts of commands: those that the server has taken out of its queue, and those that have come there.
    Took = 6,
    /// An answer: token, outcome, bytes of the value; value and sentence.
    Answer = 7,
    /// An event: index; its payload.
    Event = 8,
    /// A row of a read's results: stamp, tick, index; its bytes.
    Result = 9,
    /// A row of a read's sentences, likewise.
    Why = 10,
    /// The state of the server.
    Standing = 11,
    /// The client's connection was cut, and every command that it sent has been sent before.
    Left = 12,
}

impl Kind {
    pub(in super::super) fn of(number: u8) -> Option<Kind> {
        use Kind::*;
        let all = [Words, Ready, Sample, Frame, Command, Took, Answer, Event, Result, Why, Standing, Left];
        all.into_iter().find(|kind| *kind as u8 == number)
    }

    /// Tells whether it is a sample of a stream.
    pub(super) fn is_sample(self) -> bool {
        matches!(self, Kind::Sample | Kind::Frame)
    }
}

/// A link: its connection, and which of that connection's links it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct Link {
    pub(in super::super) connection: u64,
    pub(in super::super) epoch: u64,
}

/// The content of a message of this link.
pub(super) fn content(link: Link, fill: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut bytes = Vec::new();
    head(link, &mut bytes);
    fill(&mut bytes);
    bytes
}

fn head(link: Link, bytes: &mut Vec<u8>) {
    put(bytes, [link.connection, link.epoch]);
}

/// Appends a message of this link.
pub(super) fn message(out: &mut Outbox, link: Link, kind: Kind, fill: impl FnOnce(&mut Vec<u8>)) {
    out.message(kind as u8, |bytes| {
        head(link, bytes);
        fill(bytes);
    });
}

/// Appends numbers.
pub(super) fn put<const N: usize>(bytes: &mut Vec<u8>, numbers: [u64; N]) {
    numbers.iter().for_each(|number| bytes.extend_from_slice(&number.to_le_bytes()));
}

pub(super) fn put_short<const N: usize>(bytes: &mut Vec<u8>, numbers: [u32; N]) {
    numbers.iter().for_each(|number| bytes.extend_from_slice(&number.to_le_bytes()));
}

/// Appends a message to a state ([`super::StandIn::state`]).
pub(super) fn state_of(state: &mut Vec<u8>, kind: Kind, content: &[u8]) {
    put_short(state, [content.len() as u32]);
    state.push(kind as u8);
    state.extend_from_slice(content);
}

/// The rest of a message.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Take<'a>(&'a [u8]);

impl<'a> Take<'a> {
    pub(in super::super) fn new(bytes: &'a [u8]) -> Take<'a> {
        Take(bytes)
    }

    fn chunk<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (chunk, rest) = self.0.split_first_chunk().ok_or("a message that ends too early")?;
        self.0 = rest;
        Ok(*chunk)
    }

    pub(in super::super) fn u64(&mut self) -> Result<u64, String> {
        self.chunk().map(u64::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, String> {
        self.chunk().map(u32::from_le_bytes)
    }

    pub(super) fn bytes(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (bytes, rest) = self.0.split_at_checked(count).ok_or("a message that ends too early")?;
        self.0 = rest;
        Ok(bytes)
    }

    pub(super) fn rest(self) -> &'a [u8] {
        self.0
    }

    /// The next message of a state.
    pub(super) fn message(&mut self) -> Result<Option<(Kind, Take<'a>)>, String> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let length = self.u32()? as usize;
        let [kind] = self.chunk()?;
        let kind = Kind::of(kind).ok_or("a message of no kind")?;
        Ok(Some((kind, Take(self.bytes(length)?))))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn a_state_is_read_as_it_was_written_and_never_beyond_its_end() {
        let mut state = Vec::new();
        state_of(&mut state, Kind::Standing, &7_u64.to_le_bytes());
        state_of(&mut state, Kind::Why, b"");
        let mut take = Take::new(&state);
        let (kind, mut content) = take.message().unwrap().unwrap();
        assert_eq!((kind, content.u64().unwrap(), content.rest()), (Kind::Standing, 7, &[][..]));
        assert_eq!(take.message().unwrap().unwrap().0, Kind::Why);
        assert!(take.message().unwrap().is_none());
        for end in 1..state.len() {
            let mut take = Take::new(&state[..end]);
            while let Ok(Some(_)) = take.message() {}
        }
        assert!(Take::new(&[255, 255, 255, 255, 1]).message().is_err());
    }

    #[test]
    fn every_kind_has_its_number() {
        let known: Vec<Kind> = (0..=255).filter_map(Kind::of).collect();
        assert_eq!((known.len(), known[0], known[10]), (12, Kind::Words, Kind::Standing));
    }
}
