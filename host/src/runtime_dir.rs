//! The runtime directory of a user: the sockets of its hosts, and the token it may give to others.
//!
//! Invariant: only its user can read or enter it; the remains of killed processes are swept away by the next
//! one, and nothing else is.

mod placed;

use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{self, Read, Write};
use std::net::SocketAddr;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;
use rustix::process::geteuid;
use rustix::rand::{GetRandomFlags, getrandom};

pub(crate) use placed::{Place, Placed};

/// Beginning of the names that lead to sockets.
const WAY: &str = "at-";

/// Bytes of chance in a token.
const CHANCE: usize = 32;

/// The purpose of a socket beside a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Door {
    /// The services of the port.
    Calls,
    /// The same on a thread and with files of its own, so that Stop gets through whatever the
    /// port is busy with.
    Stop,
}

impl Door {
    fn suffix(self) -> &'static str {
        match self {
            Door::Calls => "calls",
            Door::Stop => "stop",
        }
    }
}

/// `$XDG_STATE_HOME/trocar`, or `~/.local/state/trocar`; without a home directory the temporary one.
pub fn state_home() -> PathBuf {
    let set = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    set("XDG_STATE_HOME")
        .filter(|p| p.is_absolute())
        .or_else(|| set("HOME").map(|home| home.join(".local/state")))
        .unwrap_or_else(std::env::temp_dir)
        .join("trocar")
}

/// A directory with sockets and a token.
#[derive(Clone, Debug)]
pub struct RuntimeDir(PathBuf);

impl RuntimeDir {
    /// The one at `path`, which may not be there yet.
    pub fn at(path: impl Into<PathBuf>) -> RuntimeDir {
        RuntimeDir(path.into())
    }

    /// The directory of this program's user.
    pub fn of_user() -> RuntimeDir {
        RuntimeDir::at(state_home().join("run"))
    }

    /// Returns its path.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Makes the directory, and removes what killed processes left.
    ///
    /// # Errors
    /// A directory that cannot be made, or is not this user's alone.
    pub(crate) fn prepare(&self) -> io::Result<()> {
        DirBuilder::new().recursive(true).mode(0o700).create(&self.0)?;
        self.is_own()?;
        fs::set_permissions(&self.0, fs::Permissions::from_mode(0o700))?;
        self.sweep();
        Ok(())
    }

    /// Tells whether only this user can have put its contents there. Without a home directory it lies in the
    /// temporary one, where any user may have been first.
    ///
    /// # Errors
    /// There is none, or it belongs to another user, or others can write it.
    pub(crate) fn is_own(&self) -> io::Result<()> {
        let told = fs::symlink_metadata(&self.0)?;
        let own = geteuid().as_raw();
        if told.is_dir() && told.uid() == own && told.mode() & 0o022 == 0 {
            return Ok(());
        }
        let why = format!(
            "{} is not a directory that user {own} alone can write (owner {}, mode {:03o}): remove it, or set XDG_STATE_HOME",
            self.0.display(),
            told.uid(),
            told.mode() & 0o777
        );
        Err(io::Error::new(io::ErrorKind::PermissionDenied, why))
    }

    /// The socket of this process beside the port `addr`. Networks have ports of their own, so its name names
    /// the network, too.
    pub(crate) fn door(&self, addr: SocketAddr, door: Door) -> PathBuf {
        self.0.join(format!("{}.{}", std::process::id(), tail(addr, door)))
    }

    /// The name by which clients find the socket beside the port `addr`, whichever process has it: it stays
    /// the same for those that connect again.
    pub(crate) fn way(&self, addr: SocketAddr, door: Door) -> PathBuf {
        self.0.join(format!("{WAY}{}", tail(addr, door)))
    }

    /// Leads clients to the socket of this process.
    ///
    /// # Errors
    /// The directory cannot be written.
    pub(crate) fn lead(&self, addr: SocketAddr, door: Door) -> io::Result<()> {
        let own = self.door(addr, door);
        let new = own.with_extension("new");
        // A file there was left by a process of this number that was killed.
        let _ = fs::remove_file(&new);
        symlink(own.file_name().unwrap_or_default(), &new)?;
        fs::rename(&new, self.way(addr, door))
    }

    /// Stops leading clients to the socket of this process, and removes it. The socket of another
    /// process is left.
    pub(crate) fn close(&self, addr: SocketAddr, door: Door) {
        let (own, way) = (self.door(addr, door), self.way(addr, door));
        if fs::read_link(&way).is_ok_and(|to| Some(to.as_os_str()) == own.file_name()) {
            // A directory that was removed took both along.
            let _ = fs::remove_file(way);
        }
        let _ = fs::remove_file(own);
    }

    /// The token of this user; made when there is none.
    ///
    /// # Errors
    /// A token that can be neither read nor written, or that others could have read.
    pub fn token(&self) -> io::Result<String> {
        match self.known_token() {
            Err(e) if e.kind() == io::ErrorKind::NotFound => {}
            known => return known,
        }
        self.prepare()?;
        let mut chance = [0; CHANCE];
        getrandom(&mut chance, GetRandomFlags::empty())?;
        let token: String = chance.iter().map(|byte| format!("{byte:02x}")).collect();
        // Whole or not there: another program may look at the same moment, or make one.
        let new = self.0.join(format!("token.{}", std::process::id()));
        let mut file = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&new)?;
        file.write_all(format!("{token}\n").as_bytes())?;
        let linked = fs::hard_link(&new, self.token_path());
        fs::remove_file(&new)?;
        match linked {
            Ok(()) => Ok(token),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => self.known_token(),
            Err(e) => Err(e),
        }
    }

    /// The token, if there is one.
    ///
    /// # Errors
    /// There is none, it cannot be read, or others could have read it.
    pub(crate) fn known_token(&self) -> io::Result<String> {
        let path = self.token_path();
        self.is_own()?;
        let no_link = OFlags::NOFOLLOW.bits().cast_signed();
        let mut file = OpenOptions::new().read(true).custom_flags(no_link).open(&path)?;
        let told = file.metadata()?;
        if told.mode() & 0o077 != 0 || told.uid() != geteuid().as_raw() {
            return Err(io::Error::new(
                io::ErrorKind::PermissionDenied,
                format!("others may read {}; remove it, and `trocar token` makes another", path.display()),
            ));
        }
        let mut token = String::new();
        file.read_to_string(&mut token)?;
        let token = token.trim();
        if token.len() != 2 * CHANCE {
            let why = format!("{} holds no token; remove it, and `trocar token` makes one", path.display());
            return Err(io::Error::new(io::ErrorKind::InvalidData, why));
        }
        Ok(token.to_owned())
    }

    fn token_path(&self) -> PathBuf {
        self.0.join("token")
    }

    /// A socket that is just being bound refuses, too, so its process must be gone as well.
    fn sweep(&self) {
        for path in self.entries() {
            let leads =
                path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(WAY.as_bytes()));
            if leads && !path.exists() {
                let _ = fs::remove_file(&path);
                continue;
            }
            let Some(pid) = pid_of(&path) else { continue };
            if !Path::new("/proc").join(pid.to_string()).exists() && refuses(&path) {
                // Another one that starts now may be faster.
                let _ = fs::remove_file(&path);
            }
        }
    }

    /// Returns everything in it.
    pub(crate) fn entries(&self) -> impl Iterator<Item = PathBuf> + use<> {
        fs::read_dir(&self.0).into_iter().flatten().flatten().map(|entry| entry.path())
    }
}

/// Tells whether nobody listens there any more, or not yet.
fn refuses(path: &Path) -> bool {
    std::os::unix::net::UnixStream::connect(path).is_err_and(|e| e.kind() == io::ErrorKind::ConnectionRefused)
}

fn tail(addr: SocketAddr, door: Door) -> String {
    let network = fs::metadata("/proc/self/ns/net").map_or(0, |network| network.ino());
    format!("{addr}.{network:x}.{}", door.suffix())
}

/// The process a socket is named after.
pub(crate) fn pid_of(path: &Path) -> Option<u32> {
    path.file_name()?.to_str()?.split_once('.')?.0.parse().ok()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::os::unix::net::{UnixListener, UnixStream};

    use super::*;

    #[test]
    fn a_token_is_made_once_and_only_its_user_can_read_it() {
        let temp = tempfile::tempdir().unwrap();
        let dir = RuntimeDir::at(temp.path().join("run"));
        assert_eq!(dir.known_token().unwrap_err().kind(), io::ErrorKind::NotFound);
        let token = dir.token().unwrap();
        assert!(token.len() == 64 && token.bytes().all(|b| b.is_ascii_hexdigit()), "{token}");
        assert_eq!(dir.token().unwrap(), token);
        let mode = |path: &Path| fs::metadata(path).unwrap().mode() & 0o777;
        assert_eq!((mode(dir.path()), mode(&dir.token_path())), (0o700, 0o600));
        fs::remove_file(dir.token_path()).unwrap();
        assert_ne!(dir.token().unwrap(), token);
    }

    #[test]
    fn a_token_that_others_could_have_read_is_none_and_neither_is_half_a_one() {
        let temp = tempfile::tempdir().unwrap();
        let dir = RuntimeDir::at(temp.path());
        dir.token().unwrap();
        fs::set_permissions(dir.token_path(), fs::Permissions::from_mode(0o640)).unwrap();
        assert!(dir.token().unwrap_err().to_string().contains("others may read"));
        fs::set_permissions(dir.token_path(), fs::Permissions::from_mode(0o600)).unwrap();
        fs::write(dir.token_path(), "").unwrap();
        assert!(dir.token().unwrap_err().to_string().contains("holds no token"));
    }

    #[test]
    fn a_directory_that_others_can_write_gives_no_token_and_opens_no_door() {
        let temp = tempfile::tempdir().unwrap();
        let dir = RuntimeDir::at(temp.path().join("run"));
        dir.token().unwrap();
        fs::set_permissions(dir.path(), fs::Permissions::from_mode(0o777)).unwrap();
        for refused in [dir.known_token().unwrap_err(), dir.prepare().unwrap_err(), dir.token().unwrap_err()]
        {
            assert!(refused.to_string().contains("alone"), "{refused}");
        }
        fs::set_permissions(dir.path(), fs::Permissions::from_mode(0o700)).unwrap();
        assert!(dir.known_token().is_ok());
        if std::os::unix::fs::chown(dir.path(), Some(65534), None).is_ok() {
            assert!(dir.known_token().is_err(), "it was made by another user");
        }
    }

    #[test]
    fn a_door_is_found_by_the_address_of_its_port_by_the_same_name_whoever_has_it() {
        let temp = tempfile::tempdir().unwrap();
        let dir = RuntimeDir::at(temp.path());
        let at = |port| SocketAddr::from(([127, 0, 0, 1], port));
        let way = dir.way(at(50551), Door::Calls);
        let _listening = UnixListener::bind(dir.door(at(50551), Door::Calls)).unwrap();
        assert!(UnixStream::connect(&way).is_err(), "nobody leads there yet");
        dir.lead(at(50551), Door::Calls).unwrap();
        UnixStream::connect(&way).unwrap();
        for other in [dir.way(at(50551), Door::Stop), dir.way(at(5055), Door::Calls)] {
            assert!(!other.exists(), "{}", other.display());
        }
        // Another process has the port now: the first one leaves its way alone.
        fs::remove_file(&way).unwrap();
        symlink("1.socket.of.another", &way).unwrap();
        dir.close(at(50551), Door::Calls);
        assert_eq!(fs::read_link(&way).unwrap(), Path::new("1.socket.of.another"));
        assert!(!dir.door(at(50551), Door::Calls).exists());
        dir.prepare().unwrap();
        assert!(fs::read_link(&way).is_err(), "it led nowhere");
    }

    #[test]
    fn what_a_killed_process_left_is_swept_away_by_the_next_one_and_nothing_else_is() {
        let temp = tempfile::tempdir().unwrap();
        let dir = RuntimeDir::at(temp.path());
        // No process has so large a number.
        let dead = temp.path().join("4294967295.host.sock");
        drop(UnixListener::bind(&dead).unwrap());
        let binding = temp.path().join(format!("{}.other.sock", std::process::id()));
        drop(UnixListener::bind(&binding).unwrap());
        let token = dir.token().unwrap();
        dir.prepare().unwrap();
        assert!(!dead.exists(), "the dead socket is still there");
        assert!(binding.exists(), "its process lives: it may be about to listen");
        assert_eq!(dir.token().unwrap(), token);
    }
}
