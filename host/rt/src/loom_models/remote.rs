//! Two ends of a link that share nothing but its memory: bells, and frames that are lent.

use std::sync::Arc;

use loom::sync::atomic::{AtomicU64, Ordering};
use loom::thread;

use super::{Plain, model, model_within};
use crate::pool::{FramePool, PoolFile};
use crate::region::{Layout, Region};
use crate::stream::{
    Meta, Payload, Pushed, Queue, RemotePools, RemoteViews, StreamReader, StreamWriter, remote_reader,
    remote_writer,
};
use crate::wake::{Waker, wait_any};

#[test]
fn loom_who_sleeps_on_a_waker_and_a_bell_misses_neither() {
    model(|| {
        let own = Arc::new(Waker::new());
        let bells = [Arc::new(Waker::new())];
        let brought = Arc::new((AtomicU64::new(0), AtomicU64::new(0)));
        let (bell, there) = (Arc::clone(&bells[0]), Arc::clone(&brought));
        let other = thread::spawn(move || {
            there.0.store(1, Ordering::Relaxed);
            bell.notify();
        });
        let (mine, here) = (Arc::clone(&own), Arc::clone(&brought));
        let friend = thread::spawn(move || {
            here.1.store(1, Ordering::Relaxed);
            mine.notify();
        });
        let (mut rung, mut told) = (false, false);
        while !(rung && told) {
            wait_any(&own, &bells, None);
            if bells[0].take() {
                assert_eq!(brought.0.load(Ordering::Relaxed), 1, "a bell without what it was rung for");
                rung = true;
            }
            // The wait uses up a notification of its own: its cause is there then, or this goes on for ever.
            told |= brought.1.load(Ordering::Relaxed) == 1;
        }
        other.join().unwrap();
        friend.join().unwrap();
    });
}

/// A sample of another process is copied once: neither the copy nor its meta is ever torn or of two samples.
#[test]
fn loom_a_sample_of_another_process_is_whole_and_stays() {
    model(|| {
        let (pools, views) = (Arc::new(RemotePools::default()), RemoteViews::new(0));
        let payload = Payload::Plain { bytes: 8 };
        let region = Region::heap(Layout::measure(|l| remote_writer(l, payload, Queue::Latest, &pools)));
        let writer = remote_writer(&mut Layout::fresh(&region), payload, Queue::Latest, &pools);
        let mut reader = remote_reader(&mut Layout::of_other_end(&region), payload, Queue::Latest, &views);
        let other = thread::spawn(move || {
            for seq in 1..=2u64 {
                let _: Pushed =
                    writer.push(&(seq * 10).to_ne_bytes(), Meta { stamp_ns: seq, came_ns: 0, seq });
            }
        });
        for _ in 0..2 {
            let Some(seq) = reader.next().map(|sample| sample.meta.seq) else { continue };
            let now = reader.current().expect("what was seen stays");
            assert_eq!((now.meta.seq, now.data), (seq, &(seq * 10).to_ne_bytes()[..]), "two samples in one");
        }
        other.join().unwrap();
    });
}

/// A pool of so many slots, and both ends of a stream of its frames.
fn frames(slots: u32) -> (Arc<FramePool>, Arc<RemotePools>, StreamWriter, StreamReader) {
    let pool = FramePool::new(slots, 8, 0).unwrap();
    let file = Arc::clone(pool.file().unwrap());
    let (pools, views) = (Arc::new(RemotePools::default()), RemoteViews::new(8));
    assert_eq!(pools.place_of(file.number()), Some(0));
    assert!(views.know(0, PoolFile::numbered(file.number()).unwrap()));
    let region = Region::heap(Layout::measure(|l| remote_writer(l, Payload::Frame, Queue::Latest, &pools)));
    let writer = remote_writer(&mut Layout::fresh(&region), Payload::Frame, Queue::Latest, &pools);
    let reader = remote_reader(&mut Layout::of_other_end(&region), Payload::Frame, Queue::Latest, &views);
    (pool, pools, writer, reader)
}

/// The reader's look at a frame comes before any later write into its slot, and every lease ends once.
#[test]
fn loom_a_lent_frame_is_written_anew_only_after_its_reader_has_let_go() {
    model(|| {
        let (pool, pools, writer, mut reader) = frames(1);
        let content = Arc::new(Plain::new());
        let theirs = Arc::clone(&content);
        let other = thread::spawn(move || {
            for _ in 0..2 {
                if reader.next().is_some() {
                    assert!(theirs.get() > 0);
                    reader.release();
                }
            }
        });
        for seq in 1..=2 {
            if let Some(writing) = pool.loan() {
                content.set(seq);
                let _: Pushed = writer.push_frame(writing.freeze(0), Meta { stamp_ns: 0, came_ns: 0, seq });
            }
        }
        other.join().unwrap();
        drop(writer);
        assert!(pools.are_back(), "a lease was lost");
        assert_eq!(pool.stats().free, 1, "a slot was lost");
    });
}

/// A thread that takes frames back beside the writer turns no push away, loses no lease and ends none twice.
#[test]
fn loom_frames_are_taken_back_beside_a_writer_that_goes_on() {
    model_within(3, || {
        let (pool, pools, writer, mut reader) = frames(2);
        let frame =
            |seq| (pool.loan().map(|writing| writing.freeze(0)), Meta { stamp_ns: 0, came_ns: 0, seq });
        let (first, meta) = frame(1);
        assert_eq!(writer.push_frame(first.expect("both are free"), meta), Pushed::Queued);
        assert!(reader.next().is_some());
        reader.release();
        let theirs = Arc::clone(&pools);
        let manager = thread::spawn(move || theirs.collect());
        let (second, meta) = frame(2);
        assert_eq!(writer.push_frame(second.expect("one is free"), meta), Pushed::Queued);
        manager.join().unwrap();
        assert!(reader.next().is_some());
        drop(reader);
        drop(writer);
        assert!(pools.are_back(), "a lease was lost");
        assert_eq!(pool.stats().free, 2, "a slot was lost");
    });
}
