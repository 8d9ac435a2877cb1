//! Book of what watched threads do: their allocations, and their system calls inside and outside of steps.
//!
//! Invariant: watching itself allocates nothing and calls nothing; a thread is watched from one of its own
//! steps to another, so all that its executor does in between is in the book.

use std::alloc::{GlobalAlloc, Layout, System};
use std::backtrace::Backtrace;
use std::cell::Cell;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::trap;

/// Steps that are watched.
pub(super) const STEPS: u64 = 10_000;
/// Steps before, in which first uses may allocate.
const WARM: u64 = 200;
/// Numbers of system calls that are told apart; later ones count as the last.
const CALLS: usize = 512;

/// System calls that are no stain.
#[derive(Clone, Copy)]
pub(super) struct Excused {
    between: &'static [i64],
    inside: &'static [i64],
    /// Managers have the thread do something between steps, which may allocate.
    orders: bool,
}

/// Of every executor: its own sleep and its wakes, between steps.
pub(super) const SLEEP_AND_WAKE: Excused =
    Excused { between: &[libc::SYS_futex, libc::SYS_clock_nanosleep], inside: &[], orders: false };
/// Of one that is rewired: its managers' orders, between steps.
pub(super) const AND_ORDERS: Excused = Excused { orders: true, ..SLEEP_AND_WAKE };
/// Of one that other processes wake, or whose connections are like theirs: it sleeps on several words.
pub(super) const AND_BELLS: Excused = Excused {
    between: &[libc::SYS_futex, libc::SYS_futex_waitv, libc::SYS_clock_nanosleep],
    inside: &[],
    orders: false,
};
/// Of one that runs freely: it lets others run between two steps.
pub(super) const AND_YIELD: Excused = Excused {
    between: &[libc::SYS_futex, libc::SYS_clock_nanosleep, libc::SYS_sched_yield],
    inside: &[],
    orders: false,
};
/// Of one whose step is shared by several threads: they wake and await each other in it.
pub(super) const AND_TEAM: Excused = Excused { inside: &[libc::SYS_futex], ..SLEEP_AND_WAKE };

/// Of one watched thread.
pub(super) struct Book {
    watch: &'static Watch,
    inside: AtomicBool,
    /// Between and inside of steps.
    allocations: [AtomicU64; 2],
    /// Where the first one came from, likewise.
    first: [Mutex<Option<String>>; 2],
    /// Looking that up: what this thread does now is not its own.
    asking: AtomicBool,
    calls: [[AtomicU64; CALLS]; 2],
}

/// One component whose thread is watched, and the threads that work for it.
#[derive(Default)]
pub(super) struct Watch {
    open: AtomicBool,
    steps: AtomicU64,
    /// Commands a full queue refused: each may wake its server inside the step, which may try again in it.
    refused: AtomicU64,
    books: Mutex<Vec<&'static Book>>,
    /// Why there is no trap.
    untrapped: Mutex<Option<String>>,
}

thread_local! {
    static BOOK: Cell<Option<&'static Book>> = const { Cell::new(None) };
}

/// Watches by the numbers that components are configured with; 0 = not watched.
static WATCHES: Mutex<Vec<&'static Watch>> = Mutex::new(Vec::new());

/// A new watch and its number.
pub(super) fn watch() -> (u64, &'static Watch) {
    let watch: &'static Watch = Box::leak(Box::default());
    let mut all = WATCHES.lock().unwrap();
    all.push(watch);
    (all.len() as u64, watch)
}

/// The watch of this number.
pub(super) fn numbered(number: u64) -> Option<&'static Watch> {
    WATCHES.lock().unwrap().get((number as usize).checked_sub(1)?).copied()
}

/// Runs component code: what it calls of the system is called inside a step.
pub(super) fn inside<R>(code: impl FnOnce() -> R) -> R {
    let Some(book) = BOOK.get() else { return code() };
    let before = book.inside.swap(true, Ordering::Release);
    let result = code();
    book.inside.store(before, Ordering::Release);
    result
}

impl Watch {
    /// Runs one step of the component and counts it; the first ones are not watched, then `STEPS` are.
    pub(super) fn step<R>(&'static self, code: impl FnOnce() -> R) -> R {
        let step = self.steps.load(Ordering::Relaxed) + 1;
        if step == 1 {
            self.enlist();
        } else if step == WARM {
            self.open.store(true, Ordering::Release);
        } else if step == WARM + STEPS {
            self.open.store(false, Ordering::Release);
        }
        let result = inside(code);
        self.steps.store(step, Ordering::Release);
        result
    }

    /// Work of another thread for the component.
    pub(super) fn helps<R>(&'static self, code: impl FnOnce() -> R) -> R {
        self.enlist();
        inside(code)
    }

    /// The calling thread gets a book, once.
    fn enlist(&'static self) {
        if BOOK.get().is_some() {
            return;
        }
        let book: &'static Book = Box::leak(Box::new(Book {
            watch: self,
            inside: AtomicBool::new(false),
            allocations: Default::default(),
            first: Default::default(),
            asking: AtomicBool::new(false),
            calls: [const { [const { AtomicU64::new(0) }; CALLS] }; 2],
        }));
        self.books.lock().unwrap().push(book);
        if let Err(e) = trap::tell(move |call| book.note(call)) {
            *self.untrapped.lock().unwrap() = Some(e.to_string());
        }
        BOOK.set(Some(book));
    }

    pub(super) fn was_refused(&self) {
        if self.open.load(Ordering::Acquire) {
            self.refused.fetch_add(1, Ordering::Relaxed);
        }
    }

    pub(super) fn steps(&self) -> u64 {
        self.steps.load(Ordering::Acquire)
    }

    pub(super) fn is_done(&self) -> bool {
        self.steps() >= WARM + STEPS
    }

    /// Threads that were watched.
    pub(super) fn threads(&self) -> usize {
        self.books.lock().unwrap().len()
    }

    /// Why the kernel lets no thread be trapped.
    pub(super) fn untrapped(&self) -> Option<String> {
        self.untrapped.lock().unwrap().clone()
    }

    /// Everything that a pure step does not do, but for what is excused.
    pub(super) fn stains(&self, excused: Excused) -> Vec<String> {
        self.books.lock().unwrap().iter().flat_map(|book| book.stains(excused)).collect()
    }
}

impl Book {
    fn note(&self, call: i64) {
        if self.watch.open.load(Ordering::Acquire) && !self.asking.load(Ordering::Acquire) {
            let inside = usize::from(self.inside.load(Ordering::Acquire));
            self.calls[inside][(call as usize).min(CALLS - 1)].fetch_add(1, Ordering::Relaxed);
        }
    }

    fn stains(&self, excused: Excused) -> Vec<String> {
        let mut stains = Vec::new();
        let places = [("between steps", excused.between), ("inside steps", excused.inside)];
        for (inside, (place, _)) in places.iter().enumerate() {
            let allocations = self.allocations[inside].load(Ordering::Relaxed);
            if allocations > 0 && (inside == 1 || !excused.orders) {
                let first = self.first[inside].lock().unwrap().clone().unwrap_or_default();
                stains.push(format!(
                    "{allocations} allocations and releases {place}, the first one in\n{first}"
                ));
            }
        }
        let refused = [0, self.watch.refused.load(Ordering::Relaxed)];
        for (((place, excused), calls), refused) in places.into_iter().zip(&self.calls).zip(refused) {
            for (number, count) in calls.iter().enumerate() {
                let (number, count) = (number as i64, count.load(Ordering::Relaxed));
                let free = if number == libc::SYS_futex { refused } else { 0 };
                if count > free && !excused.contains(&number) {
                    stains.push(format!("{count} times {} {place}", name(number)));
                }
            }
        }
        stains
    }
}

/// Names of the system calls that are likely to be seen.
fn name(number: i64) -> String {
    let known = [
        (libc::SYS_futex, "futex"),
        (libc::SYS_clock_nanosleep, "clock_nanosleep"),
        (libc::SYS_sched_yield, "sched_yield"),
        (libc::SYS_mmap, "mmap"),
        (libc::SYS_munmap, "munmap"),
        (libc::SYS_mprotect, "mprotect"),
        (libc::SYS_madvise, "madvise"),
        (libc::SYS_brk, "brk"),
        (libc::SYS_write, "write"),
        (libc::SYS_read, "read"),
        (libc::SYS_getcwd, "getcwd"),
        (libc::SYS_getrandom, "getrandom"),
        (libc::SYS_rt_sigprocmask, "rt_sigprocmask"),
        (libc::SYS_clock_gettime, "clock_gettime"),
        (libc::SYS_membarrier, "membarrier"),
        (libc::SYS_gettid, "gettid"),
    ];
    let found = known.iter().find(|(n, _)| *n == number);
    found.map_or_else(|| format!("system call {number}"), |(_, name)| (*name).to_owned())
}

/// The system's allocator with a look at the book of the thread.
struct Counting;

fn allocated() {
    // A thread on its way out has no book any more.
    let book = BOOK.try_with(Cell::get).ok().flatten();
    if let Some(book) = book.filter(|b| b.watch.open.load(Ordering::Relaxed)) {
        let inside = usize::from(book.inside.load(Ordering::Relaxed));
        if book.allocations[inside].fetch_add(1, Ordering::Relaxed) == 0 {
            BOOK.set(None);
            book.asking.store(true, Ordering::Release);
            *book.first[inside].lock().unwrap() = Some(Backtrace::force_capture().to_string());
            book.asking.store(false, Ordering::Release);
            BOOK.set(Some(book));
        }
    }
}

// SAFETY: every call goes to the system's allocator as it came; counting allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        allocated();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        allocated();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, ptr: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        allocated();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.realloc(ptr, layout, size) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        allocated();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(ptr, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;
