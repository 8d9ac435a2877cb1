//! Sealed memfds and their mappings: memory that other processes can be given, but that nobody can shrink.
//!
//! The seals make it safe to hand a descriptor out, or to take one: no truncation (SIGBUS), and for pools no
//! new writable mapping. A file of another process is checked for its kind, its seals, its size and its pages
//! before it is mapped: nothing that process does later makes an access fail, and mapping it takes no memory
//! that it did not have already.

use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::ptr::NonNull;

/// Processes that may write the memory of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Writers {
    /// The process that made it; all others get read-only mappings.
    Maker,
    /// Both ends of a link.
    BothEnds,
}

pub(crate) struct Mapping {
    fd: OwnedFd,
    start: NonNull<u8>,
    len: usize,
}

// SAFETY: plain memory; who may touch which part is decided by its users.
unsafe impl Send for Mapping {}
// SAFETY: as above: `&Mapping` only gives addresses out.
unsafe impl Sync for Mapping {}

fn check(rc: i32, what: &str) -> io::Result<i32> {
    if rc >= 0 {
        return Ok(rc);
    }
    let error = io::Error::last_os_error();
    Err(io::Error::new(error.kind(), format!("{what}: {error}")))
}

/// One part in this many of the available memory is left to all other processes.
const RESERVE: usize = 8;

/// Returns the bytes the machine can give without swapping; never an answer that means "no limit".
fn available_memory() -> usize {
    let info = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = info.lines().find_map(|l| l.strip_prefix("MemAvailable:"));
    let kib = line.and_then(|l| l.trim().strip_suffix(" kB")?.parse::<usize>().ok());
    kib.map_or_else(free_memory, |kib| kib.saturating_mul(1024))
}

/// Returns the bytes of unused pages: less than what is available, for when /proc cannot be read.
fn free_memory() -> usize {
    // SAFETY: sysconf takes a number and answers one.
    let (pages, bytes) =
        unsafe { (libc::sysconf(libc::_SC_AVPHYS_PAGES), libc::sysconf(libc::_SC_PAGESIZE)) };
    usize::try_from(pages).unwrap_or(0).saturating_mul(usize::try_from(bytes).unwrap_or(0))
}

/// Refuses what does not fit into the memory that is available now, with a sentence that says how much that
/// is.
///
/// # Errors
/// It does not fit.
pub fn room_for(len: usize) -> io::Result<()> {
    // Without this check fallocate goes on taking pages until the kernel kills processes, of any user.
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

/// Refuses a file that is longer than this process may make one: the kernel would end the process by a
/// signal.
fn may_write(what: &str, len: usize) -> io::Result<()> {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: a place for the answer.
    let rc = unsafe { libc::getrlimit(libc::RLIMIT_FSIZE, &raw mut limit) };
    if rc == 0 && limit.rlim_cur != libc::RLIM_INFINITY && len as u64 > limit.rlim_cur {
        let most = limit.rlim_cur;
        return Err(io::Error::new(
            io::ErrorKind::FileTooLarge,
            format!(
                "{what} of {len} bytes is more than a file of this process may have, {most}: raise `ulimit -f`"
            ),
        ));
    }
    Ok(())
}

/// Tells whether the descriptor is of memfd memory with usual pages: huge ones can be missing when they are
/// touched.
fn is_usual_memory(fd: BorrowedFd<'_>) -> bool {
    // SAFETY: a zeroed statfs is a valid place for the answer.
    let mut stat: libc::statfs = unsafe { std::mem::zeroed() };
    // SAFETY: an open descriptor and a place for the answer.
    let rc = unsafe { libc::fstatfs(fd.as_raw_fd(), &raw mut stat) };
    rc == 0 && stat.f_type == libc::TMPFS_MAGIC
}

/// Bytes of a block as stat counts them.
const STAT_BLOCK: u64 = 512;

impl Mapping {
    /// Creates a file of `len` bytes, all pages present and zeroed, mapped for writing and sealed. `what`
    /// names it in errors: "a frame pool", "a link".
    ///
    /// # Errors
    /// The machine has not that much memory, or memfd is not allowed.
    pub(crate) fn create(what: &str, len: usize, writers: Writers) -> io::Result<Self> {
        room_for(len)?;
        may_write(what, len)?;
        let name = match writers {
            Writers::Maker => c"trocar-pool",
            Writers::BothEnds => c"trocar-link",
        };
        // SAFETY: the name is a C string, the rest are flags.
        let fd = unsafe { libc::memfd_create(name.as_ptr(), libc::MFD_CLOEXEC | libc::MFD_ALLOW_SEALING) };
        let fd = check(fd, &format!("{what} needs memfd_create"))?;
        // SAFETY: a descriptor just made, owned by nobody else.
        let fd = unsafe { OwnedFd::from_raw_fd(fd) };
        let raw = fd.as_raw_fd();
        let size = libc::off_t::try_from(len).unwrap_or(libc::off_t::MAX);
        let fits = || format!("{what} of {len} bytes does not fit: use fewer or smaller slots");
        // SAFETY: calls on an own descriptor; fallocate also reserves, so that no later touch can fail.
        check(unsafe { libc::ftruncate(raw, size) }, &fits())?;
        // SAFETY: as above.
        check(unsafe { libc::fallocate(raw, 0, 0, size) }, &fits())?;
        let mapping = Self::map(fd, len, libc::PROT_READ | libc::PROT_WRITE, &fits())?;
        let more = if writers == Writers::Maker { libc::F_SEAL_FUTURE_WRITE } else { 0 };
        let seals = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW | libc::F_SEAL_SEAL | more;
        // SAFETY: a call on an own descriptor with flags only.
        let rc = unsafe { libc::fcntl(raw, libc::F_ADD_SEALS, seals) };
        check(rc, &format!("{what} needs memfd seals (Linux 5.1)"))?;
        Ok(mapping)
    }

    /// Maps the file another process made, for reading, or for writing where both ends may.
    ///
    /// # Errors
    /// It is no memfd of exactly `len` bytes that can neither shrink nor grow, has all its pages, and, where
    /// only its maker may write, takes no new writers.
    pub(crate) fn open(fd: OwnedFd, len: usize, writers: Writers) -> io::Result<Self> {
        let refuse = |why: String| Err(io::Error::new(io::ErrorKind::InvalidData, why));
        // SAFETY: a call on an own descriptor without arguments.
        let seals = unsafe { libc::fcntl(fd.as_raw_fd(), libc::F_GET_SEALS) };
        let wanted = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW;
        if seals < 0 || seals & wanted != wanted || !is_usual_memory(fd.as_fd()) {
            return refuse("the memory handed over is no memfd that can neither shrink nor grow".into());
        }
        // With this seal the maker cannot punch holes either, which would fill again at this process's cost.
        if writers == Writers::Maker && seals & libc::F_SEAL_FUTURE_WRITE == 0 {
            return refuse("the memory handed over takes new writers".into());
        }
        // SAFETY: a zeroed stat is a valid place for the answer.
        let mut stat: libc::stat = unsafe { std::mem::zeroed() };
        // SAFETY: an own descriptor and a place for the answer.
        check(unsafe { libc::fstat(fd.as_raw_fd(), &raw mut stat) }, "the memory handed over")?;
        if usize::try_from(stat.st_size) != Ok(len) || len == 0 {
            return refuse(format!("the memory handed over has {} bytes instead of {len}", stat.st_size));
        }
        let present = u64::try_from(stat.st_blocks).unwrap_or(0).saturating_mul(STAT_BLOCK);
        if present < len as u64 {
            return refuse(format!("of the {len} bytes handed over only {present} are there"));
        }
        let protection = match writers {
            Writers::Maker => libc::PROT_READ,
            Writers::BothEnds => libc::PROT_READ | libc::PROT_WRITE,
        };
        Self::map(fd, len, protection, "the memory handed over cannot be mapped")
    }

    fn map(fd: OwnedFd, len: usize, protection: i32, what: &str) -> io::Result<Self> {
        let flags = libc::MAP_SHARED | libc::MAP_POPULATE;
        // SAFETY: a fresh mapping at an address the kernel chooses, of a file that is exactly this long.
        let start = unsafe { libc::mmap(std::ptr::null_mut(), len, protection, flags, fd.as_raw_fd(), 0) };
        if start == libc::MAP_FAILED {
            check(-1, what)?;
        }
        let start = NonNull::new(start.cast()).expect("mmap never answers address 0 of itself");
        Ok(Self { fd, start, len })
    }

    #[inline]
    pub(crate) fn at(&self, offset: usize) -> *mut u8 {
        assert!(offset <= self.len, "offset {offset} is outside the {} bytes", self.len);
        // SAFETY: the offset was just checked to lie inside the mapping or one past its end.
        unsafe { self.start.as_ptr().add(offset) }
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    pub(crate) fn fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: mapped in `map` with this length; whoever uses an address of it keeps it alive.
        unsafe { libc::munmap(self.start.as_ptr().cast(), self.len) };
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn plain_memfd(len: i64, seals: i32) -> OwnedFd {
        memfd(len, len, seals)
    }

    /// Makes a memfd with so many of its bytes present.
    fn memfd(len: i64, present: i64, seals: i32) -> OwnedFd {
        // SAFETY: a C string and flags; the descriptor is owned from here on.
        unsafe {
            let fd = libc::memfd_create(c"test".as_ptr(), libc::MFD_ALLOW_SEALING | libc::MFD_CLOEXEC);
            assert!(fd >= 0);
            assert_eq!(libc::ftruncate(fd, len), 0);
            assert!(present == 0 || libc::fallocate(fd, 0, 0, present) == 0);
            assert_eq!(libc::fcntl(fd, libc::F_ADD_SEALS, seals), 0);
            OwnedFd::from_raw_fd(fd)
        }
    }

    #[test]
    fn what_one_maps_for_writing_the_other_reads_and_cannot_map_for_writing() {
        let pool = Mapping::create("a frame pool", 4096, Writers::Maker).unwrap();
        // SAFETY: the mapping is this test's alone.
        unsafe { pool.at(5).write(7) };
        let theirs = pool.fd().try_clone_to_owned().unwrap();
        let seen = Mapping::open(theirs, 4096, Writers::Maker).unwrap();
        // SAFETY: as above.
        assert_eq!(unsafe { seen.at(5).read() }, 7);
        let again = pool.fd().try_clone_to_owned().unwrap();
        assert!(Mapping::open(again, 4096, Writers::BothEnds).is_err(), "a pool could be mapped for writing");
    }

    #[test]
    fn a_link_is_written_by_both_ends() {
        let link = Mapping::create("a link", 4096, Writers::BothEnds).unwrap();
        let theirs = link.fd().try_clone_to_owned().unwrap();
        let other = Mapping::open(theirs, 4096, Writers::BothEnds).unwrap();
        // SAFETY: the mappings are this test's alone.
        unsafe {
            other.at(9).write(3);
            assert_eq!(link.at(9).read(), 3);
        }
    }

    #[test]
    fn memory_that_may_shrink_or_has_another_size_is_refused() {
        let all = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW;
        for (len, seals) in [(4096, 0), (4096, libc::F_SEAL_SHRINK), (8192, all), (0, all)] {
            let refused = Mapping::open(plain_memfd(len, seals), 4096, Writers::BothEnds);
            assert!(refused.is_err(), "{len} bytes with seals {seals:#x} were taken");
        }
        assert!(Mapping::open(plain_memfd(4096, all), 4096, Writers::BothEnds).is_ok());
        assert!(
            Mapping::open(plain_memfd(4096, all), 4096, Writers::Maker).is_err(),
            "a pool with new writers"
        );
        for other in ["/proc/self/exe", "/dev/zero", "/"] {
            let file = OwnedFd::from(std::fs::File::open(other).unwrap());
            assert!(Mapping::open(file, 4096, Writers::Maker).is_err(), "{other} was taken");
        }
        let (pipe, _) = std::io::pipe().unwrap();
        assert!(Mapping::open(pipe.into(), 4096, Writers::BothEnds).is_err(), "a pipe was taken");
    }

    /// Once mapped, it would take the missing memory from this process, and might find none.
    #[test]
    fn memory_with_holes_is_refused_before_it_is_mapped() {
        let all = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW | libc::F_SEAL_FUTURE_WRITE;
        let tebibyte = 1 << 40;
        for present in [0, 4096, 1 << 20] {
            let refused = Mapping::open(memfd(tebibyte, present, all), tebibyte as usize, Writers::Maker);
            let why = refused.err().unwrap().to_string();
            assert!(why.contains(&format!("only {present} are there")), "{why}");
        }
        let pool = plain_memfd(8192, all);
        let mapped = Mapping::open(pool.try_clone().unwrap(), 8192, Writers::Maker).unwrap();
        let punch = libc::FALLOC_FL_PUNCH_HOLE | libc::FALLOC_FL_KEEP_SIZE;
        // SAFETY: a call on an own descriptor with numbers only.
        let punched = unsafe { libc::fallocate(pool.as_raw_fd(), punch, 0, 4096) };
        assert_eq!(punched, -1, "its maker could still take pages out of it");
        drop(mapped);
    }

    #[test]
    fn memory_of_huge_pages_is_refused() {
        let huge = 2 << 20;
        // SAFETY: a C string and flags; the descriptor is owned from here on.
        let fd = unsafe {
            let flags = libc::MFD_ALLOW_SEALING | libc::MFD_CLOEXEC | libc::MFD_HUGETLB;
            let fd = libc::memfd_create(c"test".as_ptr(), flags);
            if fd < 0 {
                // A kernel without huge pages makes none.
                return;
            }
            assert_eq!(libc::ftruncate(fd, huge), 0);
            let seals = libc::F_SEAL_SHRINK | libc::F_SEAL_GROW;
            assert_eq!(libc::fcntl(fd, libc::F_ADD_SEALS, seals), 0);
            OwnedFd::from_raw_fd(fd)
        };
        let why = Mapping::open(fd, huge as usize, Writers::BothEnds).err().unwrap().to_string();
        assert!(why.contains("no memfd"), "{why}");
    }
}
