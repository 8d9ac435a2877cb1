//! A link keeps order, never tears a sample, and every sample is taken or counted as dropped.
#![allow(clippy::unwrap_used)]

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use proptest::prelude::*;
use trocar_rt::pool::FramePool;
use trocar_rt::stream::{DropPolicy, Meta, Payload, Pushed, Queue, StreamReader, StreamWriter, stream_link};

const PLAIN: Payload = Payload::Plain { bytes: 8 };

fn fifo(depth: usize, drop: DropPolicy) -> Queue {
    Queue::Fifo { depth, drop }
}

fn push(writer: &StreamWriter, seq: u64) -> Pushed {
    writer.push(&seq.to_ne_bytes(), Meta { stamp_ns: seq, came_ns: 0, seq })
}

fn next(reader: &mut StreamReader) -> Option<u64> {
    reader.next().map(|s| {
        assert_eq!(s.data, s.meta.seq.to_ne_bytes(), "torn sample");
        s.meta.seq
    })
}

#[test]
fn latest_gives_the_newest_and_says_whether_it_is_fresh() {
    let (writer, mut reader) = stream_link(PLAIN, Queue::Latest);
    assert!(reader.latest().is_none());
    assert_eq!(push(&writer, 1), Pushed::Queued);
    assert_eq!(push(&writer, 2), Pushed::DroppedOldest);
    let sample = reader.latest().unwrap();
    assert_eq!((sample.meta.seq, sample.fresh, sample.data), (2, true, &2u64.to_ne_bytes()[..]));
    let again = reader.latest().unwrap();
    assert_eq!((again.meta.seq, again.fresh), (2, false));
    assert!(reader.next().is_none(), "nothing unseen");
    let stats = reader.stats();
    assert_eq!((stats.pushed, stats.taken, stats.dropped), (2, 1, 1));
}

#[test]
fn a_queue_gives_every_sample_in_order() {
    let (writer, mut reader) = stream_link(PLAIN, fifo(3, DropPolicy::DropOldest));
    (1..=3).for_each(|n| assert_eq!(push(&writer, n), Pushed::Queued));
    assert_eq!(std::iter::from_fn(|| next(&mut reader)).collect::<Vec<_>>(), [1, 2, 3]);
    assert_eq!(reader.current().unwrap().meta.seq, 3, "the last one stays in sight");
}

#[test]
fn a_full_queue_drops_by_its_policy_and_counts() {
    let (writer, mut reader) = stream_link(PLAIN, fifo(2, DropPolicy::DropOldest));
    assert_eq!((1..=4).map(|n| push(&writer, n)).filter(|p| *p == Pushed::DroppedOldest).count(), 2);
    assert_eq!((next(&mut reader), next(&mut reader), next(&mut reader)), (Some(3), Some(4), None));
    assert_eq!(writer.stats().dropped, 2);

    let (writer, mut reader) = stream_link(PLAIN, fifo(2, DropPolicy::DropNewest));
    assert_eq!((1..=4).map(|n| push(&writer, n)).filter(|p| *p == Pushed::DroppedNewest).count(), 2);
    assert_eq!((next(&mut reader), next(&mut reader), next(&mut reader)), (Some(1), Some(2), None));
    assert_eq!(writer.stats().dropped, 2);
}

#[test]
fn latest_of_a_queue_skips_to_the_newest_and_counts_the_skipped() {
    let (writer, mut reader) = stream_link(PLAIN, fifo(4, DropPolicy::DropOldest));
    (1..=4).for_each(|n| assert_eq!(push(&writer, n), Pushed::Queued));
    assert_eq!(reader.latest().map(|s| (s.meta.seq, s.fresh)), Some((4, true)));
    assert_eq!(reader.latest().map(|s| (s.meta.seq, s.fresh)), Some((4, false)));
    let stats = reader.stats();
    assert_eq!((stats.pushed, stats.taken, stats.dropped), (4, 1, 3));
}

#[test]
fn a_sample_stays_while_the_writer_goes_on() {
    for queue in [Queue::Latest, fifo(1, DropPolicy::DropOldest)] {
        let (writer, mut reader) = stream_link(PLAIN, queue);
        let _ = push(&writer, 1);
        let sample = reader.latest().unwrap();
        for n in 2..50 {
            let _ = push(&writer, n);
        }
        assert_eq!((sample.meta.seq, sample.data), (1, &1u64.to_ne_bytes()[..]));
    }
}

#[test]
fn a_released_sample_is_out_of_sight_until_the_next() {
    let (writer, mut reader) = stream_link(PLAIN, Queue::Latest);
    let _ = push(&writer, 1);
    reader.latest().unwrap();
    reader.release();
    assert!(reader.latest().is_none());
    let _ = push(&writer, 2);
    assert_eq!(next(&mut reader), Some(2));
}

#[test]
fn what_does_not_fit_the_link_is_refused_and_counted() {
    let (writer, mut reader) = stream_link(PLAIN, Queue::Latest);
    assert_eq!(writer.push(&[0; 9], Meta::default()), Pushed::WrongPayload);
    let pool = FramePool::new(1, 8, 8).unwrap();
    assert_eq!(writer.push_frame(pool.loan().unwrap().freeze(0), Meta::default()), Pushed::WrongPayload);
    assert_eq!(pool.stats().free, 1, "the refused frame went back");
    assert!(reader.latest().is_none());
    assert_eq!(reader.stats().dropped, 2);
    let (writer, _reader) = stream_link(Payload::Frame, Queue::Latest);
    assert_eq!(writer.push(&[], Meta::default()), Pushed::WrongPayload);
}

#[test]
fn samples_of_no_bytes_and_shorter_ones_are_samples() {
    let (writer, mut reader) = stream_link(Payload::Plain { bytes: 0 }, Queue::Latest);
    assert_eq!(writer.push(&[], Meta { stamp_ns: 1, came_ns: 0, seq: 1 }), Pushed::Queued);
    assert_eq!(reader.latest().map(|s| s.data.len()), Some(0));
    let (writer, mut reader) = stream_link(PLAIN, Queue::Latest);
    let _ = writer.push(&[5; 3], Meta::default());
    assert_eq!(reader.latest().unwrap().data, [5; 3]);
}

#[test]
fn frames_pass_by_handle_and_go_back_when_the_reader_goes_on() {
    let pool = FramePool::new(4, 8, 16).unwrap();
    let send = |writer: &StreamWriter, n: u8| {
        let mut writing = pool.loan().unwrap();
        writing.parts_mut().0.fill(n);
        writing.parts_mut().1.fill(n);
        writer.push_frame(writing.freeze(16), Meta { stamp_ns: 0, came_ns: 0, seq: u64::from(n) })
    };
    for queue in [Queue::Latest, fifo(1, DropPolicy::DropOldest)] {
        let (writer, mut reader) = stream_link(Payload::Frame, queue);
        for n in 1..=20 {
            let _ = send(&writer, n);
            assert!(pool.stats().free >= 2, "at most the queued one and the reader's stay lent");
            if n % 3 == 0 {
                let sample = reader.latest().unwrap();
                assert_eq!((sample.data, sample.bytes), (&[n; 8][..], &[n; 16][..]));
            }
        }
        reader.latest().unwrap();
        assert_eq!(pool.stats().free, 3);
        reader.release();
        assert_eq!(pool.stats().free, 4);
        assert!(reader.latest().is_none());
    }
}

#[test]
fn a_sole_reader_can_take_the_frame_and_change_it_in_place() {
    let pool = FramePool::new(2, 8, 8).unwrap();
    let (writer, mut reader) = stream_link(Payload::Frame, Queue::Latest);
    let _ = writer.push_frame(pool.loan().unwrap().freeze(8), Meta::default());
    reader.latest().unwrap();
    assert!(reader.frame().unwrap().is_unique());
    let address = reader.frame().unwrap().bytes().as_ptr();
    let mut mine = reader.take_frame().unwrap().try_unique().unwrap();
    assert_eq!(mine.parts_mut().1.as_ptr(), address, "no copy");
    assert!(reader.frame().is_none() && reader.latest().is_none());
}

#[test]
fn whoever_is_left_learns_that_the_other_end_is_gone() {
    for queue in [Queue::Latest, fifo(2, DropPolicy::DropOldest)] {
        let pool = FramePool::new(4, 8, 8).unwrap();
        let (writer, mut reader) = stream_link(Payload::Frame, queue);
        for _ in 0..2 {
            let _ = writer.push_frame(pool.loan().unwrap().freeze(8), Meta::default());
        }
        reader.next().unwrap();
        assert!(reader.has_writer() && writer.has_reader());
        drop(reader);
        assert_eq!(pool.stats().free, 4, "the reader's end gives all frames back");
        assert_eq!(writer.push_frame(pool.loan().unwrap().freeze(8), Meta::default()), Pushed::NoReader);
        let stats = writer.stats();
        assert_eq!((stats.pushed, stats.taken + stats.dropped), (3, 3));

        let (writer, mut reader) = stream_link(PLAIN, queue);
        let _ = push(&writer, 1);
        drop(writer);
        assert!(!reader.has_writer());
        assert_eq!(next(&mut reader), Some(1), "what was sent is still there");
    }
}

#[test]
fn a_link_with_both_ends_gone_gives_its_frames_back() {
    let pool = FramePool::new(4, 8, 8).unwrap();
    let (writer, reader) = stream_link(Payload::Frame, fifo(3, DropPolicy::DropOldest));
    for _ in 0..3 {
        let _ = writer.push_frame(pool.loan().unwrap().freeze(8), Meta::default());
    }
    drop((writer, reader));
    assert_eq!(pool.stats().free, 4);
}

/// A writer and a reader at full speed: order, wholeness, and drops that equal the gaps exactly.
fn every_sample_is_seen_or_counted(queue: Queue, newest: bool) {
    const SAMPLES: u64 = 30_000;
    const BYTES: usize = 72;
    let (writer, mut reader) = stream_link(Payload::Plain { bytes: BYTES }, queue);
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        let writer = &writer;
        scope.spawn(|| {
            for seq in 1..=SAMPLES {
                let data = [seq as u8; BYTES];
                let _ = writer.push(&data, Meta { stamp_ns: seq * 2, came_ns: 0, seq });
                if seq % 16 == 0 {
                    thread::yield_now();
                }
            }
            done.store(true, Ordering::Release);
        });
        let (mut last, mut gaps, mut seen) = (0, 0, 0);
        loop {
            let finished = done.load(Ordering::Acquire);
            let sample = if newest { reader.latest().filter(|s| s.fresh) } else { reader.next() };
            let Some(sample) = sample else {
                if finished {
                    break;
                }
                continue;
            };
            assert!(sample.meta.seq > last, "{} after {last}", sample.meta.seq);
            assert_eq!(sample.meta.stamp_ns, sample.meta.seq * 2);
            assert!(sample.data.iter().all(|&b| b == sample.meta.seq as u8), "torn sample");
            gaps += sample.meta.seq - last - 1;
            last = sample.meta.seq;
            seen += 1;
        }
        let stats = writer.stats();
        assert_eq!((stats.pushed, stats.taken), (SAMPLES, seen));
        assert_eq!(stats.dropped, gaps + (SAMPLES - last), "drops and sequence gaps differ");
    });
}

#[test]
fn a_latest_link_under_load_counts_exactly() {
    every_sample_is_seen_or_counted(Queue::Latest, true);
}

#[test]
fn a_dropping_queue_under_load_counts_exactly() {
    every_sample_is_seen_or_counted(fifo(4, DropPolicy::DropOldest), false);
    every_sample_is_seen_or_counted(fifo(1, DropPolicy::DropOldest), false);
    every_sample_is_seen_or_counted(fifo(3, DropPolicy::DropOldest), true);
}

#[test]
fn a_keeping_queue_under_load_counts_exactly() {
    every_sample_is_seen_or_counted(fifo(4, DropPolicy::DropNewest), false);
}

#[test]
fn two_producers_at_once_lose_samples_but_never_the_count() {
    let (writer, mut reader) = stream_link(PLAIN, fifo(8, DropPolicy::DropOldest));
    thread::scope(|scope| {
        for base in [0, 1 << 40] {
            let writer = &writer;
            scope.spawn(move || {
                for n in 0..20_000 {
                    let _ = push(writer, base + n);
                }
            });
        }
    });
    while next(&mut reader).is_some() {}
    let stats = reader.stats();
    assert_eq!((stats.pushed, stats.taken + stats.dropped), (40_000, 40_000), "{stats:?}");
}

proptest! {
    #[test]
    fn one_thread_sees_what_a_simple_queue_would_do(
        depth in 0..6usize, oldest in any::<bool>(), acts in prop::collection::vec(0..6u8, 0..100)
    ) {
        // Depth 0 stands for a latest link, which is a queue of one that drops the oldest.
        let policy = if oldest { DropPolicy::DropOldest } else { DropPolicy::DropNewest };
        let (queue, depth, oldest) =
            if depth == 0 { (Queue::Latest, 1, true) } else { (fifo(depth, policy), depth, oldest) };
        let (writer, mut reader) = stream_link(PLAIN, queue);
        let mut model = VecDeque::new();
        let mut seen = None;
        let (mut taken, mut dropped, mut seq) = (0, 0, 0);
        for act in acts {
            match act {
                0..=2 => {
                    seq += 1;
                    let full = model.len() == depth;
                    dropped += u64::from(full);
                    let expected = match (full, oldest) {
                        (false, _) => Pushed::Queued,
                        (true, true) => Pushed::DroppedOldest,
                        (true, false) => Pushed::DroppedNewest,
                    };
                    if full && oldest {
                        model.pop_front();
                    }
                    if model.len() < depth {
                        model.push_back(seq);
                    }
                    prop_assert_eq!(push(&writer, seq), expected);
                }
                3 => {
                    let expected = model.pop_front();
                    taken += u64::from(expected.is_some());
                    seen = expected.or(seen);
                    prop_assert_eq!(next(&mut reader), expected);
                }
                4 => {
                    let newest = model.pop_back();
                    dropped += model.len() as u64;
                    taken += u64::from(newest.is_some());
                    model.clear();
                    let fresh = newest.is_some();
                    seen = newest.or(seen);
                    prop_assert_eq!(reader.latest().map(|s| (s.meta.seq, s.fresh)), seen.map(|s| (s, fresh)));
                }
                _ => {
                    reader.release();
                    seen = None;
                }
            }
            let stats = reader.stats();
            prop_assert_eq!((stats.pushed, stats.taken, stats.dropped), (seq, taken, dropped));
        }
    }
}

proptest! {
    /// Samples written by the thread that reads, or by way of the exchange: the newest counts, and a sample
    /// in sight stays.
    #[test]
    fn samples_of_the_reading_thread_come_with_the_others_by_their_number(ops in prop::collection::vec(0u8..4, 1..60)) {
        let (writer, mut reader) = stream_link(PLAIN, Queue::Latest);
        let (mut seq, mut seen) = (0u64, 0u64);
        for op in ops {
            match op {
                0 | 1 => {
                    seq += 1;
                    let (data, meta) = (seq.to_ne_bytes(), Meta { stamp_ns: seq, came_ns: 0, seq });
                    if op == 0 {
                        let _ = writer.push(&data, meta);
                    } else {
                        // SAFETY: this thread holds the reader.
                        let _ = unsafe { writer.push_here(&data, meta) };
                    }
                }
                2 => {
                    let got = next(&mut reader);
                    prop_assert_eq!(got, (seq > seen).then_some(seq));
                    seen = seq;
                }
                _ => {
                    let got = reader.latest().map(|s| (s.meta.seq, s.fresh));
                    prop_assert_eq!(got, (seq > 0).then_some((seq, seq > seen)));
                    seen = seq;
                }
            }
            if seen > 0 {
                let now = reader.current().unwrap();
                prop_assert_eq!((now.meta.seq, now.data), (seen, &seen.to_ne_bytes()[..]), "what was shown has changed");
            }
        }
        next(&mut reader);
        let stats = reader.stats();
        prop_assert_eq!((stats.pushed, stats.taken + stats.dropped), (seq, seq));
        let counters = reader.counters();
        // SAFETY: as above.
        let _ = unsafe { writer.push_here(&0u64.to_ne_bytes(), Meta { stamp_ns: 0, came_ns: 0, seq: seq + 1 }) };
        drop(reader);
        prop_assert_eq!(counters.stats().dropped, stats.dropped + 1, "what nobody took counts as dropped");
    }
}

#[test]
fn what_is_no_plain_sample_of_a_latest_link_goes_the_common_way() {
    let meta = |seq| Meta { stamp_ns: 0, came_ns: 0, seq };
    let (writer, mut reader) = stream_link(PLAIN, fifo(2, DropPolicy::DropNewest));
    for (seq, pushed) in [(1, Pushed::Queued), (2, Pushed::Queued), (3, Pushed::DroppedNewest)] {
        // SAFETY: this thread holds the reader.
        assert_eq!(unsafe { writer.push_here(&u64::to_ne_bytes(seq), meta(seq)) }, pushed);
    }
    assert_eq!((next(&mut reader), next(&mut reader)), (Some(1), Some(2)));
    // SAFETY: as above.
    assert_eq!(unsafe { writer.push_here(&[0; 9], meta(4)) }, Pushed::WrongPayload);
    drop(reader);
    // SAFETY: as above.
    assert_eq!(unsafe { writer.push_here(&[0; 8], meta(5)) }, Pushed::NoReader);
}
