//! The device's own thread: opens the stream, reads lines, and opens it again when it is lost.
//!
//! It may wait, which `step` may not; values go to the component through a queue that neither side waits at.

use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryIter, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use trocar_sdk::data::Scalar;
use trocar_sdk::prelude::*;

/// Longest wait before the thread looks whether it is to end; Stop waits no longer.
const PATIENCE: Duration = Duration::from_millis(20);
/// Between two tries to open the device.
const RETRY: Duration = Duration::from_millis(200);
/// Values that wait for the component; with a full queue new ones are left out.
const QUEUE: usize = 256;
/// A line without an end is cut here, bytes.
const LONGEST_LINE: u64 = 256;

/// A running thread; dropping it ends the thread.
pub(crate) struct Reader {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    values: Receiver<Scalar>,
}

impl Reader {
    pub(crate) fn start(address: &str, host: &Host) -> Reader {
        let (to, values) = sync_channel(QUEUE);
        let ends = Arc::new(AtomicBool::new(false));
        let line = Line {
            address: address.to_owned(),
            host: host.clone(),
            ends: ends.clone(),
            to,
        };
        let thread = Some(thread::spawn(move || line.keep_open()));
        Reader {
            ends,
            thread,
            values,
        }
    }

    /// Values that came since the last call; never waits.
    pub(crate) fn values(&self) -> TryIter<'_, Scalar> {
        self.values.try_iter()
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _panicked = thread.join();
        }
    }
}

/// The thread's end: where the device is, and where its values go.
struct Line {
    address: String,
    host: Host,
    ends: Arc<AtomicBool>,
    to: SyncSender<Scalar>,
}

impl Line {
    fn ends(&self) -> bool {
        self.ends.load(Ordering::Acquire)
    }

    /// Reads until the end; a device that is lost is opened again.
    fn keep_open(&self) {
        let mut told = false;
        while !self.ends() {
            let lost = self.open().and_then(|stream| {
                told = false;
                self.read(stream)
            });
            if let (Err(why), false) = (lost, told) {
                log::warn!("{}: {why}; trying again", self.address);
                told = true; // Once for each time it is lost.
            }
            if !self.ends() {
                thread::park_timeout(RETRY);
            }
        }
    }

    /// CHANGE THIS: opens the device, as anything that is `Read` and gives up after `PATIENCE`, such as a
    /// serial port.
    fn open(&self) -> io::Result<Box<dyn Read>> {
        if self.address.is_empty() {
            return Ok(Box::new(Simulated::default()));
        }
        let found = self.address.to_socket_addrs()?.next();
        let address = found.ok_or_else(|| io::Error::other("nobody has this address"))?;
        let stream = TcpStream::connect_timeout(&address, PATIENCE)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        Ok(Box::new(stream))
    }

    /// Reads lines until the end.
    ///
    /// # Errors
    /// The device is lost.
    fn read(&self, stream: Box<dyn Read>) -> io::Result<()> {
        let (mut stream, mut line) = (BufReader::new(stream), Vec::new());
        while !self.ends() {
            let room = LONGEST_LINE.saturating_sub(line.len() as u64);
            match stream.by_ref().take(room).read_until(b'\n', &mut line) {
                Ok(0) if room > 0 => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(_) => {
                    if let Some(value) = value_of(&line) {
                        let stamp = self.host.now();
                        let _full = self.to.try_send(Scalar { stamp, value });
                    }
                    line.clear();
                }
                // Nothing came: half a line stays for what comes next.
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }
}

/// CHANGE THIS: the value of a line; none for a line that says none.
pub(crate) fn value_of(line: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(line).ok()?;
    text.trim()
        .parse()
        .ok()
        .filter(|value: &f64| value.is_finite())
}

/// Stands for the device: a line every 10 ms.
#[derive(Default)]
struct Simulated {
    lines: u64,
}

impl Read for Simulated {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        thread::park_timeout(Duration::from_millis(10));
        self.lines += 1;
        let line = format!("{:.4}\n", (self.lines as f64 / 100.0).sin());
        line.as_bytes().read(to)
    }
}
