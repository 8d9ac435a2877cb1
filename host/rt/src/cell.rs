//! A binding that many callers use and a manager replaces under them: the cell behind every port slot.
//!
//! One word holds the address of the current value and how many callers entered through it, so entering is
//! one atomic addition. A replaced value is dropped by a manager, never by a caller, and only when every
//! caller that entered it has left, and every turn (see [`crate::turn`]) that was under way then has ended.

use std::ops::Deref;
use std::ptr::NonNull;

use crate::sync::{AtomicU64, Mutex, Ordering};
use crate::turn::{self, Watched};

/// Low bits of the word: callers inside. High bits: the node's address, which Linux keeps below 2^48 on both
/// machines unless a mapping asks for more.
const COUNT_BITS: u32 = 16;
const COUNT_MASK: u64 = (1 << COUNT_BITS) - 1;

/// The value, and the balance of callers that must still leave after it was replaced: the swap adds those
/// that were inside, each leaver subtracts one, so it wraps below 0 for a moment and ends at 0.
struct Node<T> {
    balance: AtomicU64,
    value: T,
}

/// A retired node, owned by the list it stands in, and the turns that may still look at it.
struct Retired<T>(NonNull<Node<T>>, Watched);

// SAFETY: a retired node is an owned `Node<T>`; it moves between managers like a `Box<Node<T>>` would.
unsafe impl<T: Send> Send for Retired<T> {}

/// A replaceable value that is entered without waiting.
pub struct BindingCell<T> {
    word: AtomicU64,
    retired: Mutex<Vec<Retired<T>>>,
    owns: std::marker::PhantomData<Box<Node<T>>>,
}

// SAFETY: the cell owns its values and may carry them, and drop them, on another thread.
unsafe impl<T: Send + Sync> Send for BindingCell<T> {}
// SAFETY: callers on any thread share `&T`, and a manager on any thread drops a `T`.
unsafe impl<T: Send + Sync> Sync for BindingCell<T> {}

fn pack<T>(value: T) -> u64 {
    let node = Box::into_raw(Box::new(Node { balance: AtomicU64::new(0), value }));
    let address = node.expose_provenance() as u64;
    assert!(address >> (64 - COUNT_BITS) == 0, "the allocator gave an address above 2^48");
    address << COUNT_BITS
}

fn unpack<T>(word: u64) -> NonNull<Node<T>> {
    let node = std::ptr::with_exposed_provenance_mut((word >> COUNT_BITS) as usize);
    NonNull::new(node).expect("a cell always holds a node")
}

impl<T> BindingCell<T> {
    #[expect(clippy::boxed_local, reason = "as `swap`")]
    pub fn new(value: Box<T>) -> Self {
        Self {
            word: AtomicU64::new(pack(*value)),
            retired: Mutex::new(Vec::new()),
            owns: std::marker::PhantomData,
        }
    }

    /// Enters the current value; it stays valid until the guard is dropped, also when replaced meanwhile. Any
    /// thread, nested or not; one atomic operation in, one out.
    pub fn enter(&self) -> Guard<'_, T> {
        // Acquire: sees the value as the swap that released its address left it.
        let word = self.word.fetch_add(1, Ordering::Acquire);
        if word & COUNT_MASK == COUNT_MASK {
            // 65 535 guards inside at once are leaked guards, and the next would damage the address.
            std::process::abort();
        }
        Guard { cell: self, node: unpack(word) }
    }

    /// Shows the current value to `f`; it stays valid until `f` returns, also when replaced meanwhile. Any
    /// thread. In a turn of this thread that is one plain load; elsewhere it works as [`BindingCell::enter`].
    #[inline(always)]
    pub fn look<R>(&self, f: impl FnOnce(&T) -> R) -> R {
        if !turn::is_inside() {
            return self.look_counted(f);
        }
        // SAFETY: the turn lasts until after `f`: it ends only in the `turn::run` that is further up this
        // very stack.
        unsafe { self.look_in_turn(f) }
    }

    /// The current value in a turn of this thread; `None` elsewhere.
    ///
    /// # Safety
    /// The answer is not used after that turn has ended.
    #[inline(always)]
    pub unsafe fn peek(&self) -> Option<&T> {
        if !turn::is_inside() {
            return None;
        }
        // SAFETY: by the caller's promise the turn, which every swap finds, outlives the use of the answer.
        Some(unsafe { self.in_turn() })
    }

    /// A function of its own, so that the code for a look in a turn stays small.
    #[inline(never)]
    fn look_counted<R>(&self, f: impl FnOnce(&T) -> R) -> R {
        f(&self.enter())
    }

    /// # Safety
    /// A turn that began before this call and is known to the swapping thread lasts until it returns.
    #[inline(always)]
    pub(crate) unsafe fn look_in_turn<R>(&self, f: impl FnOnce(&T) -> R) -> R {
        // SAFETY: the caller's promise; the answer is used no longer than `f` runs.
        f(unsafe { self.in_turn() })
    }

    /// # Safety
    /// A turn that began before this call and is known to the swapping thread lasts as long as the answer is
    /// used.
    #[inline(always)]
    unsafe fn in_turn(&self) -> &T {
        // Acquire: sees the value as the swap that released its address left it.
        let node = unpack::<T>(self.word.load(Ordering::Acquire));
        // SAFETY: a swap that takes this node out comes after the turn's begin, so it finds the turn and
        // keeps the node until its end; one that came before would have been seen by the load.
        &unsafe { node.as_ref() }.value
    }

    /// Replaces the value for all callers that enter from now on, and drops the values no caller is inside of
    /// any more; returns how many replaced values are still entered. Managers only: takes a mutex, allocates,
    /// never waits for a caller.
    pub fn swap(&self, value: Box<T>) -> usize {
        self.swap_after(value, |_| {}, turn::under_way)
    }

    /// As [`BindingCell::swap`], and shows the replaced value to `see`; callers may still be inside of it.
    pub fn swap_seeing(&self, value: Box<T>, see: impl FnOnce(&T)) -> usize {
        self.swap_after(value, see, turn::under_way)
    }

    /// `under_way` finds the turns that may still look at the old value; it is asked after the replacing.
    #[expect(clippy::boxed_local, reason = "a binding is made by the manager, ready to be taken over")]
    pub(crate) fn swap_after(
        &self,
        value: Box<T>,
        see: impl FnOnce(&T),
        under_way: impl FnOnce() -> Watched,
    ) -> usize {
        let new = pack(*value);
        let mut retired = self.retired.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let old = self.word.swap(new, Ordering::AcqRel);
        let node = unpack::<T>(old);
        // SAFETY: the node is freed only by `reclaim`, which cannot run before the mutex is given back.
        unsafe { node.as_ref() }.balance.fetch_add(old & COUNT_MASK, Ordering::AcqRel);
        retired.push(Retired(node, under_way()));
        // SAFETY: as above.
        see(&unsafe { node.as_ref() }.value);
        Self::free_left(&mut retired)
    }

    /// Drops the replaced values that no caller is inside of any more; returns how many remain. Managers
    /// only.
    pub fn reclaim(&self) -> usize {
        Self::free_left(&mut self.retired.lock().unwrap_or_else(|poisoned| poisoned.into_inner()))
    }

    fn free_left(retired: &mut Vec<Retired<T>>) -> usize {
        let mut at = 0;
        while let Some(Retired(node, turns)) = retired.get(at) {
            // SAFETY: nodes in the list are alive; Acquire sees everything the callers that left have done.
            if unsafe { node.as_ref() }.balance.load(Ordering::Acquire) != 0 || !turns.are_over() {
                at += 1;
                continue;
            }
            let Retired(node, _) = retired.swap_remove(at);
            // SAFETY: made by `Box::into_raw`, no longer in `word` nor in the list, and nobody is inside.
            drop(unsafe { Box::from_raw(node.as_ptr()) });
        }
        retired.len()
    }
}

impl<T> Drop for BindingCell<T> {
    fn drop(&mut self) {
        let retired = self.retired.get_mut();
        for Retired(node, _) in retired.unwrap_or_else(|poisoned| poisoned.into_inner()).drain(..) {
            // SAFETY: made by `Box::into_raw` and in no other list; guards and looks borrow the cell, so none
            // is alive, whatever turns still are.
            drop(unsafe { Box::from_raw(node.as_ptr()) });
        }
        // SAFETY: made by `Box::into_raw` and freed nowhere else; guards borrow the cell, so none is alive.
        drop(unsafe { Box::from_raw(unpack::<T>(self.word.load(Ordering::Acquire)).as_ptr()) });
    }
}

/// A caller inside a cell.
pub struct Guard<'a, T> {
    cell: &'a BindingCell<T>,
    node: NonNull<Node<T>>,
}

impl<T> Deref for Guard<'_, T> {
    type Target = T;
    fn deref(&self) -> &T {
        // SAFETY: the node is not freed while this guard is counted in its word or in its balance.
        &unsafe { self.node.as_ref() }.value
    }
}

impl<T> Drop for Guard<'_, T> {
    fn drop(&mut self) {
        let mine = (self.node.as_ptr().expose_provenance() as u64) << COUNT_BITS;
        let mut word = self.cell.word.load(Ordering::Relaxed);
        // While the node is current its count is in the word. Each turn that fails means another caller got
        // on.
        while word & !COUNT_MASK == mine {
            match self.cell.word.compare_exchange_weak(word, word - 1, Ordering::Release, Ordering::Relaxed) {
                Ok(_) => return,
                Err(now) => word = now,
            }
        }
        // SAFETY: still counted in the balance, so still alive; after the subtraction it is not touched.
        unsafe { self.node.as_ref() }.balance.fetch_sub(1, Ordering::Release);
    }
}

// SAFETY: a guard is a counted `&T`; it may be used, and given back, on another thread.
unsafe impl<T: Send + Sync> Send for Guard<'_, T> {}
// SAFETY: a shared guard gives `&T` only.
unsafe impl<T: Send + Sync> Sync for Guard<'_, T> {}
