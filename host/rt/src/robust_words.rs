//! Words of a thread that the kernel marks when the thread ends, by whatever signal: long before the memory
//! of its process is taken apart and its files are closed.
//!
//! Invariant: the kernel's list of these words leads through this process's own memory only, and is whole
//! between any two instructions; in shared memory the kernel and this file touch only the words.

use std::ffi::{c_int, c_long, c_void};
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};
use std::ptr::{NonNull, null_mut};
use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, AtomicU32, Ordering};

use crate::pulse::{OWNED, Pulse};
use crate::region::Region;

/// An entry of the kernel's list: get_robust_list(2).
#[repr(C)]
struct Entry {
    next: AtomicPtr<Entry>,
}

/// Start of the kernel's list, and the distance from each entry to its word.
#[repr(C)]
struct Head {
    first: Entry,
    word_offset: c_long,
    /// Entry of a lock that is being taken: there are none here.
    pending: *mut Entry,
}

/// Two pages side by side: an own one with the entry, behind it the shared one with the word. So a distance
/// leads from the one to the other, and nothing the other process can write does.
struct Pages {
    start: NonNull<u8>,
    page: usize,
    /// Offset of the word in the second page, B.
    offset: usize,
    /// Region of the shared page; it identifies these pages.
    of: Arc<Region>,
}

/// Words the calling thread leaves behind.
pub struct RobustWords {
    head: NonNull<Head>,
    /// List of this thread before: that of the C library.
    before: (*mut c_void, usize),
    /// In the order they were added; the kernel's list has the last one first.
    words: Vec<Pages>,
    page: usize,
    /// Value written into a word.
    owned: u32,
}

fn check(rc: c_long, asked: &str) -> io::Result<()> {
    if rc == 0 {
        return Ok(());
    }
    let error = io::Error::last_os_error();
    Err(io::Error::new(error.kind(), format!("{asked}: {error}")))
}

impl RobustWords {
    /// Makes an empty list. It stays on the thread that made it.
    ///
    /// # Errors
    /// The kernel has no such lists, or this thread holds robust mutexes of the C library, which would be
    /// forgotten: it is to take none as long as this lives.
    pub fn of_this_thread() -> io::Result<RobustWords> {
        let (mut head, mut bytes) = (null_mut::<c_void>(), 0usize);
        // SAFETY: 0 is the calling thread; both are valid places for the answers.
        let rc =
            unsafe { libc::syscall(libc::SYS_get_robust_list, 0 as c_int, &raw mut head, &raw mut bytes) };
        check(rc, "ask for this thread's list of robust futexes")?;
        if !head.is_null() {
            // SAFETY: the list the C library registered for this very thread, which nobody else changes;
            // empty it leads to itself.
            let first = unsafe { &*head.cast::<Head>() }.first.next.load(Ordering::Relaxed);
            if first.cast() != head {
                return Err(io::Error::other("this thread holds robust mutexes"));
            }
        }
        // SAFETY: sysconf takes a number and answers one; gettid cannot fail.
        let (page, thread) = unsafe { (libc::sysconf(libc::_SC_PAGESIZE), libc::gettid()) };
        let page = usize::try_from(page).map_err(io::Error::other)?;
        let owned = OWNED | thread.unsigned_abs();
        let own = Box::new(Head {
            first: Entry { next: AtomicPtr::new(null_mut()) },
            word_offset: page as c_long,
            pending: null_mut(),
        });
        let own = NonNull::from(Box::leak(own));
        let robust_words = RobustWords { head: own, before: (head, bytes), words: Vec::new(), page, owned };
        robust_words.first().next.store(own.as_ptr().cast(), Ordering::Relaxed);
        // SAFETY: the head stays where it is until `drop` has registered the one before, on this same thread:
        // the words cannot be sent.
        let rc = unsafe { libc::syscall(libc::SYS_set_robust_list, own.as_ptr(), size_of::<Head>()) };
        check(rc, "have the kernel mark words at the end of this thread")?;
        Ok(robust_words)
    }

    fn first(&self) -> &Entry {
        // SAFETY: leaked by `of_this_thread` and freed by `drop` only; the kernel changes nothing of it.
        &unsafe { self.head.as_ref() }.first
    }

    /// Adds a page: its other end is told when this thread ends.
    ///
    /// # Errors
    /// The machine gives no more memory, or it is no page that two processes share.
    pub fn add(&mut self, pulse: &Pulse) -> io::Result<()> {
        let (region, fd, offset) = pulse.own_life().ok_or(io::ErrorKind::InvalidInput)?;
        let pages = Pages::map(fd, self.page, offset, region)?;
        pages.word().store(self.owned, Ordering::Release);
        let first = &self.first().next;
        pages.entry().next.store(first.load(Ordering::Relaxed), Ordering::Relaxed);
        // Released: whenever the thread ends, the kernel finds the entry whole or not at all.
        first.store(pages.start_of_entry().as_ptr(), Ordering::Release);
        self.words.push(pages);
        Ok(())
    }

    /// Takes a page back: its other end is told nothing any more.
    pub fn remove(&mut self, pulse: &Pulse) {
        let Some(at) = self.words.iter().position(|pages| pulse.is_in(&pages.of)) else { return };
        let before = self.words.get(at + 1).map_or(self.first(), Pages::entry);
        before.next.store(self.words[at].entry().next.load(Ordering::Relaxed), Ordering::Release);
        self.words[at].word().store(0, Ordering::Release);
        self.words.remove(at);
    }
}

impl Drop for RobustWords {
    fn drop(&mut self) {
        let (head, bytes) = self.before;
        // SAFETY: what the C library had registered for this thread, which still runs; null is no list.
        if unsafe { libc::syscall(libc::SYS_set_robust_list, head, bytes) } != 0 {
            // Never seen; the kernel then still uses this list, so it stays.
            std::mem::take(&mut self.words).leak();
            return;
        }
        self.words.iter().for_each(|pages| pages.word().store(0, Ordering::Release));
        // SAFETY: leaked by `of_this_thread`, and known to nobody else any more.
        drop(unsafe { Box::from_raw(self.head.as_ptr()) });
    }
}

impl Pages {
    fn map(fd: BorrowedFd<'_>, page: usize, offset: usize, of: &Arc<Region>) -> io::Result<Pages> {
        assert!(offset.is_multiple_of(align_of::<Entry>()) && offset + size_of::<Entry>() <= page, "it fits");
        let (rights, own) = (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS);
        // SAFETY: fresh memory at an address the kernel chooses.
        let start = unsafe { libc::mmap(null_mut(), 2 * page, rights, own, -1, 0) };
        if start == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: the second of the two pages just mapped.
        let second = unsafe { start.byte_add(page) };
        let flags = libc::MAP_SHARED | libc::MAP_FIXED | libc::MAP_POPULATE;
        // SAFETY: takes the place of an own page nobody uses yet; the file is sealed against shrinking.
        if unsafe { libc::mmap(second, page, rights, flags, fd.as_raw_fd(), 0) } == libc::MAP_FAILED {
            let error = io::Error::last_os_error();
            // SAFETY: mapped above and unused. What is at the second page now nobody says: it is left alone.
            unsafe { libc::munmap(start, page) };
            return Err(error);
        }
        let start = NonNull::new(start.cast()).expect("mmap never answers address 0 of itself");
        let pages = Pages { start, page, offset, of: Arc::clone(of) };
        // SAFETY: inside the first page, which is nobody else's, and aligned as asserted.
        unsafe { pages.start_of_entry().write(Entry { next: AtomicPtr::new(null_mut()) }) };
        Ok(pages)
    }

    fn start_of_entry(&self) -> NonNull<Entry> {
        // SAFETY: the offset lies inside the first page.
        unsafe { self.start.byte_add(self.offset) }.cast()
    }

    fn entry(&self) -> &Entry {
        // SAFETY: written by `map`; the kernel only reads it.
        unsafe { self.start_of_entry().as_ref() }
    }

    fn word(&self) -> &AtomicU32 {
        // SAFETY: a word inside the second page, as far behind the entry as the head says; any bits are a
        // value.
        unsafe { self.start.byte_add(self.page + self.offset).cast().as_ref() }
    }
}

impl Drop for Pages {
    fn drop(&mut self) {
        // SAFETY: mapped in `map` with this length, and not in the kernel's list any more.
        unsafe { libc::munmap(self.start.as_ptr().cast(), 2 * self.page) };
    }
}
