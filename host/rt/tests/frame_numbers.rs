//! The numbers of lent frames: each brings its frame back once, however often its slot was lent since.
#![allow(clippy::unwrap_used)]

use trocar_rt::pool::{FrameMut, FramePool};

/// A number keeps 16 bits of its slot's generation.
const ROUNDS: u32 = 70_000;

#[test]
fn a_number_that_was_used_up_is_never_good_again_however_often_its_slot_is_lent() {
    let pool = FramePool::new(1, 8, 8).unwrap();
    let old = pool.loan().unwrap().into_raw();
    // SAFETY: numbers of a living pool, here and below.
    let came_back = |raw| unsafe { FrameMut::from_raw(raw) };
    drop(came_back(old).unwrap());
    for round in 0..ROUNDS {
        assert!(came_back(old).is_none(), "round {round}: of a free slot");
        let writing = pool.loan().unwrap();
        assert!(came_back(old).is_none(), "round {round}: of a slot somebody holds for writing");
        let frame = writing.freeze(1);
        assert!(came_back(old).is_none(), "round {round}: of a slot somebody reads");
        let writing = frame.try_unique().unwrap();
        assert!(came_back(old).is_none(), "round {round}: of a slot written in place");
        let number = writing.into_raw();
        let frame = came_back(number).unwrap().freeze(1);
        assert!(came_back(number).is_none(), "round {round}: committed twice");
        drop(frame);
    }
    assert_eq!(pool.stats().free, 1);
}
