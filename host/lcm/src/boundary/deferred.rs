//! Deferred deliveries to observers: recorders, viewers, readers of samples of any type, listeners at a tap.
//!
//! Invariant: no step waits for an observer. Deliveries to observers are noted in the thread's turn and made
//! when the turn ends: in the order they came, after the wakes of all consumers that work with the turn's
//! results. Nothing is left over when a turn ends. Only actions of a component that no other thread enters
//! before then are noted ([`super::inside::runs_kept`]): no other thread overtakes them. A noted object stays
//! until its turn ends, so noting it counts no reference.

use std::cell::{Cell, RefCell};
use std::ops::Range;
use std::ptr::NonNull;

use trocar_rt::pool::Frame;
use trocar_rt::stream::Meta;
use trocar_rt::turn;

use super::super::core::Core;
use super::super::{context, pending};
use super::told;

/// Most deliveries a turn may defer; when the list is full, all of it is given at once.
const MOST: usize = 64;
/// Bytes of samples, events and commands that a turn may defer.
const ROOM: usize = 16 << 10;

/// Slots of a frame's pool that stay free beside those of noted frames.
const LEFT_FREE: u64 = 2;

thread_local! {
    static NOTED: Cell<bool> = const { Cell::new(false) };
    static DEFERRED: RefCell<Option<Deferred>> = const { RefCell::new(None) };
}

/// A tap whose samples may be deferred.
pub(crate) trait DeferredTap {
    /// Tells an event or command: the words before its payload, and the kept part of that payload. Any
    /// thread. Real-time.
    fn tell_now(&self, words: [u32; 4], kept: &[u8], stamp_ns: u64);
}

/// A connection whose samples may be deferred.
pub(crate) trait DeferredLink {
    /// Pushes the sample now, to any kind of reader.
    fn push_now(&self, value: &[u8], meta: Meta);

    /// Pushes the frame now, to any kind of reader.
    fn push_frame_now(&self, frame: Frame, meta: Meta);
}

/// Deferred deliveries of a thread; allocated with the thread, and never larger.
struct Deferred {
    all: Vec<What>,
    bytes: Vec<u8>,
}

/// An object that stays in place until this turn ends, as the caller that noted it promises.
struct Staying<T: ?Sized>(NonNull<T>);

impl<T: ?Sized> Staying<T> {
    fn new(what: &T) -> Staying<T> {
        Staying(NonNull::from(what))
    }

    /// # Safety
    /// Only in the turn in which the object was noted.
    unsafe fn get(&self) -> &T {
        // SAFETY: the object stays until that turn ends.
        unsafe { self.0.as_ref() }
    }
}

enum What {
    /// The newest row of its state table.
    Row(Staying<Core>),
    /// An event or command, with the words before its payload.
    Told {
        tap: Staying<dyn DeferredTap>,
        words: [u32; 4],
        payload: Range<usize>,
        stamp_ns: u64,
    },
    Sample {
        link: Staying<dyn DeferredLink>,
        value: Range<usize>,
        meta: Meta,
    },
    Frame {
        link: Staying<dyn DeferredLink>,
        frame: Frame,
        meta: Meta,
    },
}

/// Makes room for this thread, before its first turn.
pub(crate) fn prepare() {
    // The bytes are written to, so that the memory is there before it is needed.
    let mut bytes = vec![1; ROOM];
    bytes.clear();
    DEFERRED.set(Some(Deferred { all: Vec::with_capacity(MOST), bytes }));
}

/// Defers the newest row of a component; false where it has to be told now.
#[inline(never)]
pub(crate) fn row(core: &Core) -> bool {
    // A component that this thread keeps is a member of its executor, which holds it through the whole turn.
    let later = core.object.is_kept_here() && has_room(0);
    if later {
        note(&[], |_| What::Row(Staying::new(core)));
    }
    later
}

/// Defers an event or command; false where it has to be told now.
///
/// # Safety
/// In a turn of this thread: `tap` was reached through a binding in that very turn, or belongs to a component
/// this thread keeps.
pub(super) unsafe fn told(
    tap: &(dyn DeferredTap + 'static),
    words: [u32; 4],
    payload: &[u8],
    stamp_ns: u64,
) -> bool {
    let later = has_room(payload.len());
    if later {
        note(payload, |payload| What::Told { tap: Staying::new(tap), words, payload, stamp_ns });
    }
    later
}

/// Defers a sample; false where it has to be pushed now.
///
/// # Safety
/// In a turn of this thread: `link` was reached through a binding in that very turn.
pub(super) unsafe fn sample(link: &(dyn DeferredLink + 'static), value: &[u8], meta: Meta) -> bool {
    let later = has_room(value.len());
    if later {
        note(value, |value| What::Sample { link: Staying::new(link), value, meta });
    }
    later
}

/// Defers a frame; returned where it has to be pushed now.
///
/// # Safety
/// As of [`sample`].
pub(super) unsafe fn frame(link: &(dyn DeferredLink + 'static), frame: Frame, meta: Meta) -> Option<Frame> {
    // A deferred frame leaves slots of the pool free, as a frame in a queue does.
    if !has_room(0) || !frame.pool_has_free(LEFT_FREE) {
        give();
        return Some(frame);
    }
    note(&[], |_| What::Frame { link: Staying::new(link), frame, meta });
    None
}

/// Tells whether this thread is in a turn and has room for one more delivery of so many bytes. Gives all
/// noted deliveries first where there is no room.
fn has_room(bytes: usize) -> bool {
    let fits = || {
        DEFERRED.with_borrow(|deferred| {
            let room =
                |deferred: &Deferred| deferred.all.len() < MOST && ROOM - deferred.bytes.len() >= bytes;
            deferred.as_ref().is_some_and(room)
        })
    };
    if !turn::is_inside() || fits() {
        return turn::is_inside();
    }
    give();
    fits()
}

/// Notes one delivery, after [`has_room`] returned true.
fn note(bytes: &[u8], what: impl FnOnce(Range<usize>) -> What) {
    DEFERRED.with_borrow_mut(|deferred| {
        let Some(deferred) = deferred else { return };
        let at = deferred.bytes.len();
        deferred.bytes.extend_from_slice(bytes);
        deferred.all.push(what(at..at + bytes.len()));
    });
    NOTED.set(true);
}

/// Makes the deliveries noted in this turn. Real-time; in the same turn, after its wakes.
#[inline]
pub(crate) fn give() {
    if NOTED.get() {
        give_all();
    }
}

#[inline(never)]
fn give_all() {
    // The list is out of reach during delivery: a delivery that comes up meanwhile is made at once.
    let Some(mut deferred) = DEFERRED.take() else { return };
    NOTED.set(false);
    pending::publish();
    let stepping = context::stepping();
    context::set_stepping(true);
    let Deferred { all, bytes } = &mut deferred;
    for what in all.drain(..) {
        // SAFETY: all of it was noted in this turn: a thread that runs turns comes here before they end,
        // except when one unwinds; that ends its thread, and its notes are dropped unread.
        unsafe {
            match what {
                What::Row(core) => core.get().tell_row_of_turn(),
                What::Told { tap, words, payload, stamp_ns } => {
                    tap.get().tell_now(words, &bytes[payload], stamp_ns);
                }
                What::Sample { link, value, meta } => link.get().push_now(&bytes[value], meta),
                What::Frame { link, frame, meta } => link.get().push_frame_now(frame, meta),
            }
        }
    }
    bytes.clear();
    DEFERRED.set(Some(deferred));
    context::set_stepping(stepping);
    if !stepping {
        told::flush_wakes();
    }
}

#[cfg(test)]
mod tests {
    use trocar_rt::stream::{DropPolicy, Payload, Queue, StreamReader, stream_link};

    use std::sync::Arc;

    use super::super::output::{Consumer, OUTSIDE, OutLink};
    use super::*;

    const BYTES: usize = 2048;

    fn observed() -> (Arc<OutLink>, StreamReader) {
        let queue = Queue::Fifo { depth: 256, drop: DropPolicy::DropNewest };
        let (writer, reader) = stream_link(Payload::Plain { bytes: 2 * ROOM }, queue);
        (Arc::new(OutLink::new(OUTSIDE, writer, Consumer::Outside, true)), reader)
    }

    fn give_sample(link: &Arc<OutLink>, seq: u64, bytes: usize) {
        let (value, meta) = (vec![seq as u8; bytes], Meta { stamp_ns: seq, came_ns: 0, seq });
        // SAFETY: the caller holds it until its turn has ended.
        if !unsafe { sample(&**link, &value, meta) } {
            link.push_now(&value, meta);
        }
    }

    /// Runs one turn as the thread of an executor does.
    fn turn(f: impl FnOnce()) {
        turn::run(|| {
            context::set_stepping(true);
            f();
            context::set_stepping(false);
            told::flush_wakes();
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
            // SAFETY: held until the turn has ended.
            let frame = |seq| unsafe { frame(&*link, lend(), Meta { stamp_ns: seq, came_ns: 0, seq }) };
            assert!(frame(1).is_none());
            assert_eq!(pool.stats().free, 2);
            assert!(reader.next().is_none());
            assert!(frame(2).is_some(), "too few would be free");
        });
        assert_eq!(reader.next().map(|sample| sample.meta.seq), Some(1));
        drop((reader, link));
        assert_eq!(pool.stats().free, 3);
    }
}
