//! Files that a forked child of this process must not keep: while it keeps them, no other process can listen
//! or lock where this process did.
//!
//! Invariant: they are closed in the child before `fork` comes back there, by calls that are allowed at that
//! moment. A child that runs another program loses them anyway, since they are close-on-exec; this is for
//! children that some library makes and keeps.

use std::os::fd::{AsFd, AsRawFd};
use std::sync::Once;
use std::sync::atomic::{AtomicI32, Ordering};

/// Most files that can be named: listeners, and callers.
const MOST: usize = 4096;
const NONE: i32 = -1;

static FILES: [AtomicI32; MOST] = [const { AtomicI32::new(NONE) }; MOST];
static HANDLER: Once = Once::new();

/// A file is this process's alone as long as this lives. Let it go before the file is closed: the number may
/// then be another's.
#[derive(Debug)]
#[must_use = "a forked child keeps the file otherwise"]
pub struct Unshared(Option<usize>);

/// Names a file that forked children close. Where there are too many of them the file is not named, and a
/// child keeps it.
pub fn unshared(file: &impl AsFd) -> Unshared {
    HANDLER.call_once(|| {
        // SAFETY: `forget` is an `extern "C" fn()` that lives as long as the process, and calls only what is
        // safe between fork and exec in a process of several threads: loads of atomics and close(2). A
        // failure (no memory) leaves children as they are.
        unsafe { libc::pthread_atfork(None, None, Some(forget)) };
    });
    let number = file.as_fd().as_raw_fd();
    let free =
        |at: &usize| FILES[*at].compare_exchange(NONE, number, Ordering::AcqRel, Ordering::Acquire).is_ok();
    Unshared((0..MOST).find(free))
}

impl Drop for Unshared {
    fn drop(&mut self) {
        if let Some(at) = self.0 {
            FILES[at].store(NONE, Ordering::Release);
        }
    }
}

/// Runs in the child, on its only thread.
extern "C" fn forget() {
    for file in &FILES {
        let number = file.load(Ordering::Acquire);
        if number != NONE {
            // SAFETY: the child has its own table of files; the numbers named here are files that only this
            // process's code uses, which does not run in the child. An error means that it is closed already.
            unsafe { libc::close(number) };
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::fs::File;
    use std::io::Read;
    use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

    use super::*;

    /// Tells which of `files` a forked child has, one letter each.
    fn kept_by_a_child(files: &[i32]) -> String {
        let mut ends = [0; 2];
        // SAFETY: `ends` is a valid place for two numbers.
        assert_eq!(unsafe { libc::pipe2(ends.as_mut_ptr(), libc::O_CLOEXEC) }, 0);
        // SAFETY: the child calls fcntl, write and _exit alone, which are allowed there.
        let child = unsafe { libc::fork() };
        if child == 0 {
            for file in files {
                // SAFETY: as above; the text is a literal.
                unsafe {
                    let open = libc::fcntl(*file, libc::F_GETFD) >= 0;
                    let letter = if open { b"+" } else { b"-" };
                    libc::write(ends[1], letter.as_ptr().cast(), 1);
                }
            }
            // SAFETY: ends the child without anything of this process's.
            unsafe { libc::_exit(0) };
        }
        // SAFETY: pipe2 has just made both, and nobody else has them.
        let (from, to) = unsafe { (File::from_raw_fd(ends[0]), OwnedFd::from_raw_fd(ends[1])) };
        drop(to);
        let mut told = String::new();
        let mut from = from;
        from.read_to_string(&mut told).unwrap();
        // SAFETY: `child` is a child of this process that nobody else waits for.
        assert_eq!(unsafe { libc::waitpid(child, std::ptr::null_mut(), 0) }, child);
        told
    }

    #[test]
    fn a_forked_child_keeps_what_was_not_named_and_closes_what_is() {
        let [named, other, gone] = [0; 3].map(|_| File::open("/dev/null").unwrap());
        let numbers = [named.as_raw_fd(), other.as_raw_fd(), gone.as_raw_fd()];
        let (_named, was) = (unshared(&named), unshared(&gone));
        drop(was);
        assert_eq!(kept_by_a_child(&numbers), "-++");
    }
}
