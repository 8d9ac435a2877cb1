//! State of the whole process that any code in it may change: its locale, the mask for new files, the actions
//! of signals, its standard streams, its environment.
//!
//! Invariant: looked at by system calls, so never from a step; only differences are put back, and a change of
//! this program's own is never taken for foreign.

use std::ffi::{CStr, CString, c_int, c_void};
use std::fs::File;
use std::io::{self, Write};
use std::mem::{MaybeUninit, zeroed};
use std::os::fd::{AsRawFd, FromRawFd, IntoRawFd, OwnedFd};
use std::sync::OnceLock;

use super::Environment;

/// Signals that have names; those above are free for any use.
const SIGNALS: [(c_int, &str); 20] = [
    (libc::SIGHUP, "SIGHUP"),
    (libc::SIGINT, "SIGINT"),
    (libc::SIGQUIT, "SIGQUIT"),
    (libc::SIGILL, "SIGILL"),
    (libc::SIGTRAP, "SIGTRAP"),
    (libc::SIGABRT, "SIGABRT"),
    (libc::SIGBUS, "SIGBUS"),
    (libc::SIGFPE, "SIGFPE"),
    (libc::SIGUSR1, "SIGUSR1"),
    (libc::SIGSEGV, "SIGSEGV"),
    (libc::SIGUSR2, "SIGUSR2"),
    (libc::SIGPIPE, "SIGPIPE"),
    (libc::SIGALRM, "SIGALRM"),
    (libc::SIGTERM, "SIGTERM"),
    (libc::SIGCHLD, "SIGCHLD"),
    (libc::SIGXCPU, "SIGXCPU"),
    (libc::SIGXFSZ, "SIGXFSZ"),
    (libc::SIGVTALRM, "SIGVTALRM"),
    (libc::SIGPROF, "SIGPROF"),
    (libc::SIGSYS, "SIGSYS"),
];

const STREAMS: [&str; 3] = ["standard input", "standard output", "standard error"];

/// Copies of the standard streams, above their numbers.
static KEPT: OnceLock<[Option<File>; STREAMS.len()]> = OnceLock::new();

/// Keeps the standard streams as they are: code that closes them takes nothing away from [`standard_error`],
/// and they can be put back. Once; later calls change nothing.
pub fn keep_streams() {
    KEPT.get_or_init(|| [0, 1, 2].map(|fd| copy_from(fd, STREAMS.len() as c_int).map(File::from)));
}

/// Returns a copy of an open descriptor, at the first free number from `least` on.
fn copy_from(fd: c_int, least: c_int) -> Option<OwnedFd> {
    // SAFETY: makes a new descriptor of one that need not be open, and closes none.
    let copy = unsafe { libc::fcntl(fd, libc::F_DUPFD_CLOEXEC, least) };
    // SAFETY: it is new, so nobody else's.
    (copy >= 0).then(|| unsafe { OwnedFd::from_raw_fd(copy) })
}

/// Returns standard error as it was when it was kept, whatever has become of its number since.
pub fn standard_error() -> impl Write {
    enum Out {
        Kept(&'static File),
        Now(io::Stderr),
    }
    impl Write for Out {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            match self {
                Out::Kept(file) => file.write(bytes),
                Out::Now(stderr) => stderr.write(bytes),
            }
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    match KEPT.get() {
        Some([.., Some(file)]) => Out::Kept(file),
        _ => Out::Now(io::stderr()),
    }
}

/// The state of the process at one moment.
#[derive(Clone)]
pub struct Household {
    locale: CString,
    umask: Option<u32>,
    handlers: [libc::sigaction; SIGNALS.len()],
    /// True for those that are open.
    streams: [bool; STREAMS.len()],
    environment: Option<Environment>,
}

impl Household {
    /// Looks at the state with some 30 system calls.
    pub fn look() -> Household {
        Household {
            locale: locale(),
            umask: umask(),
            handlers: SIGNALS.map(|(signal, _)| handler(signal)),
            // SAFETY: asks for the flags of a number, which need not be open.
            streams: [0, 1, 2].map(|fd| unsafe { libc::fcntl(fd, libc::F_GETFD) } != -1),
            environment: Environment::look(),
        }
    }

    /// Takes over from `now` the state that is only told and never put back.
    pub fn take_over(&mut self, now: &Household) {
        self.environment.clone_from(&now.environment);
    }

    /// Puts back what `now` has changed since this, as far as that goes; returns a sentence for each change.
    pub fn put_back(&self, now: &Household) -> Vec<String> {
        let mut said = Vec::new();
        if now.locale != self.locale {
            // SAFETY: a name that setlocale gave.
            let done = unsafe { libc::setlocale(libc::LC_ALL, self.locale.as_ptr()) };
            let back = if done.is_null() { "and could not be put back" } else { "which was put back" };
            said.push(format!(
                "the locale of the process to {}, {back}: use newlocale and uselocale, for your thread alone",
                now.locale.to_string_lossy()
            ));
        }
        if let (Some(was), Some(is)) = (self.umask, now.umask)
            && was != is
        {
            // SAFETY: any mask is one.
            unsafe { libc::umask(was) };
            said.push(format!("the umask of the process to {is:03o}, which was put back to {was:03o}"));
        }
        for (i, (signal, name)) in SIGNALS.iter().enumerate() {
            let (was, is) = (&self.handlers[i], &now.handlers[i]);
            if was.sa_sigaction != is.sa_sigaction && !is_ours(is.sa_sigaction) {
                // SAFETY: an action that sigaction gave for this signal.
                let done = unsafe { libc::sigaction(*signal, was, std::ptr::null_mut()) };
                let back = if done == 0 { "which was put back" } else { "and could not be put back" };
                said.push(format!("what {name} does in the process, {back}"));
            }
        }
        for (fd, name) in STREAMS.iter().enumerate() {
            if self.streams[fd] && !now.streams[fd] {
                let back = if reopen(fd) {
                    "which was put back"
                } else if open_nothing(fd as c_int) {
                    "which leads nowhere now"
                } else {
                    "which stays closed"
                };
                said.push(format!("the {name} of the process by closing it, {back}"));
            }
        }
        if let (Some(was), Some(is)) = (&self.environment, &now.environment) {
            said.extend(is.said_since(was));
        }
        said
    }
}

fn locale() -> CString {
    // SAFETY: a null name only asks; what is given lives until the locale is changed.
    let name = unsafe { libc::setlocale(libc::LC_ALL, std::ptr::null()) };
    if name.is_null() {
        return c"C".into();
    }
    // SAFETY: a text of the C library's.
    unsafe { CStr::from_ptr(name) }.into()
}

/// Returns the mask as the kernel shows it: asking by `umask` would change it for others meanwhile.
fn umask() -> Option<u32> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let word = status.lines().find_map(|line| line.strip_prefix("Umask:"))?;
    u32::from_str_radix(word.trim(), 8).ok()
}

fn handler(signal: c_int) -> libc::sigaction {
    // SAFETY: an all-zero action is a valid place for the answer; a null new action only asks.
    unsafe {
        let mut now: libc::sigaction = zeroed();
        libc::sigaction(signal, std::ptr::null(), &mut now);
        now
    }
}

/// Tells whether the handler is code of this program, such as that of its runtime, and of no library.
fn is_ours(handler: usize) -> bool {
    let of = |address: *const c_void| {
        let mut found = MaybeUninit::<libc::Dl_info>::uninit();
        // SAFETY: the room is a whole Dl_info, which is written when the answer is not 0; any address may be
        // asked for.
        (unsafe { libc::dladdr(address, found.as_mut_ptr()) } != 0)
            // SAFETY: written, by the answer.
            .then(|| unsafe { found.assume_init() }.dli_fbase)
    };
    let own = of(is_ours as fn(usize) -> bool as *const c_void);
    handler != libc::SIG_DFL
        && handler != libc::SIG_IGN
        && own.is_some()
        && of(handler as *const c_void) == own
}

/// Puts a closed stream back as it was kept. Returns false where there is no copy, or another file has the
/// number by now.
fn reopen(stream: usize) -> bool {
    let Some(kept) = KEPT.get().and_then(|kept| kept[stream].as_ref()) else { return false };
    match copy_from(kept.as_raw_fd(), stream as c_int) {
        Some(copy) if copy.as_raw_fd() == stream as c_int => {
            // Programs that are started take the copy over, as they do the stream itself.
            // SAFETY: changes a flag of a descriptor that is open.
            unsafe { libc::fcntl(copy.as_raw_fd(), libc::F_SETFD, 0) };
            // The file stays open under its number.
            let _ = copy.into_raw_fd();
            true
        }
        _ => false,
    }
}

/// Opens the null device at a closed number, so that no other file takes that number.
fn open_nothing(fd: c_int) -> bool {
    // SAFETY: a constant text; the file is ours until it is at its number.
    unsafe {
        let opened = libc::open(c"/dev/null".as_ptr(), libc::O_RDWR);
        // Another thread may have taken the number meanwhile: then it is open, and its own.
        if opened >= 0 && opened != fd {
            libc::close(opened);
        }
        libc::fcntl(fd, libc::F_GETFD) != -1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_process_shares_is_seen_and_put_back_and_said() {
        let before = Household::look();
        // SAFETY: a mask, and an action that ignores a signal nobody here uses.
        unsafe {
            libc::umask(0o077);
            libc::signal(libc::SIGUSR2, libc::SIG_IGN);
        }
        let said = before.put_back(&Household::look()).join("; ");
        assert!(said.contains("the umask of the process to 077, which was put back"), "{said}");
        assert!(said.contains("what SIGUSR2 does in the process, which was put back"), "{said}");
        let mut after = Household::look();
        // A test beside this one changes it.
        after.take_over(&before);
        assert_eq!((after.umask, handler(libc::SIGUSR2).sa_sigaction), (before.umask, libc::SIG_DFL));
        assert!(before.put_back(&after).is_empty(), "nothing is left to put back");
    }

    #[test]
    fn a_handler_of_the_program_itself_is_nobody_elses_doing() {
        extern "C" fn own(_: c_int) {}
        let own = own as extern "C" fn(c_int) as usize;
        assert!(is_ours(own) && !is_ours(libc::getpid as *const () as usize));
        assert!(!is_ours(libc::SIG_IGN) && !is_ours(libc::SIG_DFL));
    }
}
