//! Tells another thread of each system call of one thread, and lets the call go on: a seccomp filter with a
//! listener.
//!
//! Invariant: the watched thread is stopped while it is looked at, so what it notes about itself before a
//! call is true for that call; and it goes on whatever was seen.

use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};
use std::thread;

/// No listener yet.
const NONE: i32 = -1;

/// From now on `seen` hears, in a thread of its own, the number of each system call of the calling thread and
/// of the threads it starts.
///
/// # Errors
/// The kernel has no such listener, or another one listens to this thread already.
pub(super) fn tell(seen: impl Fn(i64) + Send + 'static) -> io::Result<()> {
    let handed_over = Arc::new(AtomicI32::new(NONE));
    let taken = handed_over.clone();
    thread::Builder::new().name("trocar-trap".into()).spawn(move || {
        // It must not sleep: the call that would wake it is the first it has to answer.
        while taken.load(Ordering::Acquire) == NONE {
            thread::yield_now();
        }
        let fd = taken.load(Ordering::Acquire);
        if fd > NONE {
            // SAFETY: handed over by the thread that made it, which keeps no copy.
            listen(&unsafe { OwnedFd::from_raw_fd(fd) }, seen);
        }
    })?;
    match install() {
        Ok(fd) => {
            handed_over.store(fd, Ordering::Release);
            Ok(())
        }
        Err(e) => {
            handed_over.store(NONE - 1, Ordering::Release);
            Err(e)
        }
    }
}

/// Answers until the watched threads are gone.
fn listen(listener: &OwnedFd, seen: impl Fn(i64)) {
    loop {
        let mut poll = libc::pollfd { fd: listener.as_raw_fd(), events: libc::POLLIN, revents: 0 };
        // SAFETY: one entry, which lives for the call.
        if unsafe { libc::poll(&raw mut poll, 1, -1) } < 0 || poll.revents & libc::POLLIN == 0 {
            return;
        }
        // SAFETY: plain numbers, all zero, as the kernel demands of what it fills in.
        let mut call: libc::seccomp_notif = unsafe { std::mem::zeroed() };
        let request = libc::SECCOMP_IOCTL_NOTIF_RECV;
        // SAFETY: the listener is open, and there is room for one notice.
        if unsafe { libc::ioctl(listener.as_raw_fd(), request, &raw mut call) } < 0 {
            continue;
        }
        seen(i64::from(call.data.nr));
        let mut answer = libc::seccomp_notif_resp {
            id: call.id,
            val: 0,
            error: 0,
            flags: libc::SECCOMP_USER_NOTIF_FLAG_CONTINUE as u32,
        };
        // SAFETY: as above; a thread that is gone meanwhile needs no answer.
        unsafe { libc::ioctl(listener.as_raw_fd(), libc::SECCOMP_IOCTL_NOTIF_SEND, &raw mut answer) };
    }
}

/// The filter that asks the listener about everything.
fn install() -> io::Result<i32> {
    let always = (libc::BPF_RET | libc::BPF_K) as u16;
    let mut program = [libc::sock_filter { code: always, jt: 0, jf: 0, k: libc::SECCOMP_RET_USER_NOTIF }];
    let filter = libc::sock_fprog { len: 1, filter: program.as_mut_ptr() };
    // SAFETY: both calls concern this thread alone; the program lives through the second.
    let fd = unsafe {
        if libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0 {
            return Err(io::Error::last_os_error());
        }
        let (operation, flags) = (libc::SECCOMP_SET_MODE_FILTER, libc::SECCOMP_FILTER_FLAG_NEW_LISTENER);
        libc::syscall(libc::SYS_seccomp, operation, flags, &raw const filter)
    };
    if fd < 0 { Err(io::Error::last_os_error()) } else { Ok(fd as i32) }
}
