//! Callers from beyond the loopback: let in once both sides have shown certificates of one authority.
//!
//! Invariant: nobody is listened to before its certificate was believed, and nobody whose certificate was
//! revoked is for longer than [`LOOK`]. What strangers cost is bounded: places, and time for each.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::task::{Context, Poll};
use std::time::Duration;

use parking_lot::Mutex;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio::task::AbortHandle;
use tokio::time::MissedTickBehavior;
use tokio_rustls::TlsAcceptor;
use trocar_links::Seldom;
use trocar_net::{Holder, Revoked, Role, Server, said};
use trocar_rt::os::{now_ns, unshared};

use super::connection::{Connection, Stream};
use super::seats::{self, Guest, Seats};
use super::{PAUSE, is_of_one_caller, why};
use crate::control::caller::Peer;

/// Time for a caller to show its certificate.
const HANDSHAKE: Duration = Duration::from_secs(2);
/// Callers that may be showing theirs at once, and those of them from one address.
const SHAKING: usize = 64;
const FROM_ONE: usize = 16;
/// Time, and reads, to take what a caller has sent that is turned away.
const HEAR_OUT: Duration = Duration::from_millis(500);
const HEARD: usize = 16;
/// Interval at which the list of revoked certificates is looked at.
const LOOK: Duration = Duration::from_millis(50);

/// The callers of a port that speaks TLS.
pub(in crate::control) struct Secure {
    let_in: mpsc::Receiver<Connection>,
    letting: AbortHandle,
}

/// The state that the tasks of a port share.
struct Door {
    server: Server,
    acceptor: TlsAcceptor,
    /// Places of those who look, of those who operate, and of all others: none takes those of another.
    viewers: Arc<Seats>,
    operators: Arc<Seats>,
    others: Arc<Seats>,
    beliefs: Beliefs,
    shaking: Arc<Semaphore>,
    from: Mutex<BTreeMap<IpAddr, usize>>,
    turned_away: Mutex<Seldom>,
}

/// The connections there are, by a number of their own, with the number of their certificate.
#[derive(Default)]
struct Beliefs {
    next: AtomicU64,
    all: Mutex<BTreeMap<u64, Believed>>,
}

/// The belief in a caller that was let in. It holds what the port looks at, also when the port is closed:
/// then its callers get their last answers.
pub(super) struct Belief {
    over: Option<oneshot::Receiver<()>>,
    _door: Arc<Door>,
}

impl fmt::Debug for Belief {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Belief").field("is_over", &self.over.is_none()).finish_non_exhaustive()
    }
}

impl Belief {
    /// True: its certificate was revoked, now or before.
    pub(super) fn poll_over(&mut self, cx: &mut Context<'_>) -> bool {
        let is_over = self.over.as_mut().is_none_or(|over| Pin::new(over).poll(cx).is_ready());
        if is_over {
            self.over = None;
        }
        is_over
    }
}

/// One that is believed as long as `keep` is not dropped.
struct Believed {
    holder: Arc<Holder>,
    keep: oneshot::Sender<()>,
}

impl Beliefs {
    fn add(&self, holder: &Arc<Holder>) -> oneshot::Receiver<()> {
        let (keep, belief) = oneshot::channel();
        let mut all = self.all.lock();
        all.retain(|_, one| !one.keep.is_closed());
        all.insert(self.next.fetch_add(1, Ordering::Relaxed), Believed { holder: holder.clone(), keep });
        belief
    }

    /// Ends the connections of all whose certificate is revoked now.
    fn revoke(&self, list: &Revoked) {
        self.all.lock().retain(|_, Believed { holder, .. }| {
            let is_revoked = list.has(&holder.serial);
            if is_revoked {
                log::warn!("the connection of the {holder} ends: its certificate was revoked");
            }
            !is_revoked
        });
    }
}

impl Secure {
    pub(in crate::control) fn new(listener: TcpListener, server: Server) -> Secure {
        let (tell, let_in) = mpsc::channel(1);
        let door = Arc::new(Door {
            acceptor: TlsAcceptor::from(server.config()),
            server,
            viewers: Arc::default(),
            operators: Arc::default(),
            others: Arc::default(),
            beliefs: Beliefs::default(),
            shaking: Arc::new(Semaphore::new(SHAKING)),
            from: Mutex::default(),
            turned_away: Mutex::default(),
        });
        tokio::spawn(look(Arc::downgrade(&door)));
        let letting = tokio::spawn(door.listen(listener, tell)).abort_handle();
        Secure { let_in, letting }
    }
}

impl Drop for Secure {
    fn drop(&mut self) {
        self.letting.abort();
    }
}

impl tokio_stream::Stream for Secure {
    type Item = io::Result<Connection>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.let_in.poll_recv(cx).map(|next| next.map(Ok))
    }
}

impl Door {
    async fn listen(self: Arc<Self>, listener: TcpListener, tell: mpsc::Sender<Connection>) {
        // A child that kept it would keep the port.
        let _unshared = unshared(&listener);
        loop {
            // Ends with the port alone, which never closes it.
            let Ok(shaking) = self.shaking.clone().acquire_owned().await else { return };
            let (stream, addr) = match listener.accept().await {
                Ok(caller) => caller,
                Err(e) if is_of_one_caller(&e) => continue,
                Err(e) => {
                    self.turn_away(&why(&e));
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
            };
            let Some(from) = Caller::one(&self, addr.ip()) else {
                let ip = addr.ip();
                self.turn_away(&format!("{ip} opens more connections at once than the {FROM_ONE} it may"));
                continue;
            };
            let (door, tell) = (self.clone(), tell.clone());
            tokio::spawn(async move {
                let shaken = door.shake(stream, addr).await;
                drop((from, shaking));
                match shaken {
                    // Fails when the port has closed.
                    Ok(connection) => _ = tell.send(connection).await,
                    Err(why) => door.turn_away(&format!("{addr} was turned away: {why}")),
                }
            });
        }
    }

    fn turn_away(&self, why: &str) {
        self.turned_away.lock().warn(now_ns(), why);
    }

    /// Has a caller show its certificate, and finds it a place.
    async fn shake(self: &Arc<Self>, stream: TcpStream, addr: SocketAddr) -> Result<Connection, String> {
        use std::os::fd::AsRawFd;

        if seats::is_of_the_last(stream.as_raw_fd()) {
            return Err("this process may open no more files (ulimit -n)".into());
        }
        stream.set_nodelay(true).map_err(|e| e.to_string())?;
        let _unshared = unshared(&stream);
        let shaking = self.acceptor.accept(stream).into_fallible();
        let stream = match tokio::time::timeout(HANDSHAKE, shaking).await {
            Err(_) => return Err(format!("it showed no certificate within {} s", HANDSHAKE.as_secs())),
            Ok(Err((e, stream))) => {
                hear_out(stream).await;
                return Err(because(&e));
            }
            Ok(Ok(stream)) => stream,
        };
        let shown = stream.get_ref().1.peer_certificates().and_then(|all| all.first());
        let holder = Arc::new(Holder::of(shown.ok_or("it shows no certificate")?)?);
        let over = Some(self.beliefs.add(&holder));
        let belief = Belief { over, _door: self.clone() };
        // It may have been revoked between the two.
        if self.server.revoked().is_some_and(|list| list.has(&holder.serial)) {
            return Err("its certificate was revoked".into());
        }
        let guest = || Some(Guest::Holder(holder.name.clone()));
        let (seats, guest) = match holder.role {
            Role::Viewer => (&self.viewers, guest()),
            Role::Operator => (&self.operators, guest()),
            Role::Administrator | Role::Host | Role::Gcm => (&self.others, None),
        };
        let most = if guest.is_some() { seats::OF_ONE } else { seats::OWN };
        let Some(seat) = seats.take(guest) else {
            return Err(format!("the {holder} has {most} connections here, which is the most: end some"));
        };
        let peer = Peer::of_holder(holder, addr);
        Ok(Connection::new(Stream::Tls(Box::new(stream)), peer, seat).believed(belief))
    }
}

/// Looks after the list of revoked certificates, as long as there is anybody to cut off.
async fn look(door: Weak<Door>) {
    let (mut look, mut edition) = (tokio::time::interval(LOOK), 0);
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        look.tick().await;
        let Some(door) = door.upgrade() else { return };
        let Some(list) = door.server.revoked() else { return };
        let now = list.look();
        if now != edition {
            edition = now;
            door.beliefs.revoke(list);
        }
    }
}

/// Reads what a caller has sent already: a connection that is closed before that is reset, and the caller may
/// not hear why.
async fn hear_out(mut stream: TcpStream) {
    let mut room = [0; 4096];
    let heard = async {
        // It may be gone, which is as good.
        let _ = stream.shutdown().await;
        for _ in 0..HEARD {
            if !matches!(stream.read(&mut room).await, Ok(1..)) {
                return;
            }
        }
    };
    // One that goes on talking has had its time.
    let _ = tokio::time::timeout(HEAR_OUT, heard).await;
}

/// A place among the callers of one address.
struct Caller {
    door: Arc<Door>,
    ip: IpAddr,
}

impl Caller {
    fn one(door: &Arc<Door>, ip: IpAddr) -> Option<Caller> {
        let mut from = door.from.lock();
        let here = from.entry(ip).or_insert(0);
        if *here >= FROM_ONE {
            return None;
        }
        *here += 1;
        Some(Caller { door: door.clone(), ip })
    }
}

impl Drop for Caller {
    fn drop(&mut self) {
        let mut from = self.door.from.lock();
        let here = from.entry(self.ip).or_insert(1);
        *here -= 1;
        if *here == 0 {
            from.remove(&self.ip);
        }
    }
}

/// Why a handshake failed.
fn because(e: &io::Error) -> String {
    let of_tls = e.get_ref().and_then(|inner| inner.downcast_ref::<tokio_rustls::rustls::Error>());
    of_tls.map_or_else(|| e.to_string(), said)
}
