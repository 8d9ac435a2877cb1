//! A child process that may less than this one: its limits, and the capabilities that stand above them.
//!
//! Invariant: given up between fork and exec, so for the child alone; what is given up is gone for root, too.

use std::io;
use std::os::unix::process::CommandExt;
use std::process::Command;

use trocar_tests::skip;

/// CAP_IPC_LOCK, CAP_SYS_NICE and CAP_SYS_RESOURCE: with them no limit counts.
const ABOVE_LIMITS: u32 = 1 << 14 | 1 << 23 | 1 << 24;
/// The kernel's present layout of capability sets.
const VERSION_3: u32 = 0x2008_0522;

/// A resource and its limit, soft and hard.
pub(crate) type Limit = (libc::__rlimit_resource_t, u64);

/// The child gets these limits and no capability that stands above them.
pub(crate) fn limit(command: &mut Command, limits: &'static [Limit]) {
    // SAFETY: between fork and exec it makes system calls only: no lock, no allocation.
    unsafe { command.pre_exec(move || give_up(limits)) };
}

/// Whether so much memory may be locked by this process's children; says so where it may not.
pub(crate) fn may_lock(bytes: u64) -> bool {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: `limit` is a valid place for the answer.
    let known = unsafe { libc::getrlimit(libc::RLIMIT_MEMLOCK, &mut limit) } == 0;
    let may = known && limit.rlim_max >= bytes;
    if !may {
        skip(&format!("this process and its children may lock less than {bytes} bytes of memory"));
    }
    may
}

fn give_up(limits: &[Limit]) -> io::Result<()> {
    // A file that may not grow is to be an error, not the end.
    // SAFETY: an ignored signal runs no code.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
    for &(resource, most) in limits {
        let limit = libc::rlimit { rlim_cur: most, rlim_max: most };
        // SAFETY: `limit` outlives the call.
        told(unsafe { libc::setrlimit(resource, &limit) }.into())?;
    }
    drop_capabilities()
}

#[repr(C)]
struct Header {
    version: u32,
    /// 0 is the caller.
    pid: i32,
}

#[repr(C)]
#[derive(Clone, Copy, Default)]
struct Sets {
    effective: u32,
    permitted: u32,
    inheritable: u32,
}

fn drop_capabilities() -> io::Result<()> {
    // Without it root would get them back at exec.
    // SAFETY: it takes numbers only.
    told(unsafe { libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) }.into())?;
    let mut header = Header { version: VERSION_3, pid: 0 };
    let mut sets = [Sets::default(); 2];
    // SAFETY: header and sets are of the layout that the version names, and outlive the call.
    told(unsafe { libc::syscall(libc::SYS_capget, &raw mut header, sets.as_mut_ptr()) })?;
    for set in [&mut sets[0].effective, &mut sets[0].permitted, &mut sets[0].inheritable] {
        *set &= !ABOVE_LIMITS;
    }
    // SAFETY: as above.
    told(unsafe { libc::syscall(libc::SYS_capset, &raw mut header, sets.as_ptr()) })
}

fn told(rc: i64) -> io::Result<()> {
    if rc == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}
