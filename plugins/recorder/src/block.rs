//! Blocks: many messages in one piece of memory. Large frames are not copied into it: they are held until the
//! writer has written them.
//!
//! Invariant: a message is whole; its bytes are in the block, in a held frame, or in both, one after the
//! other.

use std::ops::Range;
use std::sync::Arc;

use trocar_sdk::HeldFrame;

/// A frame of so many bytes is not copied: a copy of less costs less than a write of its own.
pub(crate) const LARGE: usize = 128 << 10;
/// Work that is still to be done with a message's bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    /// Written as they are.
    Ready,
    /// Pixels, to be compressed first.
    Pixels { width: u32, height: u32, stride: u32, encoding: &'static str },
}

/// One message of a block.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Head {
    /// Which channel, as the step counts them.
    pub(crate) channel: u32,
    /// The source's count.
    pub(crate) seq: u64,
    /// When it was taken, ns.
    pub(crate) log_ns: u64,
    /// When it was acquired, ns.
    pub(crate) publish_ns: u64,
    at: usize,
    len: usize,
    /// Part of a held frame that follows: which frame, and where.
    rest: Option<(usize, usize, usize)>,
    pub(crate) kind: Kind,
}

/// A frame that is not filled anew until its messages were written.
#[derive(Debug)]
pub(crate) struct HeldPart {
    frame: Frame,
    /// Its strong count is the number of holders.
    _one: Arc<()>,
}

#[derive(Debug)]
enum Frame {
    Held(HeldFrame),
    #[cfg(test)]
    Here(Vec<u8>),
}

impl HeldPart {
    pub(crate) fn new(frame: HeldFrame, one: Arc<()>) -> HeldPart {
        HeldPart { frame: Frame::Held(frame), _one: one }
    }

    #[cfg(test)]
    pub(crate) fn here(bytes: Vec<u8>) -> HeldPart {
        HeldPart { frame: Frame::Here(bytes), _one: Arc::default() }
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        match &self.frame {
            Frame::Held(frame) => frame.bytes(),
            #[cfg(test)]
            Frame::Here(bytes) => bytes,
        }
    }
}

/// Bytes of a frame that end a message.
pub(crate) enum Piece<'a> {
    Copied(&'a [u8]),
    Held(Arc<HeldPart>, Range<usize>),
}

/// Messages, one after the other.
#[derive(Debug, Default)]
pub(crate) struct Block {
    bytes: Vec<u8>,
    heads: Vec<Head>,
    held: Vec<Arc<HeldPart>>,
}

impl Block {
    pub(crate) fn len(&self) -> usize {
        self.bytes.len() + self.heads.len() * size_of::<Head>()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.heads.is_empty()
    }

    /// Each in two parts, of which the second lies in a frame that is held.
    pub(crate) fn messages(&self) -> impl Iterator<Item = (&Head, [&[u8]; 2])> {
        self.heads.iter().map(|head| {
            let rest = head.rest.map(|(which, at, len)| &self.held[which].bytes()[at..at + len]);
            (head, [&self.bytes[head.at..head.at + head.len], rest.unwrap_or_default()])
        })
    }

    /// Returns the time of the last message, ns.
    pub(crate) fn newest_ns(&self) -> u64 {
        self.heads.last().map_or(0, |head| head.log_ns)
    }

    /// Appends a message whose bytes `write` appends: how long it is.
    pub(crate) fn push(
        &mut self,
        head: (u32, u64, u64, u64),
        kind: Kind,
        write: impl FnOnce(&mut Vec<u8>),
    ) -> usize {
        self.push_with(head, kind, write, Piece::Copied(&[]))
    }

    /// The same, with a piece of a frame behind those bytes.
    pub(crate) fn push_with(
        &mut self,
        (channel, seq, log_ns, publish_ns): (u32, u64, u64, u64),
        kind: Kind,
        write: impl FnOnce(&mut Vec<u8>),
        piece: Piece<'_>,
    ) -> usize {
        let at = self.bytes.len();
        write(&mut self.bytes);
        let rest = match piece {
            Piece::Copied(bytes) => {
                self.bytes.extend_from_slice(bytes);
                None
            }
            Piece::Held(part, range) => {
                self.held.push(part);
                Some((self.held.len() - 1, range.start, range.len()))
            }
        };
        let len = self.bytes.len() - at;
        self.heads.push(Head { channel, seq, log_ns, publish_ns, at, len, rest, kind });
        len + rest.map_or(0, |(.., len)| len)
    }

    /// Copies what lies in frames, for it may stay for long.
    pub(crate) fn copy_held(&mut self) {
        for head in &mut self.heads {
            let Some((which, at, len)) = head.rest.take() else { continue };
            let begins = self.bytes.len();
            self.bytes.extend_from_within(head.at..head.at + head.len);
            self.bytes.extend_from_slice(&self.held[which].bytes()[at..at + len]);
            (head.at, head.len) = (begins, head.len + len);
        }
        self.held.clear();
    }

    pub(crate) fn clear(&mut self) {
        self.bytes.clear();
        self.heads.clear();
        self.held.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_held_as_long_as_their_block_and_copied_when_it_stays() {
        let mut block = Block::default();
        let part = Arc::new(HeldPart::here((0..100).collect()));
        let whole =
            |block: &Block| -> Vec<Vec<u8>> { block.messages().map(|(_, parts)| parts.concat()).collect() };
        let len = block.push((1, 1, 1, 1), Kind::Ready, |to| to.extend([7; 3]));
        assert_eq!(len, 3);
        for range in [10..13, 50..52] {
            let piece = Piece::Held(part.clone(), range.clone());
            let len = block.push_with((1, 2, 1, 1), Kind::Ready, |to| to.push(range.start as u8), piece);
            assert_eq!(len, 1 + range.len());
        }
        block.push_with((1, 3, 1, 1), Kind::Ready, |to| to.push(9), Piece::Copied(&[1, 2]));
        let wanted = [vec![7, 7, 7], vec![10, 10, 11, 12], vec![50, 50, 51], vec![9, 1, 2]];
        assert_eq!((whole(&block), Arc::strong_count(&part)), (wanted.to_vec(), 3));
        block.copy_held();
        assert_eq!((whole(&block), Arc::strong_count(&part)), (wanted.to_vec(), 1));
        block.push_with((1, 4, 1, 1), Kind::Ready, |_| (), Piece::Held(part.clone(), 0..1));
        block.clear();
        assert_eq!((block.len(), Arc::strong_count(&part)), (0, 1));
    }
}
