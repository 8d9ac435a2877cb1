//! Frames that wait in queues leave slots of their pool free: a maker of frames never waits for a reader that
//! does not take them.
#![allow(clippy::unwrap_used)]

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use proptest::prelude::*;
use trocar_rt::pool::{Frame, FramePool};
use trocar_rt::stream::{DropPolicy, Meta, Payload, Pushed, Queue, StreamReader, StreamWriter, stream_link};

const OLDEST: Queue = Queue::Fifo { depth: 64, drop: DropPolicy::DropOldest };
const NEWEST: Queue = Queue::Fifo { depth: 64, drop: DropPolicy::DropNewest };

fn pool(slots: u32) -> Arc<FramePool> {
    FramePool::new(slots, 8, 0).unwrap()
}

/// A frame with its number in the header; `None` when the pool has no slot.
fn frame(pool: &Arc<FramePool>, seq: u64) -> Option<Frame> {
    let mut writing = pool.loan()?;
    writing.parts_mut().0.copy_from_slice(&seq.to_ne_bytes());
    Some(writing.freeze(0))
}

fn push(writer: &StreamWriter, frame: &Frame, seq: u64) -> Pushed {
    writer.push_frame(frame.clone(), Meta { stamp_ns: 0, came_ns: 0, seq })
}

fn next(reader: &mut StreamReader) -> Option<u64> {
    reader.next().map(|sample| {
        assert_eq!(sample.data, sample.meta.seq.to_ne_bytes(), "another frame's slot");
        sample.meta.seq
    })
}

fn rest(reader: &mut StreamReader) -> Vec<u64> {
    std::iter::from_fn(|| next(reader)).collect()
}

#[test]
fn a_queue_nobody_reads_gives_up_its_oldest_frames_and_the_pool_never_runs_out() {
    for slots in 2..=70 {
        let pool = pool(slots);
        let (writer, mut reader) = stream_link(Payload::Frame, OLDEST);
        for seq in 1..=200 {
            let made = frame(&pool, seq).unwrap_or_else(|| panic!("no slot of {slots} for frame {seq}"));
            assert_ne!(push(&writer, &made, seq), Pushed::DroppedNewest, "frame {seq}");
        }
        let (free, kept) = (u64::from(pool.stats().free), rest(&mut reader));
        assert!(kept.iter().copied().eq(201 - kept.len() as u64..=200), "not the newest: {kept:?}");
        // One more would have been more than two for each slot then free.
        let most = (2 * free).min(64);
        assert!(
            (most.min(2 * free - 2)..=most.max(1)).contains(&(kept.len() as u64)),
            "{free} free: {kept:?}"
        );
        assert_eq!(reader.stats().dropped, 200 - kept.len() as u64, "each is taken or counted");
        reader.release();
        assert_eq!((pool.stats().free, pool.stats().exhausted), (slots, 0));
    }
}

#[test]
fn a_queue_that_keeps_its_oldest_refuses_frames_while_another_reader_gets_them_all() {
    for slots in 3..=70 {
        let pool = pool(slots);
        let (writer, mut reader) = stream_link(Payload::Frame, NEWEST);
        let (trunk, mut screen) = stream_link(Payload::Frame, OLDEST);
        for seq in 1..=200 {
            let made = frame(&pool, seq).unwrap_or_else(|| panic!("no slot of {slots} for frame {seq}"));
            let _ = push(&writer, &made, seq);
            assert_eq!(push(&trunk, &made, seq), Pushed::Queued);
            drop(made);
            // The screen keeps this frame in its hands while the next one is made.
            assert_eq!(next(&mut screen), Some(seq));
        }
        let kept = rest(&mut reader);
        assert!(
            kept.iter().copied().eq(1..=kept.len() as u64) && !kept.is_empty(),
            "not the first: {kept:?}"
        );
        assert_eq!(writer.stats().dropped, 200 - kept.len() as u64);
        reader.release();
        let made = frame(&pool, 201).unwrap();
        assert_eq!(push(&writer, &made, 201), Pushed::Queued, "whoever reads again gets frames again");
        drop((made, reader, screen));
        assert_eq!((pool.stats().free, pool.stats().exhausted), (slots, 0));
    }
}

#[test]
fn two_queues_with_the_same_frames_share_what_must_be_given_up() {
    let pool = pool(8);
    let [(first, mut a), (second, mut b)] = [(); 2].map(|()| stream_link(Payload::Frame, OLDEST));
    for seq in 1..=100 {
        let made = frame(&pool, seq).unwrap();
        let _ = (push(&first, &made, seq), push(&second, &made, seq));
    }
    let (a, b) = (rest(&mut a), rest(&mut b));
    assert!(a.len() >= 4 && b.len() >= 4, "neither is left with next to nothing: {a:?} {b:?}");
    assert_eq!((a.last(), b.last()), (Some(&100), Some(&100)));
    assert_eq!([&first, &second].map(|w| w.stats().dropped), [&a, &b].map(|kept| 100 - kept.len() as u64));
}

#[test]
fn what_readers_have_in_their_hands_is_left_to_them() {
    let pool = pool(4);
    let (writer, mut reader) = stream_link(Payload::Frame, OLDEST);
    let mut hands = Vec::new();
    for seq in 1..=3 {
        let _ = push(&writer, &frame(&pool, seq).unwrap(), seq);
        assert_eq!(next(&mut reader), Some(seq));
        hands.push(reader.take_frame().unwrap());
    }
    let last = frame(&pool, 4).unwrap();
    assert_eq!(push(&writer, &last, 4), Pushed::Queued, "the only one there is stays");
    drop(last);
    assert!(frame(&pool, 5).is_none(), "the pool is empty indeed");
    assert_eq!((hands[0].header(), pool.stats().exhausted), (&1u64.to_ne_bytes()[..], 1));
    hands.clear();
    assert_eq!((next(&mut reader), writer.stats().dropped), (Some(4), 0));
}

#[test]
fn plain_samples_and_frames_of_an_ample_pool_fill_the_whole_queue() {
    let queue = |drop| Queue::Fifo { depth: 4, drop };
    for drop in [DropPolicy::DropOldest, DropPolicy::DropNewest] {
        let pool = pool(9);
        let (writer, mut reader) = stream_link(Payload::Frame, queue(drop));
        (1..=4).for_each(|seq| assert_eq!(push(&writer, &frame(&pool, seq).unwrap(), seq), Pushed::Queued));
        assert_eq!(rest(&mut reader), [1, 2, 3, 4]);
        let (writer, mut reader) = stream_link(Payload::Plain { bytes: 8 }, queue(drop));
        for seq in 1..=4u64 {
            assert_eq!(
                writer.push(&seq.to_ne_bytes(), Meta { stamp_ns: 0, came_ns: 0, seq }),
                Pushed::Queued
            );
        }
        assert_eq!(rest(&mut reader), [1, 2, 3, 4]);
    }
}

/// The pushing thread against one that takes, slowly or not at all: no loan fails, and the numbers add up.
#[test]
fn a_queue_under_load_gives_up_frames_exactly() {
    const FRAMES: u64 = 30_000;
    for (slots, drop) in
        [(4, DropPolicy::DropOldest), (8, DropPolicy::DropOldest), (8, DropPolicy::DropNewest)]
    {
        let pool = pool(slots);
        let (writer, mut reader) = stream_link(Payload::Frame, Queue::Fifo { depth: 64, drop });
        let done = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                for seq in 1..=FRAMES {
                    let made = frame(&pool, seq).unwrap_or_else(|| panic!("no slot for frame {seq}"));
                    let _ = writer.push_frame(made, Meta { stamp_ns: 0, came_ns: 0, seq });
                    if seq % 16 == 0 {
                        thread::yield_now();
                    }
                }
                done.store(true, Ordering::Release);
            });
            let (mut last, mut gaps) = (0, 0);
            loop {
                let finished = done.load(Ordering::Acquire);
                match next(&mut reader) {
                    Some(seq) => {
                        assert!(seq > last, "{seq} after {last}");
                        gaps += seq - last - 1;
                        last = seq;
                    }
                    None if finished => break,
                    None => {}
                }
            }
            let stats = reader.stats();
            assert_eq!((stats.pushed, stats.taken + stats.dropped), (FRAMES, FRAMES), "{stats:?}");
            assert_eq!(stats.dropped, gaps + (FRAMES - last), "drops and sequence gaps differ");
        });
        std::mem::drop(reader);
        assert_eq!(pool.stats().free, slots);
    }
}

/// A link as its description says: samples that wait, and the one the reader holds.
struct Model {
    depth: usize,
    /// `None` for a latest link.
    drop: Option<DropPolicy>,
    waits: VecDeque<u64>,
    hand: Option<u64>,
    dropped: u64,
}

fn free(slots: usize, links: &[Model], making: u64) -> usize {
    let held = links.iter().flat_map(|l| l.waits.iter().copied().chain(l.hand));
    slots - held.chain([making]).collect::<BTreeSet<_>>().len()
}

fn offer(slots: usize, links: &mut [Model], at: usize, seq: u64) {
    let lose = |links: &mut [Model]| {
        links[at].waits.pop_front();
        links[at].dropped += 1;
    };
    match links[at].drop {
        Some(DropPolicy::DropNewest) => {
            let waits = links[at].waits.len();
            if waits == links[at].depth || (waits > 0 && waits + 1 > free(slots, links, seq)) {
                links[at].dropped += 1;
                return;
            }
        }
        Some(DropPolicy::DropOldest) => {
            while !links[at].waits.is_empty() && links[at].waits.len() + 1 > 2 * free(slots, links, seq) {
                lose(links);
            }
        }
        None => {}
    }
    if links[at].waits.len() == links[at].depth {
        lose(links);
    }
    links[at].waits.push_back(seq);
}

proptest! {
    #[test]
    fn links_of_one_pool_keep_what_the_rule_says(
        slots in 2..12usize,
        kinds in prop::collection::vec((0..3u8, 1..9usize), 1..4),
        acts in prop::collection::vec((0..5u8, 0..4usize), 0..120),
    ) {
        let pool = pool(slots as u32);
        let mut models: Vec<Model> = kinds.iter().map(|&(kind, depth)| {
            let drop = [None, Some(DropPolicy::DropOldest), Some(DropPolicy::DropNewest)][usize::from(kind)];
            let depth = if drop.is_some() { depth } else { 1 };
            Model { depth, drop, waits: VecDeque::new(), hand: None, dropped: 0 }
        }).collect();
        let mut links: Vec<_> = models.iter().map(|m| {
            let queue = m.drop.map_or(Queue::Latest, |drop| Queue::Fifo { depth: m.depth, drop });
            stream_link(Payload::Frame, queue)
        }).collect();
        let mut seq = 0;
        for (act, at) in acts {
            let at = at % links.len();
            match act {
                0..=2 => {
                    let Some(made) = frame(&pool, seq + 1) else {
                        prop_assert_eq!(pool.stats().free, 0);
                        continue;
                    };
                    seq += 1;
                    for (link, (writer, _)) in links.iter().enumerate() {
                        offer(slots, &mut models, link, seq);
                        let _ = push(writer, &made, seq);
                    }
                }
                3 => {
                    let expected = models[at].waits.pop_front();
                    models[at].hand = expected.or(models[at].hand);
                    prop_assert_eq!(next(&mut links[at].1), expected);
                }
                _ => {
                    models[at].hand = None;
                    links[at].1.release();
                }
            }
            let held = models.iter().flat_map(|l| l.waits.iter().copied().chain(l.hand));
            let held = held.collect::<BTreeSet<_>>().len();
            prop_assert_eq!(pool.stats().free as usize, slots - held);
            for (model, (writer, _)) in models.iter().zip(&links) {
                prop_assert_eq!(writer.stats().dropped, model.dropped);
            }
        }
        drop(links);
        prop_assert_eq!(pool.stats().free as usize, slots);
    }
}
