//! The file as a writer fills it. Large amounts go to the disk past the page cache: copying them there and
//! cleaning up behind them takes as long as everything else a recording does. A disk that is too slow for
//! this gets them through the page cache, which has room for seconds of data. Large pieces are written from
//! where they lie.
//!
//! Invariant: after a `flush` that was said to be urgent, the file begins with all that was written; nothing
//! follows, or one record that readers leave out.

#[cfg(test)]
mod tests;

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::time::{Duration, Instant};

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;

/// Alignment that disks require past the page cache, of begin, end and place in memory, bytes.
const PAGE: usize = 4 << 10;
/// Written at once when so many bytes wait.
const HOLDS: usize = 512 << 10;
/// Past the page cache, less than this waits for more, unless it is urgent.
const WORTH: usize = 256 << 10;
/// Time for which bytes are counted before the next route is chosen.
const LOOK: Duration = Duration::from_millis(100);
/// From so many bytes per second on, and down to so many, the page cache is passed by.
const MUCH: (f64, f64) = (16e6, 4e6);
/// Rate above which data are a burst, which memory takes at once and few disks do, bytes per second.
const BURST: f64 = 600e6;
/// The share of the time that may be spent waiting for the disk; one that takes more is tried again later.
const WAITS: f64 = 0.3;
/// The first time after so long, later twice as long each time up to this.
const AGAIN: (Duration, Duration) = (Duration::from_secs(10), Duration::from_secs(640));
/// Opcode of the record that fills a page: the format leaves opcodes from here on to applications, and
/// readers leave them out.
const FILLER: u8 = 0x80;
/// Pages that fillers may take behind what is in memory: each at most two, and one that is replaced reaches
/// one further.
const FILLERS: usize = 4;
/// A filler before what is placed is shorter than this, bytes.
pub(crate) const MOST_FILLER: usize = 2 * PAGE;
/// Length of a record's opcode and length field.
const RECORD_HEAD: usize = 9;

/// Route of bytes to the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Route {
    /// Through the page cache.
    Cached,
    /// Past it.
    Direct,
    /// Through the page cache: the file system knows no other way.
    CachedOnly,
}

pub(crate) struct Sink {
    file: File,
    memory: Memory,
    /// Place in the file at which the memory begins: a page.
    at: u64,
    /// In memory.
    filled: usize,
    /// Bytes of it that are in the file already.
    stored: usize,
    /// Place in the file at which the filler ends that follows the stored bytes; not behind their end if
    /// there is no filler.
    padded_to: u64,
    route: Route,
    /// Since when bytes are counted, and how many there were then.
    looked: (Instant, u64),
    /// Time spent waiting for the disk since then.
    waited: Duration,
    /// Before then the page cache is not passed by, and after the next time it was too slow for so long.
    not_before: Instant,
    pause: Duration,
}

/// Bytes that begin at a page.
struct Memory {
    bytes: Vec<u8>,
    begin: usize,
}

impl Memory {
    fn new(len: usize) -> Memory {
        let bytes = vec![0; len + PAGE];
        let begin = bytes.as_ptr().align_offset(PAGE);
        // If the alignment is unknown, disks refuse the write, and the page cache takes it.
        Memory { bytes, begin: if begin < PAGE { begin } else { 0 } }
    }

    fn at(&mut self) -> &mut [u8] {
        &mut self.bytes[self.begin..]
    }
}

impl Sink {
    pub(crate) fn new(file: File) -> Sink {
        Sink {
            file,
            memory: Memory::new(HOLDS + FILLERS * PAGE),
            at: 0,
            filled: 0,
            stored: 0,
            padded_to: 0,
            route: Route::Cached,
            looked: (Instant::now(), 0),
            waited: Duration::ZERO,
            not_before: Instant::now(),
            pause: AGAIN.0,
        }
    }

    /// Writes past the page cache from now on; false if the file system does not support that.
    #[cfg(test)]
    pub(crate) fn go_direct(&mut self) -> bool {
        self.looked.0 = Instant::now() + Duration::from_secs(3600);
        self.take(Route::Direct);
        self.route == Route::Direct
    }

    /// All that was written, bytes.
    pub(crate) fn len(&self) -> u64 {
        self.at + self.filled as u64
    }

    /// Returns how much of what was written is in the file, bytes.
    pub(crate) fn stored(&self) -> u64 {
        self.at + self.stored as u64
    }

    /// Chooses the route of the next bytes, from how many there were and how long the disk took.
    fn choose(&mut self) {
        self.choose_at(Instant::now());
    }

    fn choose_at(&mut self, now: Instant) {
        let len = self.len();
        let (since, before) = self.looked;
        let elapsed = now.saturating_duration_since(since);
        if elapsed < LOOK {
            return;
        }
        self.looked = (now, len);
        let waited = std::mem::take(&mut self.waited).as_secs_f64() / elapsed.as_secs_f64();
        let rate = (len - before) as f64 / elapsed.as_secs_f64();
        match self.route {
            Route::Cached if (MUCH.0..BURST).contains(&rate) && self.looked.0 >= self.not_before => {
                self.take(Route::Direct);
            }
            Route::Direct if waited > WAITS => {
                self.not_before = self.looked.0 + self.pause;
                self.pause = AGAIN.1.min(2 * self.pause);
                self.take(Route::Cached);
            }
            Route::Direct if rate < MUCH.1 => self.take(Route::Cached),
            _ => {}
        }
    }

    fn take(&mut self, route: Route) {
        let set = |direct: bool| {
            let flags = fcntl_getfl(&self.file)? - OFlags::DIRECT;
            fcntl_setfl(&self.file, if direct { flags | OFlags::DIRECT } else { flags })
        };
        self.route = match set(route == Route::Direct) {
            Ok(()) => route,
            Err(_) => Route::CachedOnly,
        };
    }

    /// Writes the memory from the first byte not stored up to `end`.
    fn store(&mut self, end: usize) -> io::Result<()> {
        if self.route == Route::Direct {
            let from = self.stored - self.stored % PAGE;
            let (file, at) = (&self.file, self.at + from as u64);
            let begun = Instant::now();
            let done = file.write_all_at(&self.memory.at()[from..end], at);
            if self.took(begun, &done) {
                return done;
            }
        }
        let from = self.stored;
        self.file.write_all_at(&self.memory.at()[from..end], self.at + from as u64)
    }

    /// Writes whole pages from elsewhere, at the page behind the stored bytes.
    fn store_pages(&mut self, pages: &[u8]) -> io::Result<()> {
        if self.route == Route::Direct {
            let begun = Instant::now();
            let done = self.file.write_all_at(pages, self.at);
            if self.took(begun, &done) {
                return done;
            }
        }
        self.file.write_all_at(pages, self.at)
    }

    /// Counts the time the disk took; false if the write has to be done again, through the page cache.
    fn took(&mut self, begun: Instant, done: &io::Result<()>) -> bool {
        self.waited += begun.elapsed();
        let refused = |why: &io::Error| Errno::from_io_error(why) == Some(Errno::INVAL);
        let again = done.as_ref().is_err_and(refused);
        if again {
            self.take(Route::CachedOnly);
        }
        !again
    }

    /// Lets go of whole pages that are in the file.
    fn advance(&mut self) {
        let whole = self.stored - self.stored % PAGE;
        self.memory.at().copy_within(whole..self.filled, 0);
        self.at += whole as u64;
        self.filled -= whole;
        self.stored -= whole;
    }

    /// Makes room: whole pages go to the file.
    fn spill(&mut self) -> io::Result<()> {
        let whole = self.filled - self.filled % PAGE;
        self.store(whole)?;
        // A filler is shorter than what memory holds: they have replaced it.
        self.stored = whole;
        self.advance();
        Ok(())
    }

    /// Adds a record behind what is in memory, up to the end of a page and of the filler that is there;
    /// returns its end. Past the page cache a whole page is written; else only what replaces a filler.
    fn pad(&mut self, page: usize) -> usize {
        let filled = self.filled;
        let old = usize::try_from(self.padded_to.saturating_sub(self.at)).unwrap_or(0);
        let end = old.max(filled).next_multiple_of(page);
        if end == filled {
            return filled;
        }
        let end =
            if end - filled < RECORD_HEAD { (filled + RECORD_HEAD).next_multiple_of(page) } else { end };
        let filler = &mut self.memory.at()[filled..end];
        filler.fill(0);
        filler[..RECORD_HEAD].copy_from_slice(&filler_head(end - filled));
        end
    }

    /// Appends bytes.
    pub(crate) fn put(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        loop {
            let (now, later) = bytes.split_at(bytes.len().min(HOLDS - self.filled));
            let filled = self.filled;
            self.memory.at()[filled..filled + now.len()].copy_from_slice(now);
            self.filled += now.len();
            if later.is_empty() {
                return Ok(());
            }
            bytes = later;
            self.spill()?;
        }
    }

    /// Writes `head`, and `body` behind it, of which only the ends are copied; returns where `head` begins.
    /// Past the page cache a filler may come before: pages of memory go to pages of the file. For a body of
    /// several pages, at the begin of a record.
    pub(crate) fn place(&mut self, head: &[u8], body: &[u8]) -> io::Result<u64> {
        self.choose();
        if self.route == Route::Direct {
            let there = (self.filled + head.len()) % PAGE;
            let wanted = body.as_ptr().addr() % PAGE;
            let mut filler = (wanted + PAGE - there) % PAGE;
            if (1..RECORD_HEAD).contains(&filler) {
                filler += PAGE;
            }
            if filler > 0 {
                self.put(&filler_head(filler))?;
                self.put(&[0; MOST_FILLER][..filler - RECORD_HEAD])?;
            }
        }
        let begins = self.len();
        self.put(head)?;
        let (first, rest) = body.split_at(body.len().min((PAGE - self.filled % PAGE) % PAGE));
        self.put(first)?;
        let (pages, last) = rest.split_at(rest.len() - rest.len() % PAGE);
        // Memory ends at a page.
        self.store(self.filled)?;
        self.stored = self.filled;
        self.advance();
        self.store_pages(pages)?;
        self.at += pages.len() as u64;
        self.put(last)?;
        Ok(begins)
    }

    /// Called at the end of a record: sends what waits to the file, past the page cache only when it is much
    /// or `urgent`. Returns whether all of it is in the file.
    pub(crate) fn flush(&mut self, urgent: bool) -> io::Result<bool> {
        self.choose();
        let waits = self.filled - self.stored;
        if waits == 0 || (self.route == Route::Direct && !urgent && waits < WORTH) {
            return Ok(waits == 0);
        }
        // The file is never made shorter meanwhile: that would give back the room that was promised behind
        // its end.
        let end = self.pad(if self.route == Route::Direct { PAGE } else { 1 });
        self.store(end)?;
        self.padded_to = self.at + end as u64;
        self.stored = self.filled;
        self.advance();
        Ok(true)
    }

    /// Closes the file with all that was written in it. The file may be longer: the caller cuts it to the
    /// returned length, even after an error.
    pub(crate) fn close(mut self) -> (u64, io::Result<()>) {
        if self.route == Route::Direct {
            self.take(Route::Cached);
        }
        let done = self.store(self.filled);
        if done.is_ok() {
            self.stored = self.filled;
        }
        (self.stored(), done)
    }
}

/// Returns the head of a filler of this length.
fn filler_head(len: usize) -> [u8; RECORD_HEAD] {
    let mut head = [FILLER; RECORD_HEAD];
    head[1..].copy_from_slice(&((len - RECORD_HEAD) as u64).to_le_bytes());
    head
}
