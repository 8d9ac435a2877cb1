//! Sockets beside the port, in the user's runtime directory: one for calls, and one for Stop on a thread of
//! its own.
//!
//! Invariant: only programs of their user and of root can reach them. No request at the port or at the first
//! one takes anything that a Stop of this process's components at the second needs: not a file, not a
//! connection, not a thread. A Stop for other processes goes to them as every order does.

use std::io;
use std::net::SocketAddr;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixListener;
use std::sync::mpsc;
use std::thread;

use tokio::runtime::Runtime;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tonic::service::Routes;
use trocar_rt::house;

use super::caller::own_user;
use super::incoming::Incoming;
use super::transport::{GRACE, transport};
use crate::runtime_dir::{Door, Place, RuntimeDir};

/// The sockets of one port; removed when they are dropped.
pub(super) struct Doors {
    dir: RuntimeDir,
    addr: SocketAddr,
    /// Both end with it.
    open: Option<watch::Sender<()>>,
    calls: Option<JoinHandle<()>>,
}

impl Doors {
    /// Opens them beside the port `addr`. A port works without them: an error at opening is logged.
    pub(super) fn open(dir: &RuntimeDir, addr: SocketAddr, routes: &Routes) -> Doors {
        let (open, closing) = watch::channel(());
        let mut doors = Doors { dir: dir.clone(), addr, open: Some(open), calls: None };
        if let Err(e) = doors.listen(routes, &closing) {
            let dir = dir.path().display();
            log::warn!("programs of this user reach {addr} by TCP, since a socket is missing in {dir}: {e}");
        }
        doors
    }

    fn listen(&mut self, routes: &Routes, closing: &watch::Receiver<()>) -> io::Result<()> {
        let serving = serve(self.place(Door::Stop)?, routes.clone(), closing.clone());
        let (lend, lent) = mpsc::channel::<Runtime>();
        // The thread ends with its socket; a call that hangs does not keep the process.
        let alone = move || lent.recv().map(|runtime| runtime.block_on(serving));
        house::spawn(thread::Builder::new().name("trocar-stop".into()), alone)?;
        // The runtime is made here, so that its descriptors exist when the host counts its own; it is dropped
        // on the thread alone, because a runtime may not be dropped inside another one.
        let _ = lend.send(tokio::runtime::Builder::new_current_thread().enable_all().build()?);
        let calls = self.place(Door::Calls)?;
        self.calls = Some(tokio::spawn(serve(calls, routes.clone(), closing.clone())));
        Ok(())
    }

    fn place(&self, door: Door) -> io::Result<Place> {
        let (dir, addr) = (self.dir.clone(), self.addr);
        let path = dir.door(addr, door);
        let at = path.clone();
        let bind = move || {
            dir.prepare()?;
            let listener = UnixListener::bind(&at)?;
            std::fs::set_permissions(&at, std::fs::Permissions::from_mode(0o600))?;
            dir.lead(addr, door)?;
            Ok(listener)
        };
        Place::new(path, bind)
    }

    /// Takes no more calls; open ones end with the port's.
    pub(super) fn close(&mut self) {
        if self.open.take().is_some() {
            self.dir.close(self.addr, Door::Calls);
            self.dir.close(self.addr, Door::Stop);
        }
    }
}

impl Drop for Doors {
    fn drop(&mut self) {
        self.close();
        if let Some(calls) = &self.calls {
            calls.abort();
        }
    }
}

async fn serve(place: Place, routes: Routes, mut closing: watch::Receiver<()>) {
    let mut over = closing.clone();
    let served = async {
        let incoming = Incoming::unix(place.wait()?, own_user());
        let closed = async move {
            // The channel carries no value: only its sender goes.
            let _ = closing.changed().await;
        };
        let router = transport().add_routes(routes);
        router.serve_with_incoming_shutdown(incoming, closed).await.map_err(io::Error::other)
    };
    // Streams that nobody ends are cut, as the port cuts its own.
    let cut = async move {
        let _ = over.changed().await;
        tokio::time::sleep(GRACE).await;
    };
    tokio::select! {
        done = served => {
            if let Err(e) = done {
                log::error!("a socket of the gRPC port ended: {e}");
            }
        }
        () = cut => {}
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[tokio::test]
    async fn a_port_beside_which_no_socket_has_room_is_opened_all_the_same() {
        let temp = tempfile::tempdir().unwrap();
        // An address of a socket has 108 bytes.
        let dir = RuntimeDir::at(temp.path().join("x".repeat(120)));
        let addr = "127.0.0.1:50551".parse().unwrap();
        let doors = Doors::open(&dir, addr, &Routes::default());
        assert!(doors.calls.is_none());
        assert!(!dir.door(addr, Door::Stop).exists());
    }
}
