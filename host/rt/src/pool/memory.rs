//! One sealed memfd, mapped once: memory that other processes can be given, but nobody can shrink or write anew.
//!
//! The seals are what makes handing the descriptor out safe: no truncation (SIGBUS), no new writable mapping.

use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::ptr::NonNull;

pub(super) struct Memory {
    fd: OwnedFd,
    start: NonNull<u8>,
    len: usize,
}

// SAFETY: plain memory; who may touch which part is decided by the slots.
unsafe impl Send for Memory {}
// SAFETY: as above: `&Memory` only gives addresses out.
unsafe impl Sync for Memory {}

fn check(rc: i32, what: &str) -> io::Result<i32> {
    if rc >= 0 {
        return Ok(rc);
    }
    let error = io::Error::last_os_error();
    Err(io::Error::new(error.kind(), format!("{what}: {error}")))
}

/// One part in this many of the available memory is left to everybody else.
const RESERVE: usize = 8;

/// Bytes the machine can give without swapping; never an answer that means "no limit".
fn available_memory() -> usize {
    let info = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = info.lines().find_map(|l| l.strip_prefix("MemAvailable:"));
    let kib = line.and_then(|l| l.trim().strip_suffix(" kB")?.parse::<usize>().ok());
    kib.map_or_else(free_memory, |kib| kib.saturating_mul(1024))
}

/// Bytes of unused pages: less than what is available, for when /proc cannot be read.
fn free_memory() -> usize {
    // SAFETY: sysconf takes a number and answers one.
    let (pages, bytes) =
        unsafe { (libc::sysconf(libc::_SC_AVPHYS_PAGES), libc::sysconf(libc::_SC_PAGESIZE)) };
    usize::try_from(pages).unwrap_or(0).saturating_mul(usize::try_from(bytes).unwrap_or(0))
}

/// Refuses what does not fit into the memory that is available now, with a sentence that says how much that is.
///
/// # Errors
/// It does not fit.
pub fn room_for(len: usize) -> io::Result<()> {
    // Without this check fallocate goes on taking pages until the kernel kills processes, anybody's.
    let available = available_memory();
    if len <= available - available / RESERVE {
        return Ok(());
    }
    Err(io::Error::new(
        io::ErrorKind::OutOfMemory,
        format!(
            "{len} bytes do not fit: {available} bytes of memory are available, an eighth of which must stay \
             free; use fewer or smaller slots"
        ),
    ))
}

impl Memory {
    pub(super) fn new(len: usize) -> io::Result<Self> {
        room_for(len)?;
        let flags = libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING;
        // SAFETY: the name is a C string, the rest are flags.
        let fd = unsafe { libc::memfd_create(c"trocar-pool".as_ptr(), flags) };
        let fd = check(fd, "a frame pool needs memfd_create")?;
        // SAFETY: a descriptor just made, owned by nobody else.
        let fd = unsafe { OwnedFd::from_raw_fd(fd) };
        let raw = fd.as_raw_fd();
        let size = libc::off_t::try_from(len).unwrap_or(libc::off_t::MAX);
        let what = || format!("a frame pool of {len} bytes does not fit: use fewer or smaller slots");
        // SAFETY: calls on an own descriptor; fallocate also reserves, so that no later touch can fail.
        check(unsafe { libc::ftruncate(raw, size) }, &what())?;
        // SAFETY: as above.
        check(unsafe { libc::fallocate(raw, 0, 0, size) }, &what())?;
        let protection = libc::PROT_READ | libc::PROT_WRITE;
        let mapping = libc::MAP_SHARED | libc::MAP_POPULATE;
        // SAFETY: a fresh mapping at an address the kernel chooses, of a file that is exactly this long.
        let start = unsafe { libc::mmap(std::ptr::null_mut(), len, protection, mapping, raw, 0) };
        if start == libc::MAP_FAILED {
            check(-1, &what())?;
        }
        let start = NonNull::new(start.cast()).expect("mmap never answers address 0 of itself");
        let memory = Self { fd, start, len };
        let seals = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW | libc::F_SEAL_FUTURE_WRITE | libc::F_SEAL_SEAL;
        // SAFETY: a call on an own descriptor with flags only.
        let rc = unsafe { libc::fcntl(raw, libc::F_ADD_SEALS, seals) };
        check(rc, "a frame pool needs memfd seals (Linux 5.1)")?;
        Ok(memory)
    }

    pub(super) fn at(&self, offset: usize) -> *mut u8 {
        assert!(offset <= self.len, "offset {offset} is outside the {} bytes", self.len);
        // SAFETY: the offset was just checked to lie inside the mapping or one past its end.
        unsafe { self.start.as_ptr().add(offset) }
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        // SAFETY: mapped in `new` with this length; every frame keeps the pool alive, so nobody is inside.
        unsafe { libc::munmap(self.start.as_ptr().cast(), self.len) };
    }
}
