//! An encrypted connection whose errors say what is to be done: under TLS 1.3 a caller hears that it is not
//! believed only when it reads.

use std::io;
use std::pin::Pin;
use std::sync::{Arc, OnceLock};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Interval, MissedTickBehavior};
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::Error;
use trocar_net::{Holder, Revoked, said};

/// Interval at which the list of revoked certificates is looked at.
const LOOK: Duration = Duration::from_millis(50);

/// Why a connection ended, where TLS says it.
pub(super) type Why = Arc<OnceLock<String>>;

pub(super) struct Told {
    stream: TlsStream<TcpStream>,
    why: Why,
    believed: Option<Believed>,
}

/// A port that is believed as long as its certificate is on no list.
struct Believed {
    revoked: Arc<Revoked>,
    serial: Vec<u8>,
    look: Interval,
}

impl Told {
    /// A port whose certificate is on the list `revoked` is believed no more.
    pub(super) fn new(stream: TlsStream<TcpStream>, why: Why, revoked: Option<Arc<Revoked>>) -> Told {
        let shown = stream.get_ref().1.peer_certificates().and_then(|all| Holder::of(all.first()?).ok());
        let believed = revoked.zip(shown).map(|(revoked, holder)| {
            let mut look = tokio::time::interval(LOOK);
            look.set_missed_tick_behavior(MissedTickBehavior::Delay);
            Believed { revoked, serial: holder.serial, look }
        });
        Told { stream, why, believed }
    }

    /// # Errors
    /// The certificate of the port was revoked since it was shown.
    fn is_believed(&mut self, cx: &mut Context<'_>) -> io::Result<()> {
        let Some(Believed { revoked, serial, look }) = &mut self.believed else { return Ok(()) };
        while look.poll_tick(cx).is_ready() {
            if revoked.has(serial) {
                let why = self.why.get_or_init(|| "its certificate was revoked".into());
                return Err(io::Error::new(io::ErrorKind::ConnectionAborted, why.clone()));
            }
        }
        Ok(())
    }

    /// Keeps the first error that TLS tells: HTTP would only say that it was cut.
    fn keep(&self, e: io::Error) -> io::Error {
        let of_tls = e.get_ref().is_some_and(|inner| inner.is::<Error>());
        let e = told(e);
        if of_tls {
            self.why.get_or_init(|| e.to_string());
        }
        e
    }
}

/// Returns the error in words for the one who called.
pub(super) fn told(e: io::Error) -> io::Error {
    match e.get_ref().and_then(|inner| inner.downcast_ref::<Error>()) {
        Some(of_tls) => io::Error::new(e.kind(), said(of_tls)),
        None => e,
    }
}

impl AsyncRead for Told {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        this.is_believed(cx)?;
        Pin::new(&mut this.stream).poll_read(cx, buf).map_err(|e| this.keep(e))
    }
}

impl AsyncWrite for Told {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        Pin::new(&mut this.stream).poll_write(cx, buf).map_err(|e| this.keep(e))
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        Pin::new(&mut this.stream).poll_flush(cx).map_err(|e| this.keep(e))
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        Pin::new(&mut this.stream).poll_shutdown(cx).map_err(|e| this.keep(e))
    }
}
