//! The two ends of a link as two processes have them: each lays its parts out in a mapping of its own of the
//! same memory.
#![allow(clippy::unwrap_used)]

mod parts;

use std::sync::Arc;
use std::thread;

use trocar_rt::mailbox::{EntryHead, Mailbox, Overflow, Push};
use trocar_rt::pool::{FramePool, PoolFile};
use trocar_rt::region::{Layout, Region};
use trocar_rt::reply::{Reply, ReplyPool};
use trocar_rt::stream::{
    Meta, POOLS_PER_LINK, Payload, Pushed, Queue, RemotePools, RemoteViews, StreamReader, StreamWriter,
    remote_reader, remote_writer,
};
use trocar_rt::wake::{self, Waker};

use parts::{FIFO, KEEPS_OLD, QUEUES, reading, writing};

/// Returns both ends of the parts that are laid out.
fn both<A, B>(first: impl Fn(&mut Layout) -> A, second: impl Fn(&mut Layout) -> B) -> (A, B) {
    let (here, there) = regions(&first);
    (first(&mut Layout::fresh(&here)), second(&mut Layout::of_other_end(&there)))
}

fn regions<A>(parts: impl Fn(&mut Layout) -> A) -> (Arc<Region>, Arc<Region>) {
    let bytes = Layout::measure(parts);
    let here = Region::shared(bytes).unwrap();
    let there = Region::open(here.fd().unwrap().try_clone_to_owned().unwrap(), bytes).unwrap();
    (here, there)
}

fn stream(
    payload: Payload,
    queue: Queue,
) -> (StreamWriter, StreamReader, Arc<RemotePools>, Arc<RemoteViews>) {
    let (pools, views) = (Arc::new(RemotePools::default()), RemoteViews::new(8));
    let (writer, reader) = both(
        |layout| remote_writer(layout, payload, queue, &pools),
        |layout| remote_reader(layout, payload, queue, &views),
    );
    (writer, reader, pools, views)
}

fn meta(seq: u64) -> Meta {
    Meta { stamp_ns: 1000 + seq, came_ns: 0, seq }
}

#[test]
fn a_queue_keeps_its_order_and_every_gap_is_counted_at_both_ends() {
    let plain = Payload::Plain { bytes: 8 };
    for (queue, first) in [(FIFO, 7), (KEEPS_OLD, 1)] {
        let (writer, mut reader, ..) = stream(plain, queue);
        for seq in 1..=10u64 {
            let _ = writer.push(&seq.to_ne_bytes(), meta(seq));
        }
        let mut seen = Vec::new();
        while let Some(sample) = reader.next() {
            assert_eq!(sample.data, sample.meta.seq.to_ne_bytes());
            seen.push(sample.meta.seq);
        }
        assert_eq!(seen, (first..first + 4).collect::<Vec<_>>());
        let stats = writer.stats();
        assert_eq!((stats.pushed, stats.taken, stats.dropped), (10, 4, 6));
        assert_eq!(reader.stats(), stats, "the ends disagree");
    }
}

#[test]
fn a_sample_stays_as_it_is_while_its_reader_looks_at_it() {
    let (writer, mut reader, ..) = stream(Payload::Plain { bytes: 8 }, Queue::Latest);
    let _ = writer.push(&1u64.to_ne_bytes(), meta(1));
    let sample = reader.latest().unwrap();
    assert!(sample.fresh);
    let data = sample.data.to_vec();
    for seq in 2..9u64 {
        let _ = writer.push(&seq.to_ne_bytes(), meta(seq));
    }
    assert_eq!(reader.current().unwrap().data, data);
    assert_eq!(reader.latest().unwrap().meta.seq, 8);
    assert_eq!(writer.stats().dropped, 6);
}

fn frame(pool: &Arc<FramePool>, tag: u8) -> trocar_rt::Frame {
    let mut writing = pool.loan().unwrap();
    let (header, bytes) = writing.parts_mut();
    header.fill(tag);
    bytes.fill(tag);
    writing.freeze(64)
}

fn tell(pool: &Arc<FramePool>, pools: &RemotePools, views: &RemoteViews, place: usize) {
    let file = pool.file().unwrap();
    let theirs = PoolFile::open(file.fd().try_clone_to_owned().unwrap(), file.shape()).unwrap();
    assert!(views.know(place, theirs));
    assert_eq!(pools.place_of(file.number()), Some(place as u32));
}

#[test]
fn frames_are_lent_and_come_back_when_their_last_handle_goes() {
    for queue in [Queue::Latest, FIFO] {
        let pool = FramePool::new(8, 8, 64).unwrap();
        let (writer, mut reader, pools, views) = stream(Payload::Frame, queue);
        tell(&pool, &pools, &views, 0);
        let _ = writer.push_frame(frame(&pool, 7), meta(1));
        let sample = reader.next().unwrap();
        assert_eq!((sample.data, sample.bytes), (&[7u8; 8][..], &[7u8; 64][..]));
        let kept = reader.frame().unwrap().clone();
        assert!(!kept.is_unique(), "a frame of another process could be written");
        reader.release();
        for seq in 2..40u64 {
            let pushed = writer.push_frame(frame(&pool, seq as u8), meta(seq));
            assert_ne!(pushed, Pushed::WrongPayload);
            if let Some(sample) = reader.next() {
                assert_eq!(sample.data, [sample.meta.seq as u8; 8]);
            }
        }
        assert_eq!(kept.bytes(), [7u8; 64], "a frame that is held was written anew");
        let (clone, thread) = (kept.clone(), thread::spawn(move || drop(kept)));
        thread.join().unwrap();
        drop(clone);
        reader.release();
        while reader.next().is_some() {}
        drop(reader);
        drop(writer);
        assert!(pools.are_back());
        assert_eq!(pool.stats().free, 8, "slots were lost ({queue:?})");
    }
}

#[test]
fn whoever_looks_now_and_then_takes_frames_back_only_where_the_writer_is_idle() {
    let pool = FramePool::new(8, 8, 64).unwrap();
    let (writer, mut reader, pools, views) = stream(Payload::Frame, FIFO);
    tell(&pool, &pools, &views, 0);
    for seq in 1..4u64 {
        assert_eq!(writer.push_frame(frame(&pool, 1), meta(seq)), Pushed::Queued);
        assert!(reader.next().is_some());
        reader.release();
        pools.collect_if_idle();
        assert_eq!(pool.stats().free, 7, "the writer is at work, and takes it back with its next push");
    }
    pools.collect_if_idle();
    assert_eq!(pool.stats().free, 8, "nothing was sent since");
}

#[test]
fn a_reader_that_dies_with_frames_in_hand_costs_none_of_them() {
    let pool = FramePool::new(8, 8, 64).unwrap();
    let (writer, mut reader, pools, views) = stream(Payload::Frame, FIFO);
    tell(&pool, &pools, &views, 0);
    for seq in 1..4 {
        let _ = writer.push_frame(frame(&pool, 1), meta(seq));
    }
    assert!(reader.next().is_some());
    let held = reader.frame().unwrap().clone();
    // Killed: neither its drop nor its bits ever come.
    let _dead = std::mem::ManuallyDrop::new((reader, held));
    drop(writer);
    assert!(!pools.are_back());
    // Its process is gone.
    drop(pools);
    assert_eq!(pool.stats().free, 8);
}

#[test]
fn a_frame_that_is_held_stays_as_it_is_when_its_link_goes() {
    let pool = FramePool::new(2, 8, 64).unwrap();
    let (writer, mut reader, pools, views) = stream(Payload::Frame, Queue::Latest);
    tell(&pool, &pools, &views, 0);
    let _ = writer.push_frame(frame(&pool, 7), meta(1));
    assert!(reader.next().is_some());
    let held = reader.frame().unwrap().clone();
    drop(writer);
    drop(reader);
    assert!(!pools.are_back());
    let other = frame(&pool, 9);
    assert!(pool.loan().is_none(), "the held one was lent anew");
    assert_eq!((held.bytes(), other.bytes()), (&[7; 64][..], &[9; 64][..]));
    drop(held);
    assert!(pools.are_back());
    assert!(pool.loan().is_some());
}

#[test]
fn a_frame_whose_pool_is_not_mapped_yet_waits_for_it() {
    for queue in [Queue::Latest, FIFO] {
        let (told, other) = (FramePool::new(2, 8, 64).unwrap(), FramePool::new(4, 8, 64).unwrap());
        let (writer, mut reader, pools, views) = stream(Payload::Frame, queue);
        tell(&told, &pools, &views, 0);
        let _ = writer.push_frame(frame(&told, 1), meta(1));
        assert_eq!(reader.next().unwrap().data, [1; 8]);
        let _ = writer.push_frame(frame(&other, 2), meta(2));
        assert!(reader.next().is_none(), "there is nothing to look at yet ({queue:?})");
        assert!(reader.latest().is_none());
        let _ = writer.push_frame(frame(&other, 3), meta(3));
        assert!(reader.next().is_none());
        assert_eq!(pools.at(1), Some(other.file().unwrap().number()), "it has its place");
        tell(&other, &pools, &views, 1);
        let seen: Vec<u8> = std::iter::from_fn(|| reader.next().map(|sample| sample.data[0])).collect();
        match queue {
            Queue::Latest => assert_eq!(seen, [3]),
            Queue::Fifo { .. } => assert_eq!(seen, [2, 3]),
        }
        let missed = writer.stats().dropped;
        assert_eq!(missed, 2 - seen.len() as u64, "what was not seen is counted");
        assert_eq!(reader.corrupt(), 0);
        drop(reader);
        drop(writer);
        assert!(pools.are_back());
        assert_eq!((told.stats().free, other.stats().free), (2, 4), "slots were lost ({queue:?})");
    }
}

#[test]
fn a_frame_of_one_pool_too_many_is_a_counted_drop_and_seen_by_managers() {
    let pools: Vec<_> = (0..=POOLS_PER_LINK).map(|_| FramePool::new(1, 8, 64).unwrap()).collect();
    let (writer, _reader, known, _views) = stream(Payload::Frame, Queue::Latest);
    for (pool, seq) in pools[..POOLS_PER_LINK].iter().zip(1..) {
        assert_ne!(writer.push_frame(frame(pool, 1), meta(seq)), Pushed::DroppedNewest);
    }
    assert!(!known.has_overflowed());
    assert_eq!(writer.push_frame(frame(&pools[POOLS_PER_LINK], 1), meta(99)), Pushed::DroppedNewest);
    assert!(known.has_overflowed());
}

#[test]
fn commands_and_their_answers_pass_between_two_mappings() {
    let lay = |layout: &mut Layout| {
        (Mailbox::lay_out(layout, 4, 8, 1), ReplyPool::lay_out(layout, 2, 8, 32), Waker::lay_out(layout))
    };
    let ((client, replies, bell), (server, answers, rung)) = both(lay, lay);
    let rung = Arc::new(rung);
    let own = Waker::new();
    let served = thread::spawn(move || {
        let bells = [rung];
        let mut served = 0;
        while served < 100 {
            assert!(wake::wait_any(&own, &bells, None));
            assert!(bells[0].take());
            served += server.drain(
                |head, payload| {
                    let n = u64::from_ne_bytes(payload.try_into().unwrap());
                    let running = answers.begin(head.reply, -1).expect("the caller waits");
                    running.finish(3, |ret, text| {
                        ret[..8].copy_from_slice(&(2 * n).to_ne_bytes());
                        text[..2].copy_from_slice(b"ok");
                        2
                    });
                },
                |_| {},
            );
        }
    });
    for n in 0..100u64 {
        let ticket = replies.acquire().unwrap();
        let head = EntryHead { reply: ticket.token(), ..EntryHead::default() };
        assert_eq!(client.push(head, &n.to_ne_bytes(), Overflow::Reject), Push::Queued);
        bell.notify();
        let deadline = trocar_rt::now_ns() + 60_000_000_000;
        let mut doubled = 0;
        let reply = ticket.wait(deadline, |ret, text| {
            doubled = u64::from_ne_bytes(ret[..8].try_into().unwrap());
            assert_eq!(text, b"ok");
        });
        assert_eq!((reply, doubled), (Reply::Done(3), 2 * n));
    }
    served.join().unwrap();
}

/// Another process may write anything anywhere in the memory of a link: nothing is read or written outside,
/// and no call goes on for ever.
#[test]
fn no_bits_in_the_memory_of_a_link_crash_or_hang_an_end() {
    let mut random = 0x9e37_79b9_7f4a_7c15u64;
    let mut next = move || {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        random
    };
    let pool = FramePool::new(8, 8, 64).unwrap();
    for round in 0..300 {
        let (pools, views) = (Arc::new(RemotePools::default()), RemoteViews::new(8));
        tell(&pool, &pools, &views, 0);
        let queue = QUEUES[round % 3];
        let lay = |layout: &mut Layout| writing(layout, queue, &pools);
        let lay_other = |layout: &mut Layout| reading(layout, queue, &views);
        let bytes = Layout::measure(lay);
        let (here, there) = regions(lay);
        let hostile = Region::open(here.fd().unwrap().try_clone_to_owned().unwrap(), bytes).unwrap();
        let words = Layout::words(&hostile, bytes / 8);
        let (mail, replies, bell, plain, frames) = lay(&mut Layout::fresh(&here));
        let (theirs, answers, rung, mut plain_in, mut frames_in) =
            lay_other(&mut Layout::of_other_end(&there));
        let rung = [Arc::new(rung)];
        let own = Waker::new();
        for step in 0..60u64 {
            for _ in 0..next() % 12 {
                let at = next() as usize % words.len();
                let value = match next() % 4 {
                    0 => next(),
                    1 => next() % 8,
                    2 => u64::MAX - next() % 8,
                    _ => words[at].load(std::sync::atomic::Ordering::Relaxed).wrapping_add(next() % 5),
                };
                words[at].store(value, std::sync::atomic::Ordering::Relaxed);
            }
            let overflow = [Overflow::Reject, Overflow::LatestWins, Overflow::DropOldest][step as usize % 3];
            let ticket = replies.acquire();
            let reply = ticket.as_ref().map_or(0, |t| t.token());
            let head = EntryHead { index: step as u32 % 2, reply, ..EntryHead::default() };
            let _ = mail.push(head, &[1; 24], overflow);
            bell.notify();
            wake::wait_any(&own, &rung, Some(trocar_rt::now_ns()));
            rung[0].take();
            let answer = |head: EntryHead, payload: &[u8]| {
                assert!(payload.len() <= 24);
                if let Some(running) = answers.begin(head.reply, -1) {
                    running.finish(0, |_, _| 1);
                }
            };
            theirs.drain(answer, |_| {});
            theirs.throw_out(|_| {}, |_| {});
            if let Some(ticket) = ticket {
                let _ =
                    ticket.wait(trocar_rt::now_ns(), |ret, text| assert!(ret.len() == 8 && text.len() <= 32));
            }
            let _ = plain.push(&[2; 24], meta(step));
            if let Some(writing) = pool.loan() {
                let _ = frames.push_frame(writing.freeze(8), meta(step));
            }
            if let Some(sample) = plain_in.next() {
                assert_eq!(sample.data.len(), 24);
            }
            if let Some(sample) = frames_in.latest() {
                assert!(sample.data.len() == 8 && sample.bytes.len() <= 64);
                std::hint::black_box(sample.bytes.iter().map(|b| u32::from(*b)).sum::<u32>());
            }
            let _ = (mail.stats(), plain.stats(), frames_in.stats());
        }
    }
    assert_eq!(pool.stats().free, 8, "frames were lost");
}
