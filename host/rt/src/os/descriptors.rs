//! Descriptors that this program keeps open as long as it runs: those its runtimes wait at, the sockets it
//! listens at, and those it watches directories with.
//!
//! Invariant: a check opens and reads nothing, since the number of a closed file is given to the next one
//! that is opened.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsRawFd, OwnedFd, RawFd};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The purpose of a descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Epoll,
    Eventfd,
    Inotify,
    Listens,
}

impl Kind {
    /// Returns the kind of a descriptor that /proc lists as this; `None` for one that may be closed at any
    /// time.
    fn of(fd: RawFd, listed: &str) -> Option<Kind> {
        match listed {
            "anon_inode:[eventpoll]" => Some(Kind::Epoll),
            "anon_inode:[eventfd]" => Some(Kind::Eventfd),
            "anon_inode:inotify" => Some(Kind::Inotify),
            socket if socket.starts_with("socket:") && listens(fd) => Some(Kind::Listens),
            _ => None,
        }
    }
}

/// A descriptor, and the file it stood for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Descriptor {
    fd: RawFd,
    kind: Kind,
    /// Device and number of the file.
    file: (u64, u64),
}

impl Descriptor {
    fn is_there(&self) -> bool {
        // Held meanwhile, so that a change by this program is seen whole.
        let replaced = replaced();
        let now = file(self.fd);
        now == Some(self.file) || now.is_some() && replaced.get(&self.fd).copied() == now
    }

    /// Tells whether a runtime of this program hears of nothing any more without it.
    pub fn is_vital(&self) -> bool {
        matches!(self.kind, Kind::Epoll | Kind::Eventfd)
    }
}

impl fmt::Display for Descriptor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self.kind {
            Kind::Epoll => "epoll",
            Kind::Eventfd => "eventfd",
            Kind::Inotify => "inotify",
            Kind::Listens => "listening socket",
        };
        write!(f, "{kind} {}", self.fd)
    }
}

/// Files that this program itself has put in the place of lasting ones, by their numbers.
static REPLACED: Mutex<BTreeMap<RawFd, (u64, u64)>> = Mutex::new(BTreeMap::new());

fn replaced() -> MutexGuard<'static, BTreeMap<RawFd, (u64, u64)>> {
    REPLACED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Puts `new` in the place of `old`, which keeps its number and counts as there.
///
/// # Errors
/// The kernel puts nothing in its place.
pub fn replace(old: &mut OwnedFd, new: OwnedFd) -> io::Result<()> {
    let mut replaced = replaced();
    // SAFETY: both are open, and stay owned by these two, whatever they stand for.
    if unsafe { libc::dup3(new.as_raw_fd(), old.as_raw_fd(), libc::O_CLOEXEC) } < 0 {
        return Err(io::Error::last_os_error());
    }
    if let Some(file) = file(old.as_raw_fd()) {
        replaced.insert(old.as_raw_fd(), file);
    }
    Ok(())
}

/// The lasting descriptors of a program.
#[derive(Debug, Default)]
pub struct Lasting {
    all: Vec<Descriptor>,
    next: usize,
}

impl Lasting {
    /// Lists the descriptors that are open now. Reads /proc.
    pub fn list() -> Lasting {
        let listed = fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
        let all = listed.filter_map(|entry| {
            let fd: RawFd = entry.file_name().to_str()?.parse().ok()?;
            let kind = Kind::of(fd, fs::read_link(entry.path()).ok()?.to_str()?)?;
            Some(Descriptor { fd, kind, file: file(fd)? })
        });
        Lasting { all: all.collect(), next: 0 }
    }

    /// Looks at one of them, another each time; false when it is gone. One system call.
    pub fn is_next_there(&mut self) -> bool {
        self.next = if self.next + 1 < self.all.len() { self.next + 1 } else { 0 };
        self.all.get(self.next).is_none_or(Descriptor::is_there)
    }

    /// Tells whether all have been looked at, and the first is the next.
    pub fn is_round(&self) -> bool {
        self.next + 1 >= self.all.len()
    }

    /// Tells whether all are there: a system call for each.
    pub fn are_all_there(&self) -> bool {
        self.all.iter().all(Descriptor::is_there)
    }

    /// Tells whether those are there that a runtime cannot do without: a system call for each.
    pub fn are_vital_there(&self) -> bool {
        self.all.iter().filter(|d| d.is_vital()).all(Descriptor::is_there)
    }

    /// Returns the descriptors that are gone, once. A system call for each.
    pub fn take_gone(&mut self) -> Vec<Descriptor> {
        let (there, gone) = self.all.iter().partition(|d| d.is_there());
        self.all = there;
        gone
    }
}

/// Returns the file behind a descriptor; `None` when it is closed.
fn file(fd: RawFd) -> Option<(u64, u64)> {
    let mut stat = MaybeUninit::<libc::stat>::uninit();
    // SAFETY: the place is a whole `stat`; the number need not be open.
    let rc = unsafe { libc::fstat(fd, stat.as_mut_ptr()) };
    // SAFETY: written, by the answer.
    (rc == 0).then(|| unsafe { stat.assume_init() }).map(|stat| (stat.st_dev, stat.st_ino))
}

fn listens(fd: RawFd) -> bool {
    let (mut answer, mut bytes) = (0 as libc::c_int, size_of::<libc::c_int>() as libc::socklen_t);
    let option = libc::SO_ACCEPTCONN;
    // SAFETY: the place holds as many bytes as is said; the number need not be a socket.
    let rc =
        unsafe { libc::getsockopt(fd, libc::SOL_SOCKET, option, (&raw mut answer).cast(), &raw mut bytes) };
    rc == 0 && answer != 0
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;
    use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

    use super::*;

    /// Looks at these only: tests beside this one open and close others.
    fn only(fds: [RawFd; 2]) -> Lasting {
        let mut all = Lasting::list();
        all.all.retain(|d| fds.contains(&d.fd));
        all
    }

    #[test]
    fn what_is_closed_or_stands_for_another_file_is_gone_once() -> Result<(), Box<dyn std::error::Error>> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        // SAFETY: a new descriptor, owned by nobody else.
        let epoll = unsafe { OwnedFd::from_raw_fd(libc::epoll_create1(libc::EPOLL_CLOEXEC)) };
        let (port, poll) = (listener.as_raw_fd(), epoll.as_raw_fd());
        let mut lasting = only([port, poll]);
        assert!(lasting.are_all_there() && lasting.take_gone().is_empty() && lasting.is_next_there());
        // Another file takes its number, as after a close and an open.
        let other = fs::File::open("/dev/null")?;
        // SAFETY: both numbers are open and owned by this test.
        assert!(unsafe { libc::dup2(other.as_raw_fd(), port) } == port);
        drop(epoll);
        assert!(!lasting.are_all_there());
        assert!((0..2).any(|_| !lasting.is_next_there()), "in turn each is looked at");
        let mut gone = lasting.take_gone();
        gone.sort_by_key(|d| d.is_vital());
        let said: Vec<String> = gone.iter().map(ToString::to_string).collect();
        assert_eq!(said, [format!("listening socket {port}"), format!("epoll {poll}")]);
        assert_eq!(gone.iter().map(Descriptor::is_vital).collect::<Vec<_>>(), [false, true]);
        assert!(lasting.take_gone().is_empty(), "told once");
        Ok(())
    }

    #[test]
    fn one_that_the_program_replaces_by_itself_is_there_until_it_is_closed() -> io::Result<()> {
        let mut listener = OwnedFd::from(TcpListener::bind("127.0.0.1:0")?);
        let number = listener.as_raw_fd();
        let mut lasting = only([number, number]);
        replace(&mut listener, TcpListener::bind("127.0.0.1:0")?.into())?;
        assert!(listener.as_raw_fd() == number && listens(number));
        assert!(lasting.are_all_there() && lasting.take_gone().is_empty());
        let other = fs::File::open("/dev/null")?;
        // SAFETY: both numbers are open and owned by this test.
        assert!(unsafe { libc::dup2(other.as_raw_fd(), number) } == number);
        assert_eq!(lasting.take_gone().len(), 1, "another one has replaced it");
        Ok(())
    }

    #[test]
    fn what_a_program_opens_and_closes_as_it_goes_is_not_on_the_list()
    -> Result<(), Box<dyn std::error::Error>> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let connected = std::net::TcpStream::connect(listener.local_addr()?)?;
        let plain = fs::File::open("/dev/null")?;
        assert!(only([connected.as_raw_fd(), plain.as_raw_fd()]).all.is_empty());
        Ok(())
    }
}
