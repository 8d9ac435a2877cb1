//! Settings of TCP connections that the safe libraries do not offer.

use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};

/// Sets which packets of this machine go first: 0 is the usual, 6 the most that takes no privilege.
///
/// # Errors
/// It is no socket.
pub fn set_priority(socket: BorrowedFd<'_>, priority: u8) -> io::Result<()> {
    set(socket, libc::SOL_SOCKET, libc::SO_PRIORITY, libc::c_int::from(priority))
}

/// Sets how many bytes may wait in the kernel before they are sent for the first time: a writer of more
/// waits.
///
/// # Errors
/// It is no TCP connection.
pub fn set_most_unsent(socket: BorrowedFd<'_>, bytes: u32) -> io::Result<()> {
    set(socket, libc::IPPROTO_TCP, libc::TCP_NOTSENT_LOWAT, bytes.cast_signed())
}

/// Sets how fast it sends at most, bytes/s: bytes leave one after the other, and not in bursts.
///
/// # Errors
/// It is no socket.
pub fn set_most_rate(socket: BorrowedFd<'_>, bytes_per_second: u64) -> io::Result<()> {
    set(socket, libc::SOL_SOCKET, libc::SO_MAX_PACING_RATE, bytes_per_second)
}

fn set<T: Copy>(socket: BorrowedFd<'_>, level: libc::c_int, option: libc::c_int, value: T) -> io::Result<()> {
    let bytes = size_of::<T>() as libc::socklen_t;
    // SAFETY: the socket is open, and the place holds as many bytes as is said.
    let rc = unsafe { libc::setsockopt(socket.as_raw_fd(), level, option, (&raw const value).cast(), bytes) };
    if rc == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use std::net::{TcpListener, TcpStream};
    use std::os::fd::AsFd;

    use super::*;

    #[test]
    fn a_connection_is_set_and_a_file_is_refused() -> io::Result<()> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let stream = TcpStream::connect(listener.local_addr()?)?;
        set_priority(stream.as_fd(), 6)?;
        set_most_unsent(stream.as_fd(), 1 << 16)?;
        set_most_rate(stream.as_fd(), 117_500_000)?;
        let file = std::fs::File::open("/dev/null")?;
        assert!(set_priority(file.as_fd(), 6).is_err());
        assert!(set_most_unsent(file.as_fd(), 1).is_err());
        assert!(set_most_rate(file.as_fd(), 1).is_err());
        Ok(())
    }
}
