//! Links: samples come whole, in order, and all are counted.

use loom::thread;

use super::model;
use crate::pool::FramePool;
use crate::stream::{DropPolicy, Meta, Payload, Pushed, Queue, StreamReader, StreamWriter, stream_link};

/// Three samples against a reader that looks twice: order, wholeness and the counts.
fn samples_come_in_order_and_all_are_counted(queue: Queue) {
    model(move || {
        let (writer, mut reader) = stream_link(Payload::Plain { bytes: 8 }, queue);
        let thread = thread::spawn(move || {
            for seq in 1..=3u64 {
                let _ = writer.push(&(seq * 10).to_ne_bytes(), Meta { stamp_ns: 0, came_ns: 0, seq });
            }
            writer
        });
        let (mut last, mut gaps) = (0, 0);
        let mut look = |reader: &mut StreamReader| {
            let Some(sample) = reader.next() else { return false };
            assert_eq!(sample.data, (sample.meta.seq * 10).to_ne_bytes(), "torn sample");
            assert!(sample.meta.seq > last, "{} after {last}", sample.meta.seq);
            gaps += sample.meta.seq - last - 1;
            last = sample.meta.seq;
            true
        };
        look(&mut reader);
        let writer = thread.join().unwrap();
        while look(&mut reader) {}
        let stats = writer.stats();
        assert_eq!((stats.pushed, stats.taken + stats.dropped), (3, 3), "{stats:?}");
        assert_eq!(gaps + (3 - last), stats.dropped, "gaps");
    });
}

#[test]
fn loom_a_latest_link_counts_every_sample() {
    samples_come_in_order_and_all_are_counted(Queue::Latest);
}

#[test]
fn loom_a_dropping_queue_counts_every_sample() {
    samples_come_in_order_and_all_are_counted(Queue::Fifo { depth: 1, drop: DropPolicy::DropOldest });
}

#[test]
fn loom_a_keeping_queue_counts_every_sample() {
    samples_come_in_order_and_all_are_counted(Queue::Fifo { depth: 1, drop: DropPolicy::DropNewest });
}

/// Three samples against a reader that goes on to the newest of a full queue: the sample that gives way is
/// always an older one.
#[test]
fn loom_a_dropping_queue_never_gives_up_its_newest_sample() {
    model(|| {
        let (writer, mut reader) =
            stream_link(Payload::Plain { bytes: 8 }, Queue::Fifo { depth: 2, drop: DropPolicy::DropOldest });
        let push = |writer: &StreamWriter, seq: u64| {
            writer.push(&seq.to_ne_bytes(), Meta { stamp_ns: 0, came_ns: 0, seq })
        };
        assert_eq!(push(&writer, 1), Pushed::Queued);
        assert!(reader.next().is_some(), "held while the next ones come");
        assert_eq!((push(&writer, 2), push(&writer, 3)), (Pushed::Queued, Pushed::Queued));
        let thread = thread::spawn(move || {
            for seq in 4..=6 {
                assert_ne!(push(&writer, seq), Pushed::DroppedNewest, "sample {seq}");
            }
            writer
        });
        assert!(reader.latest().is_some());
        let writer = thread.join().unwrap();
        assert_eq!(reader.latest().map(|sample| sample.meta.seq), Some(6));
        let stats = writer.stats();
        assert_eq!((stats.pushed, stats.taken + stats.dropped), (6, 6), "{stats:?}");
    });
}

/// A push that finds no slot free takes frames out of the queue, down to none, while the reader takes them
/// from the same end.
#[test]
fn loom_frames_given_up_for_a_slot_are_taken_by_one_end_and_counted() {
    model(|| {
        let pool = FramePool::new(3, 8, 0).unwrap();
        let queue = Queue::Fifo { depth: 4, drop: DropPolicy::DropOldest };
        let (writer, mut reader) = stream_link(Payload::Frame, queue);
        let push = |writer: &StreamWriter, seq: u64| {
            let mut writing = pool.loan().expect("a slot for each of three frames");
            writing.parts_mut().0[0] = seq as u8;
            writer.push_frame(writing.freeze(0), Meta { stamp_ns: 0, came_ns: 0, seq })
        };
        assert_eq!((push(&writer, 1), push(&writer, 2)), (Pushed::Queued, Pushed::Queued));
        let mut last = 0;
        let mut look = |reader: &mut StreamReader| {
            let Some(sample) = reader.next() else { return false };
            assert_eq!(u64::from(sample.data[0]), sample.meta.seq, "another frame's slot");
            assert!(sample.meta.seq > last, "{} after {last}", sample.meta.seq);
            last = sample.meta.seq;
            true
        };
        let lent = std::sync::Arc::clone(&pool);
        let thread = thread::spawn(move || {
            let mut writing = lent.loan().expect("the third slot");
            writing.parts_mut().0[0] = 3;
            assert_ne!(
                writer.push_frame(writing.freeze(0), Meta { stamp_ns: 0, came_ns: 0, seq: 3 }),
                Pushed::DroppedNewest
            );
            writer
        });
        look(&mut reader);
        look(&mut reader);
        let writer = thread.join().unwrap();
        while look(&mut reader) {}
        assert_eq!(last, 3, "the newest is never given up");
        let stats = writer.stats();
        assert_eq!((stats.pushed, stats.taken + stats.dropped), (3, 3), "{stats:?}");
        drop((reader, writer));
        assert_eq!(pool.stats().free, 3);
    });
}
