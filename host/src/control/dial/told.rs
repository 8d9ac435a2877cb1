//! An encrypted connection whose errors say what is to be done: under TLS 1.3 a caller hears that it is not
//! believed only when it reads.

use std::io;
use std::pin::Pin;
use std::sync::{Arc, OnceLock};
use std::task::{Context, Poll};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::Error;
use trocar_net::said;

/// Why a connection ended, where TLS says it.
pub(super) type Why = Arc<OnceLock<String>>;

pub(super) struct Told {
    stream: TlsStream<TcpStream>,
    why: Why,
}

impl Told {
    pub(super) fn new(stream: TlsStream<TcpStream>, why: Why) -> Told {
        Told { stream, why }
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
