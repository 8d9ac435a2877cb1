//! The way of blocks and orders from the step to the writer, on which blocks come back to be filled again.
//!
//! Invariant: bytes on their way are counted and bounded, those of held frames by the number of frames. A
//! message that does not fit is refused to the step, which counts it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

use crate::block::Block;
use crate::orders::Order;

/// A block is sent when it holds so many bytes, or at the end of a step.
const FULL: usize = 256 << 10;
/// Blocks that wait to be filled again, at most; more are given back to the system.
const SPARE: usize = 32;

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
    use crate::block::Kind;

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
}
