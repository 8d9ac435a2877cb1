//! Blocks on their way from the step to the writer: many messages in one piece of memory that comes back to
//! be filled again. Large frames are not copied into it: they are held until the writer has written them.
//!
//! Invariant: bytes on their way are counted and bounded, those of held frames by the number of frames. A
//! message that does not fit is refused to the step, which counts it.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

use trocar_sdk::HeldFrame;

use crate::orders::Order;

/// A block is sent when it holds so many bytes, or at the end of a step.
const FULL: usize = 256 << 10;
/// A frame of so many bytes is not copied: a copy of less costs less than a write of its own.
pub(crate) const LARGE: usize = 128 << 10;
/// Blocks that wait to be filled again, at most; more are given back to the system.
const SPARE: usize = 32;

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

    fn clear(&mut self) {
        self.bytes.clear();
        self.heads.clear();
        self.held.clear();
    }
}

/// The step's end of the way to the writer.
pub(crate) struct Way {
    orders: Sender<Order>,
    back: Receiver<Block>,
    under_way: Arc<AtomicU64>,
    spare: Arc<AtomicUsize>,
    limit: u64,
    block: Block,
}

/// The writer's end.
pub(crate) struct Returns {
    back: Sender<Block>,
    under_way: Arc<AtomicU64>,
    spare: Arc<AtomicUsize>,
}

/// Both ends; `limit` bytes may be on their way.
pub(crate) fn way(limit: u64) -> (Way, Receiver<Order>, Returns) {
    let ((orders, received), (back, returned)) = (channel(), channel());
    let (under_way, spare) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicUsize::new(0)));
    let returns = Returns { back, under_way: under_way.clone(), spare: spare.clone() };
    let way = Way { orders, back: returned, under_way, spare, limit, block: Block::default() };
    (way, received, returns)
}

impl Way {
    /// Whether `bytes` more fit.
    pub(crate) fn has_room(&self, bytes: usize) -> bool {
        let waiting = self.under_way.load(Ordering::Relaxed) + self.block.len() as u64;
        waiting.saturating_add(bytes as u64) <= self.limit
    }

    /// Tells whether `bytes` of a frame fit. The last quarter is for small messages: no frame that waits for
    /// a slow disk costs a row, an event or a marker.
    pub(crate) fn has_room_for_frame(&self, bytes: usize) -> bool {
        self.has_room(bytes.saturating_add((self.limit / 4) as usize))
    }

    /// Whether nothing is on its way.
    pub(crate) fn is_clear(&self) -> bool {
        self.under_way.load(Ordering::Relaxed) == 0 && self.block.is_empty()
    }

    /// The block that is being filled.
    pub(crate) fn block(&mut self) -> &mut Block {
        if self.block.len() >= FULL {
            self.send();
        }
        &mut self.block
    }

    /// Hands over the open block.
    pub(crate) fn send(&mut self) {
        if self.block.is_empty() {
            return;
        }
        let fresh = match self.back.try_recv() {
            Ok(block) => {
                self.spare.fetch_sub(1, Ordering::Relaxed);
                block
            }
            Err(_) => Block::default(),
        };
        let full = std::mem::replace(&mut self.block, fresh);
        self.under_way.fetch_add(full.len() as u64, Ordering::Relaxed);
        // A writer that is gone says so with its thread's end.
        let _ = self.orders.send(Order::Block(full));
    }

    /// Something else for the writer, behind all that was pushed before.
    pub(crate) fn order(&mut self, order: Order) {
        self.send();
        let _ = self.orders.send(order);
    }
}

impl Returns {
    /// A block has arrived; from now on its bytes are the writer's to bound.
    pub(crate) fn arrived(&self, block: &Block) {
        self.under_way.fetch_sub(block.len() as u64, Ordering::Relaxed);
    }

    /// Gives a block back to be filled again.
    pub(crate) fn give(&mut self, mut block: Block) {
        // Blocks beyond these, which a burst added, are given back to the system.
        if self.spare.load(Ordering::Relaxed) < SPARE {
            self.spare.fetch_add(1, Ordering::Relaxed);
            block.clear();
            let _ = self.back.send(block);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_pushed_arrives_in_order_and_the_way_is_bounded() {
        let (mut way, received, mut returns) = way(1000);
        assert!(way.has_room(900) && !way.has_room(1001));
        for n in 0..3u8 {
            way.block().push((7, u64::from(n), 1, 2), Kind::Ready, |to| to.extend([n; 200]));
        }
        way.send();
        assert!(!way.has_room(500), "it is on its way");
        assert!(way.has_room(10) && !way.has_room_for_frame(10), "the last quarter is not for frames");
        let Ok(Order::Block(block)) = received.try_recv() else { panic!("a block") };
        let seen: Vec<(u64, u8, usize)> =
            block.messages().map(|(h, [b, _])| (h.seq, b[0], b.len())).collect();
        assert_eq!(seen[0], (0, 0, 200));
        returns.arrived(&block);
        returns.give(block);
        assert!(way.has_room(900));
        way.block().push((7, 9, 1, 2), Kind::Ready, |to| to.push(1));
        way.send();
        assert!(way.back.try_recv().is_err(), "the one that came back is filled again");
    }

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
