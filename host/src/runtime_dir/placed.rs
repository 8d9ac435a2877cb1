//! A socket that listens at a place of the runtime directory. It is put there again where it was removed, for
//! example by a user who empties the directory.
//!
//! Invariant: it has one descriptor as long as it lives. A socket that another program has put at its place
//! meanwhile stays. Its owner takes its file away at the end.

use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixListener as Plain;
use std::path::{Path, PathBuf};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::net::{UnixListener, UnixStream};
use tokio::time::{Interval, MissedTickBehavior, interval};
use trocar_rt::os::{self, Unshared, unshared};

/// Time between two looks at its place.
const LOOK: Duration = Duration::from_secs(1);

/// Binds a socket at its place.
type Bind = Box<dyn Fn() -> io::Result<Plain> + Send + Sync>;

/// A socket that listens, and that no runtime waits at yet.
pub(crate) struct Place {
    path: PathBuf,
    listener: Plain,
    bind: Bind,
}

impl Place {
    /// Binds it at `path`, in place of what a killed process of this number has left.
    ///
    /// # Errors
    /// Those of `bind`.
    pub(crate) fn new(
        path: PathBuf,
        bind: impl Fn() -> io::Result<Plain> + Send + Sync + 'static,
    ) -> io::Result<Place> {
        // Process ids come again: a socket that lies here belongs to no living process.
        let _ = std::fs::remove_file(&path);
        Ok(Place { path, listener: bind()?, bind: Box::new(bind) })
    }

    /// Hands the socket to the runtime that waits for its callers.
    ///
    /// # Errors
    /// A runtime without network.
    pub(crate) fn wait(self) -> io::Result<Placed> {
        let Place { path, listener, bind } = self;
        listener.set_nonblocking(true)?;
        let listener = UnixListener::from_std(listener)?;
        let mut looks = interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let _unshared = unshared(&listener);
        Ok(Placed { path, _unshared, listener: Some(listener), bind, looks })
    }
}

/// A socket whose callers a runtime waits for.
pub(crate) struct Placed {
    path: PathBuf,
    _unshared: Unshared,
    /// Taken only while another one is put in its place.
    listener: Option<UnixListener>,
    bind: Bind,
    looks: Interval,
}

impl Placed {
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn poll_accept(&mut self, cx: &mut Context<'_>) -> Poll<io::Result<UnixStream>> {
        while self.looks.poll_tick(cx).is_ready() {
            self.look();
        }
        match &self.listener {
            Some(listener) => listener.poll_accept(cx).map_ok(|(stream, _)| stream),
            // Its place is looked at again.
            None => Poll::Pending,
        }
    }

    fn look(&mut self) {
        if !trocar_links::is_gone(&self.path) {
            return;
        }
        match self.put() {
            Ok(()) => log::warn!("{} was removed, and was made again", self.path.display()),
            Err(e) if e.kind() == io::ErrorKind::AddrInUse => {}
            // The next look tries again; only a program that looks there misses it.
            Err(e) => {
                log::debug!("{} was removed: {e}", self.path.display());
                // One that is half made would be taken for one that listens.
                let _ = std::fs::remove_file(&self.path);
            }
        }
    }

    fn put(&mut self) -> io::Result<()> {
        let new = (self.bind)()?;
        new.set_nonblocking(true)?;
        let listener = match self.listener.take() {
            Some(listener) => {
                let mut socket = OwnedFd::from(listener.into_std()?);
                os::replace(&mut socket, new.into())?;
                Plain::from(socket)
            }
            None => new,
        };
        self.listener = Some(UnixListener::from_std(listener)?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::future::poll_fn;

    use super::*;

    #[tokio::test]
    async fn a_socket_that_was_removed_is_there_again_and_one_of_another_stays() {
        let temp = tempfile::tempdir().unwrap();
        let path = temp.path().join("run/one.sock");
        let place = path.clone();
        let bind = move || {
            std::fs::create_dir_all(place.parent().unwrap())?;
            Plain::bind(&place)
        };
        let mut placed = Place::new(path.clone(), bind).unwrap().wait().unwrap();
        std::fs::remove_dir_all(temp.path().join("run")).unwrap();
        placed.look();
        let _caller = UnixStream::connect(&path).await.unwrap();
        poll_fn(|cx| placed.poll_accept(cx)).await.unwrap();
        std::fs::remove_file(&path).unwrap();
        let other = Plain::bind(&path).unwrap();
        other.set_nonblocking(true).unwrap();
        placed.look();
        let _caller = UnixStream::connect(&path).await.unwrap();
        assert!(other.accept().is_ok(), "whoever listens there now still does");
    }
}
