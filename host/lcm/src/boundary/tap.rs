//! Samples of taps: one for each row, event and command, to every connected reader.
//!
//! Invariant: a tap never waits and changes nothing for its component: no outcome, no count. Until a reader
//! is connected for the first time it costs one relaxed load.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use trocar_loader::taps::{HEAD, MOST};
use trocar_plugin_api::abi::Outcome;
use trocar_rt::os;
use trocar_rt::stream::Meta;

use super::super::pending;
use super::inside::runs_kept;
use super::late;
use super::output::OutCell;

/// The tap of an event.
#[derive(Clone)]
pub(crate) struct EventTap {
    pub(crate) cell: Arc<OutCell>,
    /// ABI id of the event.
    pub(crate) which: u32,
}

/// The tap of an instance's commands.
#[derive(Clone)]
pub(crate) struct CommandTap {
    pub(crate) cell: Arc<OutCell>,
    /// Bytes of the argument of each command, by ABI id.
    pub(crate) arg_bytes: Arc<[usize]>,
}

impl EventTap {
    /// Any thread. Real-time.
    #[inline(always)]
    pub(super) fn tell(&self, payload: &[u8]) {
        if self.cell.is_listened() {
            self.tell_all(payload, runs_kept());
        }
    }

    #[inline(never)]
    fn tell_all(&self, payload: &[u8], later: bool) {
        let kept = &payload[..payload.len().min(MOST)];
        let words = [self.which, kept.len() as u32, payload.len() as u32, 0];
        tell(&self.cell, words, kept, later);
    }
}

impl CommandTap {
    #[inline(always)]
    pub(crate) fn is_listened(&self) -> bool {
        self.cell.is_listened()
    }

    /// Tells that a command of this ABI id came to `outcome`. `arg` is its argument, lent by its caller.
    /// `later`: this thread ran the command and keeps the component of this tap for its turn. Any thread.
    /// Real-time.
    #[inline(never)]
    pub(crate) fn tell(&self, command: u32, arg: *const u8, outcome: Outcome, later: bool) {
        let Some(whole) = self.arg_bytes.get(command as usize).copied() else { return };
        let kept: &[u8] = if whole == 0 || arg.is_null() {
            &[]
        } else {
            // SAFETY: the thread that runs a command lends an argument of its type, as for the command
            // itself.
            unsafe { std::slice::from_raw_parts(arg, whole.min(MOST)) }
        };
        tell(&self.cell, words(command, outcome, kept, whole), kept, later);
    }

    /// As [`CommandTap::tell`], for an argument that may be of any length: another process put it there.
    #[cold]
    pub(crate) fn tell_queued(&self, command: u32, arg: &[u8], outcome: Outcome) {
        let Some(whole) = self.arg_bytes.get(command as usize).copied() else { return };
        let kept = &arg[..arg.len().min(whole).min(MOST)];
        tell(&self.cell, words(command, outcome, kept, whole), kept, false);
    }
}

/// Tells a sample when this thread's turn ends if it may be told `later`, else at once.
fn tell(tap: &OutCell, words: [u32; 4], kept: &[u8], later: bool) {
    let stamp_ns = os::now_ns();
    // SAFETY: `later` is true only for a tap reached through the event's binding in this turn, or for that of
    // a component this thread keeps.
    if !later || !unsafe { late::told(tap, words, kept, stamp_ns) } {
        tap.tell_now(words, kept, stamp_ns);
    }
}

fn words(command: u32, outcome: Outcome, kept: &[u8], whole: usize) -> [u32; 4] {
    [command, outcome.cast_unsigned(), kept.len() as u32, whole as u32]
}

impl OutCell {
    /// Tells whether a reader was ever connected to this tap: from then on its samples are numbered, so that
    /// none goes missing unnoticed.
    #[inline(always)]
    pub(crate) fn is_listened(&self) -> bool {
        self.listened.load(Ordering::Relaxed)
    }

    /// Tells a row of the state table, the `row`th that was published. One thread at a time. Real-time.
    #[inline(never)]
    pub(crate) fn tell_row(&self, bytes: &[u8], stamp_ns: u64, row: u64) {
        self.seq.store(row, Ordering::Relaxed);
        self.total_bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        self.outs.look(|outs| outs.tell(bytes, &[], Meta { stamp_ns, came_ns: stamp_ns, seq: row }));
    }

    /// Tells an event or command: the words before its payload, and the kept part of that payload. Any
    /// thread. Real-time.
    #[inline(never)]
    pub(crate) fn tell_now(&self, words: [u32; 4], kept: &[u8], stamp_ns: u64) {
        let mut head = [0; HEAD];
        for (to, word) in head.chunks_exact_mut(4).zip(words) {
            to.copy_from_slice(&word.to_le_bytes());
        }
        let seq = self.seq.fetch_add(1, Ordering::Relaxed) + 1;
        self.total_bytes.fetch_add((HEAD + kept.len()) as u64, Ordering::Relaxed);
        self.outs.look(|outs| {
            if !outs.is_unread() {
                // As before each sample that leaves: rows this thread owes are published first.
                pending::publish();
                outs.tell(&head, kept, Meta { stamp_ns, came_ns: stamp_ns, seq });
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use trocar_model::{PortType, Prim, Type};
    use trocar_plugin_api::abi::{EXECUTED, UNBOUND};
    use trocar_rt::stream::{Payload, Queue, stream_link};

    use super::super::event::EventCell;
    use super::super::output::{Consumer, OUTSIDE, OutLink};
    use super::*;

    #[test]
    fn whoever_sends_an_event_does_not_notice_its_tap() {
        let ty = PortType::Plain(Type::Array { item: Box::new(Type::Prim(Prim::U8)), n: HEAD + 8 });
        let (event, cell) = (EventCell::new(4), Arc::new(OutCell::new(&ty)));
        event.set_tap(Some(EventTap { cell: cell.clone(), which: 3 }));
        assert_eq!(event.emit(&[1, 2, 3, 4]), UNBOUND);
        assert_eq!(cell.seq.load(Ordering::Relaxed), 0, "nobody was ever connected: not even counted");
        let (writer, mut reader) = stream_link(Payload::Plain { bytes: HEAD + 8 }, Queue::Latest);
        cell.add(Arc::new(OutLink::new(OUTSIDE, writer, Consumer::Outside, true)), &ty, &"".into());
        event.edit(|_| ());
        assert_eq!(event.emit(&[1, 2, 3, 4]), UNBOUND, "it has still no handler");
        let sample = reader.next().map(|sample| (sample.meta.seq, sample.data.to_vec()));
        let told = [3, 0, 0, 0, 4, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 0, 0, 0, 0];
        assert_eq!(sample, Some((1, told.to_vec())), "filled up with zeros");
        cell.remove(|_| true);
        assert_eq!(event.emit(&[5, 6, 7, 8]), UNBOUND);
        assert_eq!(
            cell.seq.load(Ordering::Relaxed),
            2,
            "what nobody could be given counts, so that the gap shows it"
        );
    }

    #[test]
    fn a_payload_that_is_too_long_is_cut_and_says_so() {
        let n = HEAD + MOST;
        let ty = PortType::Plain(Type::Array { item: Box::new(Type::Prim(Prim::U8)), n });
        let cell = Arc::new(OutCell::new(&ty));
        let (writer, mut reader) = stream_link(Payload::Plain { bytes: n }, Queue::Latest);
        cell.add(Arc::new(OutLink::new(OUTSIDE, writer, Consumer::Outside, true)), &ty, &"".into());
        let arg = vec![7u8; MOST + 100];
        let tap = CommandTap { cell, arg_bytes: Arc::new([0, arg.len()]) };
        tap.tell(1, arg.as_ptr(), EXECUTED, false);
        let data = reader.next().map(|sample| sample.data.to_vec()).unwrap_or_default();
        let word =
            |at: usize| u32::from_le_bytes([data[at], data[at + 1], data[at + 2], data[at + 3]]) as usize;
        assert_eq!((word(0), word(8), word(12), data.len()), (1, MOST, MOST + 100, n));
        assert!(data[HEAD..].iter().all(|byte| *byte == 7));
        tap.tell(2, arg.as_ptr(), EXECUTED, false);
        assert!(reader.next().is_none(), "a command that is not described has no size, and is not told");
    }
}
