//! Samples of taps: one for each row, event and command, to every connected reader.
//!
//! Invariant: a tap never waits and changes nothing for its component: no outcome, no count. Until a reader
//! is connected for the first time it costs one relaxed load.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use trocar_loader::taps::{HEAD, MOST};
use trocar_plugin_api::abi::Outcome;
use trocar_rt::os;
use trocar_rt::stream::Meta;

use super::super::core::{CommandTap, RowTap, TellsCommands, TellsRows};
use super::super::pending;
use super::deferred::{self, DeferredTap};
use super::inside::runs_kept;
use super::output::OutCell;

/// The tap of an event.
#[derive(Clone)]
pub(crate) struct EventTap {
    listened: Arc<AtomicBool>,
    cell: Arc<OutCell>,
    /// ABI id of the event.
    which: u32,
}

/// The tap of an instance's commands.
struct Commands {
    cell: Arc<OutCell>,
    /// Bytes of the argument of each command, by ABI id.
    arg_bytes: Box<[usize]>,
}

/// The tap of the rows, told through this output.
pub(crate) fn row_tap(cell: &Arc<OutCell>) -> RowTap {
    RowTap::new(cell.listened().clone(), cell.clone())
}

/// The tap of the commands, told through this output. `arg_bytes`: bytes of the argument of each command, by
/// ABI id.
pub(crate) fn command_tap(cell: &Arc<OutCell>, arg_bytes: Box<[usize]>) -> CommandTap {
    CommandTap::new(cell.listened().clone(), Arc::new(Commands { cell: cell.clone(), arg_bytes }))
}

impl EventTap {
    /// `which`: ABI id of the event that is told through this output.
    pub(crate) fn new(cell: &Arc<OutCell>, which: u32) -> EventTap {
        EventTap { listened: cell.listened().clone(), cell: cell.clone(), which }
    }

    /// Any thread. Real-time.
    #[inline(always)]
    pub(super) fn tell(&self, payload: &[u8]) {
        if self.listened.load(Ordering::Relaxed) {
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

impl TellsCommands for Commands {
    #[inline(never)]
    fn tell(&self, command: u32, arg: *const u8, outcome: Outcome, later: bool) {
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

    #[cold]
    fn tell_queued(&self, command: u32, arg: &[u8], outcome: Outcome) {
        let Some(whole) = self.arg_bytes.get(command as usize).copied() else { return };
        let kept = &arg[..arg.len().min(whole).min(MOST)];
        tell(&self.cell, words(command, outcome, kept, whole), kept, false);
    }
}

/// Tells a sample when this thread's turn ends if it may be told `later`, else at once.
fn tell(tap: &Arc<OutCell>, words: [u32; 4], kept: &[u8], later: bool) {
    let stamp_ns = os::now_ns();
    // SAFETY: `later` is true only for a tap reached through the event's binding in this turn, or for that of
    // a component this thread keeps.
    if !later || !unsafe { deferred::told(&**tap, words, kept, stamp_ns) } {
        tap.tell_now(words, kept, stamp_ns);
    }
}

fn words(command: u32, outcome: Outcome, kept: &[u8], whole: usize) -> [u32; 4] {
    [command, outcome.cast_unsigned(), kept.len() as u32, whole as u32]
}

impl TellsRows for OutCell {
    #[inline(never)]
    fn tell_row(&self, bytes: &[u8], stamp_ns: u64, row: u64) {
        self.seq.store(row, Ordering::Relaxed);
        self.total_bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        self.outs.look(|outs| outs.tell(bytes, &[], Meta { stamp_ns, came_ns: stamp_ns, seq: row }));
    }
}

impl DeferredTap for OutCell {
    #[inline(never)]
    fn tell_now(&self, words: [u32; 4], kept: &[u8], stamp_ns: u64) {
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
    use trocar_model::{PortType, Prim, Type};
    use trocar_plugin_api::abi::{EXECUTED, UNBOUND};
    use trocar_rt::stream::{Payload, Queue, stream_link};

    use super::super::event::EventCell;
    use super::super::output::{Consumer, OUTSIDE, OutLink};
    use super::*;

    #[test]
    fn whoever_sends_an_event_does_not_notice_its_tap() {
        let ty = PortType::Plain(Type::Array { item: Box::new(Type::Prim(Prim::U8)), n: HEAD + 8 });
        let (event, cell) = (EventCell::new(4), Arc::new(OutCell::new("tap", &ty)));
        event.set_tap(Some(EventTap::new(&cell, 3)));
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
        let cell = Arc::new(OutCell::new("tap", &ty));
        let (writer, mut reader) = stream_link(Payload::Plain { bytes: n }, Queue::Latest);
        cell.add(Arc::new(OutLink::new(OUTSIDE, writer, Consumer::Outside, true)), &ty, &"".into());
        let arg = vec![7u8; MOST + 100];
        let tap = command_tap(&cell, Box::new([0, arg.len()])).to;
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
