//! Sockets below a path of any length: a socket's own address has room for 108 bytes only.

use std::fs::DirBuilder;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::fs::DirBuilderExt;
use std::path::Path;

use rustix::fs::{Mode, OFlags};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType};
use trocar_rt::os;

/// Connections that may wait to be accepted.
const BACKLOG: i32 = 128;

fn socket() -> io::Result<OwnedFd> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    Ok(rustix::net::socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)?)
}

/// Calls `f` with a short address of the path, which holds as long as the call.
fn with_address<R>(path: &Path, f: impl FnOnce(&SocketAddrUnix) -> rustix::io::Result<R>) -> io::Result<R> {
    let wrong = |why: &str| io::Error::new(io::ErrorKind::InvalidInput, format!("{}: {why}", path.display()));
    let name = path.file_name().ok_or_else(|| wrong("is no name of a socket"))?;
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = rustix::fs::open(parent, OFlags::PATH | OFlags::DIRECTORY | OFlags::CLOEXEC, Mode::empty())?;
    let short = Path::new("/proc/self/fd").join(folder.as_raw_fd().to_string()).join(name);
    let address =
        SocketAddrUnix::new(&short).map_err(|_| wrong("the name of a socket has 80 bytes at most"))?;
    Ok(f(&address)?)
}

/// Tells whether the file of a listening socket was removed.
pub fn is_gone(path: &Path) -> bool {
    path.symlink_metadata().is_err_and(|e| e.kind() == io::ErrorKind::NotFound)
}

/// Listens at `path` as [`listen`], by a socket that listened before; makes the folder where that is gone.
pub(crate) fn listen_anew(socket: &mut OwnedFd, path: &Path) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    }
    os::replace(socket, listen(path)?)
}

/// Listens at `path`, in place of an earlier listener: the caller owns the folder.
pub(crate) fn listen(path: &Path) -> io::Result<OwnedFd> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => {
            let why = format!("{} cannot be replaced: {e}", path.display());
            return Err(io::Error::new(e.kind(), why));
        }
        _ => {}
    }
    let socket = socket()?;
    with_address(path, |address| rustix::net::bind(&socket, address))
        .map_err(|e| io::Error::new(e.kind(), format!("nobody can listen at {}: {e}", path.display())))?;
    rustix::net::listen(&socket, BACKLOG)?;
    Ok(socket)
}

pub(crate) fn dial(path: &Path) -> io::Result<OwnedFd> {
    let socket = socket()?;
    with_address(path, |address| rustix::net::connect(&socket, address))?;
    Ok(socket)
}
