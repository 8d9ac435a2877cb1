//! The state directory of a process, and the lock that keeps a second process out of it.
//!
//! Invariant: a directory has one user at a time, also when its files were removed under that user. An OS
//! lock ensures that; the kernel releases it when the process ends, however it ends. An ephemeral directory
//! is gone after its process.

use std::fmt;
use std::fs::{self, DirBuilder, File};
use std::io::{ErrorKind, Read, Seek, Write};
use std::net::SocketAddr;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::os::unix::net::{SocketAddr as UnixAddr, UnixDatagram};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use parking_lot::Mutex;
use trocar_loader::Hash;
use trocar_rt::os::{Unshared, unshared};

use super::HostError;
use crate::journal;
use crate::runtime_dir::state_home;

const LOCK: &str = "lock";
/// A process has locked its directory this long after making it.
const STARTING: Duration = Duration::from_secs(60);
/// Beginning of the names of ephemeral directories.
const EPHEMERAL: &str = "trocar-run-";

/// Choice of a state directory, as `--state` makes it.
#[derive(Clone, Debug, PartialEq)]
pub enum StateChoice {
    /// Kept: counters, plugin cache, logs.
    Durable(PathBuf),
    /// Made now, removed at the end.
    Ephemeral,
}

/// An open state directory, locked until it is released or dropped.
#[derive(Debug)]
pub struct StateDir {
    path: PathBuf,
    /// The directory that this one stands in for.
    asked_for: Option<PathBuf>,
    /// Keeps other processes out of that one.
    _claim: Option<UnixDatagram>,
    ephemeral: bool,
    /// True: the directory was not there before.
    made: bool,
    /// True: the directory is removed at the end.
    goes: AtomicBool,
    hold: Mutex<Option<Hold>>,
}

/// Locks that keep other processes out.
#[derive(Debug)]
struct Hold {
    /// Keeps the locks from children: one that a plugin forks and leaves behind would keep the
    /// next process out.
    _unshared: [Option<Unshared>; 2],
    lock: File,
    _claim: Option<UnixDatagram>,
}

/// Why a directory is not opened.
#[derive(Debug)]
enum Unopened {
    Refused(HostError),
    /// Its disk cannot be written now.
    Away(std::io::Error),
}

/// Tells whether the disk, and not the choice of the directory, is the reason.
fn is_away(error: &std::io::Error, path: &Path) -> bool {
    let is_mine = || {
        fs::metadata(path).is_ok_and(|dir| dir.is_dir() && dir.uid() == rustix::process::geteuid().as_raw())
    };
    match error.kind() {
        ErrorKind::ReadOnlyFilesystem | ErrorKind::StorageFull | ErrorKind::QuotaExceeded => true,
        // Somebody took the right to write it.
        ErrorKind::PermissionDenied => is_mine(),
        _ => error.raw_os_error() == Some(rustix::io::Errno::IO.raw_os_error()),
    }
}

impl StateDir {
    /// Makes the directory where it is missing and locks it. `fresh` empties it first.
    ///
    /// One whose disk is full or read-only is stood in for by another.
    ///
    /// # Errors
    /// In use, not writable, or not a directory.
    pub fn open(choice: &StateChoice, fresh: bool) -> Result<Self, HostError> {
        match choice {
            StateChoice::Durable(path) => {
                let dir = match Self::lock(path, false) {
                    Ok(dir) => dir,
                    Err(Unopened::Refused(e)) => return Err(e),
                    Err(Unopened::Away(e)) => return Self::instead_of(path, fresh, &e),
                };
                if fresh {
                    dir.clear()?;
                }
                Ok(dir)
            }
            StateChoice::Ephemeral => {
                let base = ephemeral_base();
                sweep(&base);
                Self::lock(&base.join(ephemeral_name()), true).map_err(|e| match e {
                    Unopened::Refused(e) => e,
                    Unopened::Away(e) => HostError::StateUnwritable { dir: base, because: e.to_string() },
                })
            }
        }
    }

    /// Makes a directory that stands in for one whose disk is full or read-only: devices are driven all the
    /// same.
    fn instead_of(path: &Path, fresh: bool, error: &std::io::Error) -> Result<Self, HostError> {
        // Its lock may not be taken now; its name can.
        let claim = if path.exists() { claim(path)? } else { None };
        let mut stands_in = Self::open(&StateChoice::Ephemeral, false)?;
        log::error!(
            "the state directory {} cannot be written: {error}; {} stands in for it, and is removed at the end",
            path.display(),
            stands_in.path.display()
        );
        // A journal that was to be forgotten is not gone on with.
        stands_in.asked_for = (!fresh).then(|| path.to_owned());
        stands_in._claim = claim;
        Ok(stands_in)
    }

    /// Returns the directory of what is to outlive the process, which may not be one that can be written now;
    /// `None`: nothing is to.
    pub(super) fn lasting(&self) -> Option<&Path> {
        let own = (!self.ephemeral).then_some(self.path.as_path());
        self.asked_for.as_deref().or(own)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    fn lock(path: &Path, ephemeral: bool) -> Result<Self, Unopened> {
        let unwritable = |e: std::io::Error| match is_away(&e, path) {
            true => Unopened::Away(e),
            false => {
                Unopened::Refused(HostError::StateUnwritable { dir: path.to_owned(), because: e.to_string() })
            }
        };
        let made = !path.exists();
        DirBuilder::new().recursive(true).mode(0o700).create(path).map_err(unwritable)?;
        let mut file = File::options()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .open(path.join(LOCK))
            .map_err(unwritable)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => {
                let mut pid = String::new();
                // An unreadable holder is still a holder.
                let _ = file.read_to_string(&mut pid);
                let (dir, pid) = (path.to_owned(), pid.lines().next().unwrap_or_default().to_owned());
                return Err(Unopened::Refused(HostError::StateInUse { dir, pid }));
            }
            Err(fs::TryLockError::Error(e)) => return Err(unwritable(e)),
        }
        let claim = if ephemeral { None } else { claim(path).map_err(Unopened::Refused)? };
        file.set_len(0).and_then(|()| file.rewind()).map_err(unwritable)?;
        // For people alone: on a full disk the lock holds without.
        let _ = writeln!(file, "{}", std::process::id());
        let unshared = [Some(unshared(&file)), claim.as_ref().map(unshared)];
        let hold = Mutex::new(Some(Hold { _unshared: unshared, lock: file, _claim: claim }));
        let (path, goes) = (path.to_owned(), AtomicBool::new(ephemeral));
        Ok(Self { path, asked_for: None, _claim: None, ephemeral, made, goes, hold })
    }

    /// Takes back at the end what `open` made, for a process that does not come up after all.
    pub(super) fn undo(&self) {
        self.goes.fetch_or(self.made, Ordering::Relaxed);
    }

    /// Tells others what uses the directory.
    pub(super) fn is_used_by(&self, kind: &Kind) {
        if let Some(hold) = &*self.hold.lock() {
            let (mut lock, text) = (&hold.lock, format!("{}\n{kind}\n", std::process::id()));
            // On a full disk nobody can be told, and nobody takes over.
            let written = lock.rewind().and_then(|()| lock.write_all(text.as_bytes()));
            let _ = written.and_then(|()| lock.set_len(text.len() as u64));
        }
    }

    /// Leaves the directory to others; removes an ephemeral one.
    pub(super) fn release(&self) {
        let hold = self.hold.lock().take();
        if hold.is_some() && self.goes.load(Ordering::Relaxed) {
            // Best effort: the system cleans its temporary files.
            let _ = fs::remove_dir_all(&self.path);
        }
    }

    /// Forgets everything but the counters that must never go back (`gcm.json`: term and epochs fence
    /// old processes) and old journals, and puts the journal aside.
    fn clear(&self) -> Result<(), HostError> {
        let unwritable =
            |e: std::io::Error| HostError::StateUnwritable { dir: self.path.clone(), because: e.to_string() };
        for entry in fs::read_dir(&self.path).map_err(unwritable)? {
            let entry = entry.map_err(unwritable)?;
            let name = entry.file_name();
            // Journals are the audit, too.
            if name == LOCK || name == "gcm.json" || name == journal::FILE || journal::is_aside(&name) {
                continue;
            }
            let gone = match entry.file_type().map_err(unwritable)?.is_dir() {
                true => fs::remove_dir_all(entry.path()),
                false => fs::remove_file(entry.path()),
            };
            gone.or_else(|e| if e.kind() == ErrorKind::NotFound { Ok(()) } else { Err(unwritable(e)) })?;
        }
        match journal::put_aside(&self.path) {
            Ok(aside) => log::info!("the journal is begun anew: the one before it is {}", aside.display()),
            Err(e) if e.kind() == ErrorKind::NotFound => {}
            Err(e) => return Err(unwritable(e)),
        }
        Ok(())
    }
}

impl Drop for StateDir {
    fn drop(&mut self) {
        self.release();
    }
}

/// What uses a directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A GCM without components, which listens there.
    Gcm(SocketAddr),
    /// One among several over etcd.
    Candidate,
    Other,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Kind::Gcm(addr) => write!(f, "gcm {addr}"),
            Kind::Candidate => f.write_str("candidate"),
            Kind::Other => f.write_str("other"),
        }
    }
}

/// The process that uses a directory.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Holder {
    /// As it sees itself; 0: it has not said yet.
    pub(super) pid: u32,
    pub(super) kind: Kind,
}

/// Returns the process that uses the directory.
pub(super) fn holder(dir: &Path) -> Option<Holder> {
    let mut file = File::open(dir.join(LOCK)).ok()?;
    // A lock that is not taken says nothing; one that was taken for this look goes with the file.
    if !matches!(file.try_lock_shared(), Err(fs::TryLockError::WouldBlock)) {
        return None;
    }
    let mut text = String::new();
    // What cannot be read has said nothing yet.
    let _ = file.read_to_string(&mut text);
    let mut lines = text.lines();
    let pid = lines.next().and_then(|line| line.parse().ok()).unwrap_or_default();
    let kind = match lines.next().and_then(|line| line.split_once(' ').or(Some((line, "")))) {
        Some(("gcm", addr)) => addr.parse().map_or(Kind::Other, Kind::Gcm),
        Some(("candidate", _)) => Kind::Candidate,
        _ => Kind::Other,
    };
    Some(Holder { pid, kind })
}

/// Tells whether a process of this number here is the one that uses the directory: in a container numbers are
/// others.
pub(super) fn is_held_by(dir: &Path, pid: u32) -> bool {
    let Ok(lock) = fs::metadata(dir.join(LOCK)) else { return false };
    let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
    let mut files = open.filter_map(|file| fs::metadata(file.path()).ok());
    files.any(|file| (file.dev(), file.ino()) == (lock.dev(), lock.ino()))
}

/// Takes the directory's name, as an abstract socket: `rm -rf` of a directory in use takes its lock file
/// along, not this name. `None` where the system gives no such socket; then the lock file is all there is.
fn claim(path: &Path) -> Result<Option<UnixDatagram>, HostError> {
    let unwritable =
        |e: std::io::Error| HostError::StateUnwritable { dir: path.to_owned(), because: e.to_string() };
    let whole = path.canonicalize().map_err(unwritable)?;
    let name = format!("trocar-state-{}", Hash::of(whole.as_os_str().as_encoded_bytes()));
    match UnixAddr::from_abstract_name(name).and_then(|name| UnixDatagram::bind_addr(&name)) {
        Ok(claim) => Ok(Some(claim)),
        Err(e) if e.kind() == ErrorKind::AddrInUse => Err(HostError::StateHeld { dir: path.to_owned() }),
        Err(_) => Ok(None),
    }
}

/// Returns a name that no other host takes. The number tells the hosts of one process apart; the time tells
/// apart those of processes with one id (in other containers).
fn ephemeral_name() -> String {
    static HOSTS: AtomicU64 = AtomicU64::new(0);
    let host = HOSTS.fetch_add(1, Ordering::Relaxed);
    let nanos = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.subsec_nanos());
    format!("{EPHEMERAL}{}-{host}-{nanos:08x}", std::process::id())
}

/// Returns the temporary directory, unless programs may not be run there: plugins are opened from the
/// state directory.
fn ephemeral_base() -> PathBuf {
    let temp = std::env::temp_dir();
    if forbids_execution(&temp) { state_home() } else { temp }
}

/// Removes the ephemeral directories of processes that were killed: their lock is free.
fn sweep(base: &Path) {
    for entry in fs::read_dir(base).into_iter().flatten().flatten() {
        let ours = entry.file_name().to_str().is_some_and(|name| name.starts_with(EPHEMERAL));
        if ours && File::open(entry.path().join(LOCK)).is_ok_and(|lock| is_abandoned(&lock)) {
            // Another user's directory stays, as it must.
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// A fresh lock file may belong to a process that is about to lock it.
fn is_abandoned(lock: &File) -> bool {
    let made = lock.metadata().and_then(|m| m.modified());
    let old = made.is_ok_and(|made| made.elapsed().is_ok_and(|age| age > STARTING));
    old && lock.try_lock().is_ok()
}

/// True when `path` lies on a mount with `noexec`.
fn forbids_execution(path: &Path) -> bool {
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let mounts = fs::read_to_string("/proc/self/mountinfo").unwrap_or_default();
    options_of(&mounts, &path).is_some_and(|options| options.split(',').any(|o| o == "noexec"))
}

/// The options of the mount `path` lies on: the deepest mount point above it, the last one of equal ones.
fn options_of<'m>(mountinfo: &'m str, path: &Path) -> Option<&'m str> {
    mountinfo
        .lines()
        .filter_map(|line| {
            let mut words = line.split(' ').skip(4);
            Some((Path::new(words.next()?), words.next()?))
        })
        .filter(|(point, _)| path.starts_with(point))
        .max_by_key(|(point, _)| point.components().count())
        .map(|(_, options)| options)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_second_user_of_a_state_directory_is_told_who_holds_it() {
        let temp = tempfile::tempdir().unwrap();
        let choice = StateChoice::Durable(temp.path().join("state"));
        let first = StateDir::open(&choice, false).unwrap();
        let refused = StateDir::open(&choice, false).unwrap_err();
        assert!(refused.to_string().contains(&format!("process {}", std::process::id())), "{refused}");
        drop(first);
        StateDir::open(&choice, false).unwrap();
    }

    #[test]
    fn a_directory_removed_under_its_user_is_still_in_use() {
        let temp = tempfile::tempdir().unwrap();
        let choice = StateChoice::Durable(temp.path().join("state"));
        let first = StateDir::open(&choice, false).unwrap();
        fs::remove_dir_all(first.path()).unwrap();
        let refused = StateDir::open(&choice, false).unwrap_err();
        assert_eq!(refused.reason(), "STATE_IN_USE", "{refused}");
        assert!(refused.to_string().contains("removed"), "{refused}");
        drop(first);
        StateDir::open(&choice, false).unwrap();
    }

    #[test]
    fn fresh_keeps_the_counters_and_forgets_the_rest() {
        let temp = tempfile::tempdir().unwrap();
        let choice = StateChoice::Durable(temp.path().to_owned());
        fs::write(temp.path().join("gcm.json"), "{}").unwrap();
        fs::create_dir(temp.path().join("plugins")).unwrap();
        fs::write(temp.path().join("trocar.log"), "").unwrap();
        let dir = StateDir::open(&choice, true).unwrap();
        let mut left: Vec<_> = fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, ["gcm.json", "lock"]);
    }

    #[test]
    fn fresh_puts_each_journal_aside_and_keeps_the_last_eight() {
        let temp = tempfile::tempdir().unwrap();
        let choice = StateChoice::Durable(temp.path().to_owned());
        let aside = |number: u32| temp.path().join(format!("{}.old-{number}", journal::FILE));
        for number in 1..=10 {
            fs::write(temp.path().join(journal::FILE), format!("journal {number}")).unwrap();
            StateDir::open(&choice, true).unwrap();
            assert!(!temp.path().join(journal::FILE).exists());
            // Without a journal there is nothing to put aside.
            StateDir::open(&choice, true).unwrap();
            for kept in 1..=number {
                let text = fs::read_to_string(aside(kept)).ok();
                assert_eq!(
                    text,
                    (kept + 8 > number).then(|| format!("journal {kept}")),
                    "{kept} of {number}"
                );
            }
            assert!(!aside(number + 1).exists());
        }
        fs::write(temp.path().join("journal.redb.old-new"), "").unwrap();
        StateDir::open(&choice, true).unwrap();
        assert!(!temp.path().join("journal.redb.old-new").exists(), "it is no journal");
    }

    #[test]
    fn an_ephemeral_directory_is_gone_afterwards() {
        let dir = StateDir::open(&StateChoice::Ephemeral, false).unwrap();
        let path = dir.path().to_owned();
        assert!(path.is_dir());
        drop(dir);
        assert!(!path.exists(), "{} is still there", path.display());
    }

    #[test]
    fn hosts_that_start_at_the_same_moment_have_directories_of_their_own() {
        let open = || StateDir::open(&StateChoice::Ephemeral, false).unwrap();
        let names: std::collections::BTreeSet<String> = (0..1000).map(|_| ephemeral_name()).collect();
        assert_eq!(names.len(), 1000);
        let (one, other) = (open(), open());
        assert_ne!(one.path(), other.path());
    }

    #[test]
    fn what_a_killed_process_left_is_swept_away_and_a_living_ones_directory_stays() {
        let temp = tempfile::tempdir().unwrap();
        let (dead, alive) = (temp.path().join("trocar-run-1-0"), temp.path().join("trocar-run-2-0"));
        drop(StateDir::lock(&dead, false).unwrap());
        let held = StateDir::lock(&alive, true).unwrap();
        sweep(temp.path());
        assert!(dead.exists(), "a directory this young may be somebody's who is just starting");
        for dir in [&dead, &alive] {
            let lock = File::options().write(true).open(dir.join(LOCK)).unwrap();
            lock.set_modified(SystemTime::now() - 2 * STARTING).unwrap();
        }
        sweep(temp.path());
        assert!(!dead.exists(), "the dead one is still there");
        assert!(alive.exists(), "the living one is gone");
        drop(held);
    }

    #[test]
    fn undo_removes_a_directory_that_was_made_and_keeps_one_that_was_there() {
        let temp = tempfile::tempdir().unwrap();
        let new = temp.path().join("new");
        StateDir::open(&StateChoice::Durable(new.clone()), false).unwrap().undo();
        assert!(!new.exists(), "the new directory is still there");
        StateDir::open(&StateChoice::Durable(temp.path().to_owned()), false).unwrap().undo();
        assert!(temp.path().exists(), "a directory that was there before is gone");
    }

    #[test]
    fn a_file_in_the_way_is_named() {
        let temp = tempfile::tempdir().unwrap();
        let file = temp.path().join("file");
        fs::write(&file, "").unwrap();
        let refused = StateDir::open(&StateChoice::Durable(file.join("state")), false).unwrap_err();
        assert!(refused.to_string().contains("file/state"), "{refused}");
    }

    #[test]
    fn the_deepest_and_newest_mount_counts() {
        let mounts = "1 0 0:1 / / rw,relatime - ext4 a b\n2 1 0:2 / /tmp rw,noexec - tmpfs a b\n\
                      3 2 0:3 / /tmp/x rw - tmpfs a b\n";
        assert_eq!(options_of(mounts, Path::new("/tmp/a")), Some("rw,noexec"));
        assert_eq!(options_of(mounts, Path::new("/tmp/x/y")), Some("rw"));
        assert_eq!(options_of(mounts, Path::new("/tmpfile")), Some("rw,relatime"));
    }
}
