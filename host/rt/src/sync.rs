//! The atomics, the cell and the futex every algorithm here is written over: std's, or loom's under
//! `cfg(loom)`.
//!
//! No algorithm may name `std::sync::atomic` itself, or loom would not see its steps; and none may use a
//! fence, which ThreadSanitizer misjudges.

#[cfg(loom)]
pub(crate) use loom::{
    hint::spin_loop,
    sync::Mutex,
    sync::atomic::{AtomicBool, AtomicPtr, AtomicU32, AtomicU64, Ordering},
    thread::JoinHandle,
};
#[cfg(not(loom))]
pub(crate) use std::{
    hint::spin_loop,
    sync::Mutex,
    sync::atomic::{AtomicBool, AtomicPtr, AtomicU32, AtomicU64, Ordering},
    thread::JoinHandle,
};

/// Starts a thread with a stack of 1 MiB.
#[cfg(not(loom))]
pub(crate) fn spawn(run: impl FnOnce() + Send + 'static) -> std::io::Result<JoinHandle<()>> {
    crate::house::spawn(std::thread::Builder::new().stack_size(1 << 20), run)
}

#[cfg(loom)]
pub(crate) fn spawn(run: impl FnOnce() + Send + 'static) -> std::io::Result<JoinHandle<()>> {
    Ok(loom::thread::spawn(run))
}

/// Spins while `busy`, for `ns` at most: for work that is nearly always over before a sleep would have begun.
#[cfg(not(loom))]
pub(crate) fn pause_while(ns: u64, busy: impl Fn() -> bool) {
    let end = crate::os::now_ns() + ns;
    while busy() && crate::os::now_ns() < end {
        spin_loop();
    }
}

/// Spinning ends early for loom, which looks at the sleep behind it.
#[cfg(loom)]
pub(crate) fn pause_while(_ns: u64, _busy: impl Fn() -> bool) {}

/// Sleeps for `ns`: for work that takes longer than that only when its thread was suspended.
#[cfg(not(loom))]
pub(crate) fn rest(ns: u64) {
    crate::os::sleep_until(crate::os::now_ns() + ns);
}

/// To loom, a sleep lets the other threads go on.
#[cfg(loom)]
pub(crate) fn rest(_ns: u64) {
    loom::thread::yield_now();
}

/// Keeps two words that different threads write from sharing a cache line.
#[repr(C, align(64))]
pub(crate) struct Padded<T>(pub(crate) T);

/// Interior mutability whose exclusivity some atomic word proves.
#[cfg(not(loom))]
#[repr(transparent)]
pub(crate) struct Shared<T>(std::cell::UnsafeCell<T>);

#[cfg(not(loom))]
impl<T> Shared<T> {
    pub(crate) fn new(value: T) -> Self {
        Self(std::cell::UnsafeCell::new(value))
    }

    /// The address, for a holder of the exclusive right to it.
    pub(crate) fn exclusive(&self) -> *mut T {
        self.0.get()
    }

    /// Returns the address, for one of several readers while no thread holds the exclusive right.
    pub(crate) fn readable(&self) -> *const T {
        self.0.get()
    }
}

impl<T: Copy> Shared<T> {
    /// Returns the value as it was at one look: where another process writes it at any time, the checked
    /// value is the used one.
    ///
    /// # Safety
    /// The caller has the right to read, and `T` is a value for any bits where another process can write it.
    #[inline]
    pub(crate) unsafe fn fetch(&self) -> T {
        // SAFETY: aligned and initialised; volatile, so that it is loaded once and never again.
        unsafe { self.readable().read_volatile() }
    }
}

/// Interior mutability whose exclusivity some atomic word proves; loom checks the claim at each access.
#[cfg(loom)]
pub(crate) struct Shared<T>(loom::cell::UnsafeCell<T>);

#[cfg(loom)]
impl<T> Shared<T> {
    pub(crate) fn new(value: T) -> Self {
        Self(loom::cell::UnsafeCell::new(value))
    }

    /// The address; loom fails the model when another access is not ordered before this one.
    pub(crate) fn exclusive(&self) -> *mut T {
        self.0.with_mut(|p| p)
    }

    /// The address; loom fails the model when a writing access is not ordered before this one.
    pub(crate) fn readable(&self) -> *const T {
        self.0.with(|p| p)
    }
}

/// Processes whose threads sleep on a word and wake each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Threads of this process.
    Process,
    /// Threads of other processes, too.
    Machine,
}

/// A 32-bit word that threads can sleep on.
#[repr(C)]
pub(crate) struct Futex {
    pub(crate) word: AtomicU32,
    #[cfg(loom)]
    queue: (Mutex<()>, loom::sync::Condvar),
}

impl Futex {
    pub(crate) fn new(value: u32) -> Self {
        Self {
            word: AtomicU32::new(value),
            #[cfg(loom)]
            queue: (Mutex::new(()), loom::sync::Condvar::new()),
        }
    }

    /// Sleeps while the word holds `expected`, until a wake or the absolute monotonic deadline in ns. May
    /// return for no reason.
    #[cfg(not(loom))]
    pub(crate) fn wait(
        &self,
        expected: u32,
        deadline_ns: Option<u64>,
        scope: Scope,
    ) -> crate::os::WaitResult {
        crate::os::futex_wait(&self.word, expected, deadline_ns, scope)
    }

    /// Wakes up to `n` sleepers: one system call.
    #[cfg(not(loom))]
    pub(crate) fn wake(&self, n: u32, scope: Scope) {
        crate::os::futex_wake(&self.word, n, scope);
    }

    /// As the kernel does it: the comparison and going to sleep are one step. With a deadline it times out at
    /// once, which is one of the things a real clock may do; with the last of all deadlines it never does.
    #[cfg(loom)]
    pub(crate) fn wait(&self, expected: u32, deadline_ns: Option<u64>, _: Scope) -> crate::os::WaitResult {
        let guard = self.queue.0.lock().expect("no model panics inside the futex");
        if self.word.load(Ordering::Relaxed) != expected {
            return crate::os::WaitResult::Changed;
        }
        if deadline_ns.is_some_and(|at| at < u64::MAX) {
            return crate::os::WaitResult::TimedOut;
        }
        drop(self.queue.1.wait(guard));
        crate::os::WaitResult::Woken
    }

    /// Wakes every sleeper.
    #[cfg(loom)]
    pub(crate) fn wake(&self, _n: u32, _: Scope) {
        let _guard = self.queue.0.lock().expect("no model panics inside the futex");
        self.queue.1.notify_all();
    }
}
