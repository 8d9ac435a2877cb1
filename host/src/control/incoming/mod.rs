//! Callers of the port, as they are let in.
//!
//! Invariant: an error of accepting never ends the port and is never answered by trying again at once: the kernel keeps the caller
//! waiting, so the next try would fail the same way, and a thread would do nothing else.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use rustix::io::Errno;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{Sleep, sleep};
use tokio_stream::Stream;
use trocar_links::Seldom;
use trocar_rt::os::now_ns;

/// Pause of letting callers in where the process may open no more files.
const PAUSE: Duration = Duration::from_millis(100);

/// Connections without Nagle's delay. Where there is no file or no memory for one, its caller waits in the kernel's queue and is let in
/// as soon as there is: to hang up on it would tell it nothing either, and cost it the call.
pub(super) struct Incoming {
    listener: TcpListener,
    pause: Option<Pin<Box<Sleep>>>,
    nobody: Seldom,
}

impl Incoming {
    pub(super) fn new(listener: TcpListener) -> Incoming {
        Incoming { listener, pause: None, nobody: Seldom::default() }
    }
}

impl Stream for Incoming {
    type Item = io::Result<TcpStream>;

    fn poll_next(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        loop {
            if let Some(pause) = &mut self.pause {
                ready!(pause.as_mut().poll(cx));
                self.pause = None;
            }
            match ready!(self.listener.poll_accept(cx)) {
                Ok((stream, _)) => {
                    if let Err(e) = stream.set_nodelay(true) {
                        log::debug!("small answers to a caller may come late: {e}");
                    }
                    return Poll::Ready(Some(Ok(stream)));
                }
                Err(e) if is_of_one_caller(&e) => {}
                Err(e) => {
                    self.nobody.warn(now_ns(), &why(&e));
                    self.pause = Some(Box::pin(sleep(PAUSE)));
                }
            }
        }
    }
}

/// It has gone from the queue with its caller: the next one is another's.
fn is_of_one_caller(e: &io::Error) -> bool {
    let of_one = [Errno::CONNABORTED, Errno::CONNRESET, Errno::INTR, Errno::PROTO, Errno::PERM];
    Errno::from_io_error(e).is_some_and(|errno| of_one.contains(&errno))
}

fn why(e: &io::Error) -> String {
    let help = match Errno::from_io_error(e) {
        Some(Errno::MFILE) => {
            "end callers, or let it open more files: `ulimit -n` before its start, `prlimit --pid PID --nofile=4096` \
             while it runs"
        }
        Some(Errno::NFILE) => "the machine has no more files: end programs, or raise `sysctl fs.file-max`",
        Some(Errno::NOMEM | Errno::NOBUFS) => "the machine has no more memory for sockets: end programs",
        _ => "it is tried again",
    };
    format!("new callers of the gRPC port wait, as none can be let in: {e}; {help}")
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn what_befalls_one_caller_is_no_reason_to_wait_and_what_befalls_all_says_what_to_do() {
        for of_one in [Errno::CONNABORTED, Errno::CONNRESET, Errno::INTR, Errno::PROTO, Errno::PERM] {
            assert!(is_of_one_caller(&of_one.into()), "{of_one}");
        }
        for (of_all, help) in [
            (Errno::MFILE, "ulimit -n"),
            (Errno::NFILE, "fs.file-max"),
            (Errno::NOMEM, "memory"),
            (Errno::NOBUFS, "memory"),
            (Errno::INVAL, "tried again"),
        ] {
            assert!(!is_of_one_caller(&of_all.into()), "{of_all}");
            let why = why(&of_all.into());
            assert!(why.contains(help) && why.contains("callers of the gRPC port wait"), "{why}");
        }
    }
}
