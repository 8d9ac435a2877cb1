//! Everything that happens by chance, drawn from one seed.
//!
//! Invariant: the same seed gives the same run, also of what other libraries draw for themselves.

use std::cell::Cell;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;

thread_local! {
    /// State of the numbers that libraries draw on this thread.
    static DRAWN: Cell<u64> = const { Cell::new(0) };
}

/// Sets what libraries draw on this thread from now on: keys of hash maps, the order in which a task looks at
/// its branches.
pub(crate) fn seed(seed: u64) {
    DRAWN.set(seed);
}

/// Takes the place of the system's call: the standard library leaves it open to that.
///
/// # Safety
/// As getrandom(2): `into` has room for `len` bytes.
// SAFETY: no other object of this program defines it, and it has the signature of getrandom(2).
#[unsafe(no_mangle)]
unsafe extern "C" fn getrandom(into: *mut u8, len: usize, _flags: u32) -> isize {
    for at in 0..len {
        // SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014).
        let state = DRAWN.get().wrapping_add(0x9e37_79b9_7f4a_7c15);
        DRAWN.set(state);
        let mixed = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        // SAFETY: `at` is below `len`, for which the caller has room.
        unsafe { into.add(at).write((mixed ^ (mixed >> 31)).to_le_bytes()[0]) };
    }
    isize::try_from(len).unwrap_or(isize::MAX)
}

/// Chance of one run; clones draw from the same.
#[derive(Clone)]
pub(crate) struct Chance(Arc<Mutex<fastrand::Rng>>);

impl Chance {
    pub(crate) fn of(seed: u64) -> Chance {
        Chance(Arc::new(Mutex::new(fastrand::Rng::with_seed(seed))))
    }

    /// Returns a number below `end`.
    pub(crate) fn below(&self, end: usize) -> usize {
        self.0.lock().usize(..end)
    }

    /// Tells whether something happens that happens once in so many times.
    pub(crate) fn once_in(&self, times: usize) -> bool {
        self.below(times) == 0
    }

    pub(crate) fn one_of<'a, T>(&self, of: &'a [T]) -> &'a T {
        &of[self.below(of.len())]
    }

    /// Returns a time between the two, ms.
    pub(crate) fn ms(&self, from: u64, to: u64) -> Duration {
        Duration::from_micros(self.0.lock().u64(from * 1000..=to * 1000))
    }

    /// Returns the time that something takes: mostly none or little, rarely long.
    pub(crate) fn takes(&self) -> Duration {
        match self.below(100) {
            0 => self.ms(100, 3000),
            1..10 => self.ms(5, 100),
            10..50 => self.ms(0, 5),
            _ => Duration::ZERO,
        }
    }

    pub(crate) fn number(&self) -> u128 {
        self.0.lock().u128(..)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    #[test]
    fn what_libraries_draw_is_that_of_the_seed() {
        let drawn = |with: u64| {
            let order = move || {
                seed(with);
                (0..64).map(|key| (key, ())).collect::<HashMap<u32, ()>>().into_keys().collect::<Vec<_>>()
            };
            std::thread::spawn(order).join().unwrap_or_default()
        };
        assert_eq!(drawn(1), drawn(1), "getrandom is not the one of this program");
        assert_ne!(drawn(1), drawn(2));
    }
}
