//! Frames are lent once, shared by count, given back once, and outlive their pool's owner.
#![allow(clippy::unwrap_used)]

use std::collections::HashSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::thread;

use proptest::prelude::*;
use trocar_rt::pool::{Frame, FrameMut, FramePool};

#[test]
fn a_frame_carries_header_and_bytes_aligned_to_64() {
    let pool = FramePool::new(3, 40, 100).unwrap();
    let mut writing = pool.loan().unwrap();
    assert_eq!((writing.header_ptr() as usize % 64, writing.bytes_ptr() as usize % 64), (0, 0));
    assert_eq!(writing.capacity(), 100);
    let (header, bytes) = writing.parts_mut();
    assert_eq!((header.len(), bytes.len()), (40, 100));
    header.fill(1);
    bytes.fill(2);
    let frame = writing.freeze(60);
    assert_eq!((frame.header(), frame.bytes()), (&[1; 40][..], &[2; 60][..]));
}

#[test]
fn slots_do_not_overlap() {
    let pool = FramePool::new(70, 8, 24).unwrap();
    let mut lent: Vec<FrameMut> = std::iter::from_fn(|| pool.loan()).collect();
    assert_eq!(lent.len(), 70);
    for (n, frame) in lent.iter_mut().enumerate() {
        let (header, bytes) = frame.parts_mut();
        header.fill(n as u8);
        bytes.fill(n as u8);
    }
    for (n, frame) in lent.into_iter().enumerate() {
        let frame = frame.freeze(24);
        assert!(frame.header().iter().chain(frame.bytes()).all(|&b| b == n as u8));
    }
}

#[test]
fn an_exhausted_pool_refuses_and_counts() {
    let pool = FramePool::new(2, 0, 64).unwrap();
    let lent = (pool.loan().unwrap(), pool.loan().unwrap());
    assert!(pool.loan().is_none());
    let stats = pool.stats();
    assert_eq!((stats.slots, stats.free, stats.high_water, stats.exhausted), (2, 0, 2, 1));
    drop(lent);
    assert_eq!(pool.stats().free, 2);
}

#[test]
fn a_slot_comes_back_with_its_last_frame() {
    let pool = FramePool::new(1, 8, 8).unwrap();
    let frame = pool.loan().unwrap().freeze(8);
    let clone = frame.clone();
    assert!(!frame.is_unique());
    drop(frame);
    assert!(pool.loan().is_none());
    assert!(clone.is_unique());
    drop(clone);
    assert!(pool.loan().is_some());
}

#[test]
fn only_the_last_holder_may_write_in_place() {
    let pool = FramePool::new(1, 8, 8).unwrap();
    let frame = pool.loan().unwrap().freeze(8);
    let clone = frame.clone();
    let frame = frame.try_unique().unwrap_err();
    drop(clone);
    let mut writing = frame.try_unique().unwrap();
    writing.parts_mut().1.fill(9);
    assert_eq!(writing.freeze(2).bytes(), [9, 9]);
}

#[test]
fn a_frame_outlives_the_owner_of_its_pool() {
    let pool = FramePool::new(1, 8, 8).unwrap();
    let weak = Arc::downgrade(&pool);
    let frame = pool.loan().unwrap().freeze(8);
    drop(pool);
    assert_eq!(frame.clone().bytes(), [0; 8]);
    drop(frame);
    assert!(weak.upgrade().is_none(), "the pool went with its last frame");
}

#[test]
fn a_number_brings_its_frame_back_once() {
    let pool = FramePool::new(1, 8, 8).unwrap();
    let raw = pool.loan().unwrap().into_raw();
    // SAFETY: numbers from `into_raw` of a living pool.
    unsafe {
        assert!(Frame::from_raw(raw).is_none(), "a frame being written is not a frame");
        let writing = FrameMut::from_raw(raw).unwrap();
        assert!(FrameMut::from_raw(raw).is_none(), "committed twice");
        let shared = writing.freeze(3).into_raw();
        assert!(FrameMut::from_raw(shared).is_none(), "a written frame is not writable");
        let frame = Frame::from_raw(shared).unwrap();
        assert_eq!(frame.bytes().len(), 3);
        drop(frame);
        assert!(Frame::from_raw(shared).is_none(), "released twice");
        assert!(Frame::from_raw(0).is_none());
    }
    assert_eq!(pool.stats().free, 1);
}

#[test]
fn the_pool_is_a_sealed_memfd_that_others_can_read_but_not_shrink_or_write() {
    let pool = FramePool::new(2, 64, 64).unwrap();
    let (first, mut second) = (pool.loan().unwrap(), pool.loan().unwrap());
    second.parts_mut().0.fill(7);
    let mut file = File::from(pool.file().unwrap().fd().try_clone_to_owned().unwrap());
    assert!(file.set_len(10).is_err(), "shrunk");
    // SAFETY: a refused mapping touches nothing; an accepted one fails the test.
    let mapped = unsafe {
        libc::mmap(std::ptr::null_mut(), 64, libc::PROT_WRITE, libc::MAP_SHARED, file.as_raw_fd(), 0)
    };
    assert_eq!(mapped, libc::MAP_FAILED, "a second writable mapping");
    let mut header = [0; 64];
    file.seek(SeekFrom::Start(pool.file().unwrap().stride() as u64)).unwrap();
    file.read_exact(&mut header).unwrap();
    assert_eq!(header, [7; 64]);
    drop(first);
}

#[test]
fn impossible_pools_are_refused_with_their_size() {
    let none = FramePool::new(0, 8, 8).map(drop).unwrap_err();
    assert!(none.to_string().contains("0 slots"), "{none}");
    let huge = FramePool::new(8, 8, usize::MAX).map(drop).unwrap_err();
    assert!(huge.to_string().contains("cannot exist"), "{huge}");
}

#[test]
fn a_pool_larger_than_the_available_memory_is_refused_before_any_of_it_is_taken() {
    // 1 TiB: more than a test machine has, and a size whose pages must never be asked for.
    let large = FramePool::new(1, 0, 1 << 40).map(drop).unwrap_err();
    assert_eq!(large.kind(), std::io::ErrorKind::OutOfMemory);
    assert!(large.to_string().contains("fewer or smaller slots"), "{large}");
}

#[test]
fn threads_that_share_frames_never_meet_in_a_slot() {
    let pool = FramePool::new(4, 8, 64).unwrap();
    thread::scope(|scope| {
        for thread in 1..=3u8 {
            let pool = &pool;
            scope.spawn(move || {
                for round in 0..5_000u64 {
                    let Some(mut writing) = pool.loan() else { continue };
                    let (header, bytes) = writing.parts_mut();
                    header.copy_from_slice(&round.to_ne_bytes());
                    bytes.fill(thread);
                    let frame = writing.freeze(64);
                    let clone = frame.clone();
                    drop(frame);
                    assert_eq!(clone.header(), round.to_ne_bytes());
                    assert!(clone.bytes().iter().all(|&b| b == thread), "two writers in one slot");
                }
            });
        }
    });
    assert_eq!(pool.stats().free, 4);
}

proptest! {
    #[test]
    fn lent_and_free_slots_always_add_up(slots in 1..80u32, acts in prop::collection::vec(0..4u8, 0..200)) {
        let pool = FramePool::new(slots, 0, 1).unwrap();
        let mut held: Vec<Frame> = Vec::new();
        for (n, act) in acts.into_iter().enumerate() {
            match act {
                0 | 1 => {
                    let distinct: HashSet<_> = held.iter().map(|f| f.bytes().as_ptr()).collect();
                    let loan = pool.loan();
                    prop_assert_eq!(loan.is_some(), distinct.len() < slots as usize);
                    held.extend(loan.map(|l| l.freeze(1)));
                }
                2 if !held.is_empty() => held.push(held[n % held.len()].clone()),
                _ if !held.is_empty() => drop(held.swap_remove(n % held.len())),
                _ => {}
            }
            let distinct: HashSet<_> = held.iter().map(|f| f.bytes().as_ptr()).collect();
            prop_assert_eq!(pool.stats().free, slots - distinct.len() as u32);
        }
    }
}

#[test]
fn a_number_is_known_by_the_pool_whose_slot_it_names_and_by_no_other() {
    let (pool, other) = (FramePool::new(3, 8, 64).unwrap(), FramePool::new(3, 8, 64).unwrap());
    let raw = pool.loan().unwrap().into_raw();
    assert!(pool.is_descriptor(raw) && !other.is_descriptor(raw));
    // SAFETY: the number of a living pool.
    drop(unsafe { FrameMut::from_raw(raw) });
    assert!(pool.is_descriptor(raw), "whatever has become of the frame");
    let address = raw << 16 >> 16;
    for number in [0, 1, 63, u64::MAX, address + 2, address + 32, address - 64, address + 3 * 64] {
        assert!(!pool.is_descriptor(number), "{number:#x} begins no slot of it");
    }
}
