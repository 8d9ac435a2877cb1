//! What observers are given a little later: recorders, viewers, whoever takes samples of any type or listens at a tap.
//!
//! Invariant: no step waits for whoever only looks on. What is for them is noted in the thread's turn, and given when that ends: in
//! the order it came, after all who work with what the turn has made were woken. Nothing is left over when a turn ends. Only what a
//! component did is noted that no other thread enters before then ([`super::boundary::runs_kept`]): nobody overtakes it.

use std::cell::{Cell, RefCell};
use std::ops::Range;
use std::sync::Arc;

use trocar_rt::pool::Frame;
use trocar_rt::stream::Meta;
use trocar_rt::turn;

use super::boundary::{OutCell, OutLink};
use super::instance::Instance;
use super::{context, pending};

/// How much a turn may have to give later; with more of it what is there is given at once.
const MOST: usize = 64;
/// Bytes of samples, events and commands that are kept until then.
const ROOM: usize = 16 << 10;

/// Slots of a frame's pool that stay free beside those of noted frames.
const LEFT_FREE: u64 = 2;

thread_local! {
    static NOTED: Cell<bool> = const { Cell::new(false) };
    static LATE: RefCell<Option<Late>> = const { RefCell::new(None) };
}

/// What a thread has noted; made with it, and never larger.
struct Late {
    all: Vec<What>,
    bytes: Vec<u8>,
}

enum What {
    /// The newest row of its state table.
    Row(Arc<Instance>),
    /// An event or command, by the words before its payload.
    Told {
        tap: Arc<OutCell>,
        words: [u32; 4],
        payload: Range<usize>,
        stamp_ns: u64,
    },
    Sample {
        link: Arc<OutLink>,
        value: Range<usize>,
        meta: Meta,
    },
    Frame {
        link: Arc<OutLink>,
        frame: Frame,
        meta: Meta,
    },
}

/// Makes room for this thread, before its first turn.
pub(super) fn prepare() {
    // Written to, so that it is memory before it is needed.
    let mut bytes = vec![1; ROOM];
    bytes.clear();
    LATE.set(Some(Late { all: Vec::with_capacity(MOST), bytes }));
}

/// Leaves the newest row of a component for later; false where it has to be told now.
#[inline(never)]
pub(super) fn row(instance: &Instance) -> bool {
    let Some(me) = has_room(0).then(|| instance.me()).flatten() else { return false };
    note(&[], |_| What::Row(me));
    true
}

/// Leaves an event or command for later; false where it has to be told now.
pub(super) fn told(tap: &Arc<OutCell>, words: [u32; 4], payload: &[u8], stamp_ns: u64) -> bool {
    let later = has_room(payload.len());
    if later {
        note(payload, |payload| What::Told { tap: tap.clone(), words, payload, stamp_ns });
    }
    later
}

/// Leaves a sample for later; false where it has to be pushed now.
pub(super) fn sample(link: &Arc<OutLink>, value: &[u8], meta: Meta) -> bool {
    let later = has_room(value.len());
    if later {
        note(value, |value| What::Sample { link: link.clone(), value, meta });
    }
    later
}

/// Leaves a frame for later; given back where it has to be pushed now.
pub(super) fn frame(link: &Arc<OutLink>, frame: Frame, meta: Meta) -> Option<Frame> {
    // What waits here leaves slots of the pool free, as what waits in a queue does.
    if !has_room(0) || !frame.pool_has_free(LEFT_FREE) {
        give();
        return Some(frame);
    }
    note(&[], |_| What::Frame { link: link.clone(), frame, meta });
    None
}

/// Whether this thread is in a turn and has room for one more with so many bytes. Where it has none, all that was noted is out.
fn has_room(bytes: usize) -> bool {
    let fits = || {
        LATE.with_borrow(|late| {
            let room = |late: &Late| late.all.len() < MOST && ROOM - late.bytes.len() >= bytes;
            late.as_ref().is_some_and(room)
        })
    };
    if !turn::is_inside() || fits() {
        return turn::is_inside();
    }
    give();
    fits()
}

/// After [`has_room`] said so.
fn note(bytes: &[u8], what: impl FnOnce(Range<usize>) -> What) {
    LATE.with_borrow_mut(|late| {
        let Some(late) = late else { return };
        let at = late.bytes.len();
        late.bytes.extend_from_slice(bytes);
        late.all.push(what(at..at + bytes.len()));
    });
    NOTED.set(true);
}

/// Gives observers what was noted in this turn. Real-time; in the turn it was noted in, after its wakes.
#[inline]
pub(super) fn give() {
    if NOTED.get() {
        give_all();
    }
}

#[inline(never)]
fn give_all() {
    // Out of reach while it is given: whatever should be noted meanwhile is given at once.
    let Some(mut late) = LATE.take() else { return };
    NOTED.set(false);
    pending::publish();
    let stepping = context::stepping();
    context::set_stepping(true);
    let Late { all, bytes } = &mut late;
    for what in all.drain(..) {
        match what {
            What::Row(instance) => instance.tell_row_of_turn(),
            What::Told { tap, words, payload, stamp_ns } => tap.tell_now(words, &bytes[payload], stamp_ns),
            What::Sample { link, value, meta } => link.push_now(&bytes[value], meta),
            What::Frame { link, frame, meta } => link.push_frame_now(frame, meta),
        }
    }
    bytes.clear();
    LATE.set(Some(late));
    context::set_stepping(stepping);
    if !stepping {
        context::flush_wakes();
    }
}

#[cfg(test)]
mod tests {
    use trocar_rt::stream::{DropPolicy, Payload, Queue, StreamReader, stream_link};

    use super::super::boundary::{Consumer, OUTSIDE};
    use super::*;

    const BYTES: usize = 2048;

    fn observed() -> (Arc<OutLink>, StreamReader) {
        let queue = Queue::Fifo { depth: 256, drop: DropPolicy::DropNewest };
        let (writer, reader) = stream_link(Payload::Plain { bytes: 2 * ROOM }, queue);
        (Arc::new(OutLink::new(OUTSIDE, writer, Consumer::Outside, true)), reader)
    }

    fn give_sample(link: &Arc<OutLink>, seq: u64, bytes: usize) {
        let (value, meta) = (vec![seq as u8; bytes], Meta { stamp_ns: seq, seq });
        if !sample(link, &value, meta) {
            link.push_now(&value, meta);
        }
    }

    /// As the thread of an executor runs one.
    fn turn(f: impl FnOnce()) {
        turn::run(|| {
            context::set_stepping(true);
            f();
            context::set_stepping(false);
            context::flush_wakes();
            give();
        });
    }

    fn numbers(reader: &mut StreamReader) -> Vec<u64> {
        let whole = |reader: &mut StreamReader| {
            let sample = reader.next()?;
            assert!(sample.data.iter().all(|byte| *byte == sample.meta.seq as u8), "torn");
            Some(sample.meta.seq)
        };
        std::iter::from_fn(|| whole(reader)).collect()
    }

    #[test]
    fn nobody_is_given_anything_before_the_turn_ends_and_then_all_of_it_in_order() {
        prepare();
        let (link, mut reader) = observed();
        turn(|| {
            (1..=5).for_each(|seq| give_sample(&link, seq, 8));
            assert!(reader.next().is_none(), "the step paid for it");
        });
        assert_eq!(numbers(&mut reader), [1, 2, 3, 4, 5]);
        turn(|| ());
        assert!(reader.next().is_none(), "it was given twice");
    }

    #[test]
    fn what_there_is_no_room_for_comes_at_once_and_behind_what_came_before() {
        prepare();
        let (link, mut reader) = observed();
        turn(|| {
            (1..=20).for_each(|seq| give_sample(&link, seq, BYTES));
            give_sample(&link, 21, ROOM + 1);
            assert_eq!(
                numbers(&mut reader),
                (1..=21).collect::<Vec<u64>>(),
                "more than there can ever be room for"
            );
            (22..=22 + MOST as u64).for_each(|seq| give_sample(&link, seq, 0));
            assert_eq!(numbers(&mut reader), (22..22 + MOST as u64).collect::<Vec<u64>>(), "too many");
        });
        assert_eq!(numbers(&mut reader), [22 + MOST as u64]);
    }

    #[test]
    fn threads_that_take_no_turns_give_at_once() {
        prepare();
        let (link, mut reader) = observed();
        give_sample(&link, 1, 8);
        assert_eq!(numbers(&mut reader), [1]);
    }

    #[test]
    fn frames_are_kept_until_they_are_given_and_not_longer() {
        prepare();
        let pool = trocar_rt::pool::FramePool::new(3, 8, 8).expect("memory");
        let (writer, mut reader) =
            stream_link(Payload::Frame, Queue::Fifo { depth: 2, drop: DropPolicy::DropOldest });
        let link = Arc::new(OutLink::new(OUTSIDE, writer, Consumer::Outside, true));
        turn(|| {
            let lend = || pool.loan().expect("one is free").freeze(8);
            assert!(frame(&link, lend(), Meta { stamp_ns: 1, seq: 1 }).is_none());
            assert_eq!(pool.stats().free, 2);
            assert!(reader.next().is_none());
            assert!(frame(&link, lend(), Meta { stamp_ns: 2, seq: 2 }).is_some(), "too few would be free");
        });
        assert_eq!(reader.next().map(|sample| sample.meta.seq), Some(1));
        drop((reader, link));
        assert_eq!(pool.stats().free, 3);
    }
}
