//! Reply cells: a blocking caller waits there, always with a deadline, and its server answers without
//! waiting.
//!
//! One word per cell holds generation, phase and whether the caller sleeps; every step is a compare-and-swap
//! on it, so a cell is answered once, freed once, and a token of an earlier use fits nothing any more.

use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use crate::buf::round_up;
use crate::os::{WaitResult, now_ns};
use crate::region::{AnyBits, Bytes, Layout, Plain, Table};
use crate::sync::{AtomicU32, AtomicU64, Futex, Ordering, Scope, Shared, pause_while};
use crate::wake::Waker;

/// Result of a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// The server answered with this status.
    Done(i32),
    /// The deadline passed before the server began; it will not run.
    DeadlineNotStarted,
    /// The deadline passed while the server was running it; it may still run to its end.
    DeadlineMayRun,
}

/// Time a caller looks for its answer before it sleeps, ns: about as long as a server takes to wake up, and
/// the caller after it.
const PATIENCE_NS: u64 = 5_000;
/// Most attempts at a word against the other end, and against a machine whose exchanges fail for no reason.
const ATTEMPTS: usize = if cfg!(loom) { 8 } else { 1000 };
/// Calls that sleep at once after one whose answer did not come within [`PATIENCE_NS`].
const IMPATIENT: u32 = 31;

const PHASE: u32 = 0b0111;
const FREE: u32 = 0;
/// The caller holds the ticket, the server has not begun.
const WAITING: u32 = 1;
/// The server runs the call.
const RUNNING: u32 = 2;
/// Answered; the caller owns the content.
const DONE: u32 = 3;
/// The server runs the call and the caller has left: the server's end frees the cell.
const ABANDONED: u32 = 4;
/// No answer comes any more, whatever is still written into the cell: it is not used again.
const LOST: u32 = 5;
/// The caller sleeps on the word, or is about to.
const ASLEEP: u32 = 0b1000;
const GENERATION: u32 = 4;

const fn with_phase(word: u32, phase: u32) -> u32 {
    (word >> GENERATION << GENERATION) | phase
}

#[derive(Clone, Copy, Default)]
#[repr(C)]
struct Answer {
    status: i32,
    text_len: u32,
}

// SAFETY: numbers.
unsafe impl AnyBits for Answer {}

#[repr(C)]
struct Cell {
    state: Futex,
    answer: Shared<Answer>,
}

// SAFETY: an atomic number and a cell of plain bits.
unsafe impl Plain for Cell {}

/// A fixed number of reply cells, shared by the callers of one connection and their server.
pub struct ReplyPool {
    cells: Table<Cell>,
    content: Bytes,
    scope: Scope,
    ret_bytes: usize,
    text_bytes: usize,
    next: AtomicU32,
    /// Number of calls that are still to sleep at once.
    impatient: AtomicU32,
    /// Status of the calls that were [`LOST`] here, with [`ENDED`]; 0: none was.
    ended: AtomicU64,
    /// Rung at each answer, by the process that answers: for a caller that plays another machine's.
    bell: OnceLock<Arc<Waker>>,
}

/// Flag beside a status: there is one.
const ENDED: u64 = 1 << 32;

// SAFETY: a cell's content is reached by the server in RUNNING and ABANDONED and by the caller in DONE only.
unsafe impl Send for ReplyPool {}
// SAFETY: as above.
unsafe impl Sync for ReplyPool {}

impl ReplyPool {
    /// `cells` calls can be waiting at once; each answer has `ret_bytes` of result, 64-byte aligned, and up
    /// to `text_bytes` of text.
    pub fn new(cells: usize, ret_bytes: usize, text_bytes: usize) -> Arc<Self> {
        Layout::on_heap(|layout| Self::lay_out(layout, cells, ret_bytes, text_bytes))
    }

    /// As [`ReplyPool::new`], in memory that the other end may have in another process, with the same
    /// numbers.
    pub fn lay_out(layout: &mut Layout, cells: usize, ret_bytes: usize, text_bytes: usize) -> Arc<Self> {
        let stride = round_up(ret_bytes, 64) + round_up(text_bytes, 64);
        Arc::new(Self {
            cells: layout
                .table(cells, |_| Cell { state: Futex::new(FREE), answer: Shared::new(Answer::default()) }),
            content: layout.bytes(stride * cells),
            scope: layout.scope(),
            ret_bytes,
            text_bytes,
            next: AtomicU32::new(0),
            impatient: AtomicU32::new(0),
            ended: AtomicU64::new(0),
            bell: OnceLock::new(),
        })
    }

    /// Rings this bell at each answer given through this handle on the pool, from now on.
    pub fn ringing(&self, bell: Arc<Waker>) {
        // The first bell stays.
        let _ = self.bell.set(bell);
    }

    /// A cell for one call, or `None` when all are in use. Any thread; at most one look at each cell.
    pub fn acquire(self: &Arc<Self>) -> Option<Ticket> {
        let count = self.cells.len();
        let start = self.next.fetch_add(1, Ordering::Relaxed) as usize;
        (0..count).map(|i| start.wrapping_add(i) % count).find_map(|index| {
            let word = &self.cells[index].state.word;
            let free = word.load(Ordering::Relaxed);
            let taken = with_phase(free.wrapping_add(1 << GENERATION), WAITING);
            let is_free = free & PHASE == FREE;
            let mine =
                is_free && word.compare_exchange(free, taken, Ordering::Acquire, Ordering::Relaxed).is_ok();
            mine.then(|| Ticket { pool: Arc::clone(self), index, word: taken })
        })
    }

    /// Answers every call that is under way with `status`: its server is gone, or is not listened to any
    /// more. The callers' process only; any thread; never waits.
    pub fn end_all(&self, status: i32) {
        self.ended.store(ENDED | u64::from(status.cast_unsigned()), Ordering::Release);
        for cell in self.cells.iter() {
            let word = &cell.state.word;
            let mut now = word.load(Ordering::Relaxed);
            // The server may begin and the caller fall asleep in between; more attempts mean another process
            // that plays with the word.
            for _ in 0..ATTEMPTS {
                if !matches!(now & PHASE, WAITING | RUNNING) {
                    break;
                }
                match word.compare_exchange_weak(
                    now,
                    with_phase(now, LOST),
                    Ordering::Release,
                    Ordering::Relaxed,
                ) {
                    Ok(_) if now & ASLEEP != 0 => {
                        cell.state.wake(1, self.scope);
                        break;
                    }
                    Ok(_) => break,
                    Err(other) => now = other,
                }
            }
        }
    }

    /// Returns the number of cells in use now.
    pub fn in_use(&self) -> usize {
        self.cells.iter().filter(|c| c.state.word.load(Ordering::Relaxed) & PHASE != FREE).count()
    }

    /// Begins the call of this token, for the server. `None`: the caller has given up, or the token is 0 or
    /// of an earlier use; then the entry is not to be executed for its sake. Should the answer never come
    /// (the [`Running`] is dropped, by a panic or a removal), the caller gets `status_if_dropped`.
    pub fn begin(&self, token: u64, status_if_dropped: i32) -> Option<Running<&ReplyPool>> {
        begin(self, token, status_if_dropped)
    }

    /// As [`ReplyPool::begin`], for an answer that is given later and from another place.
    pub fn begin_kept(
        self: &Arc<Self>,
        token: u64,
        status_if_dropped: i32,
    ) -> Option<Running<Arc<ReplyPool>>> {
        begin(Arc::clone(self), token, status_if_dropped)
    }

    /// Answers the call of this token unexecuted; returns whether a caller was still waiting for it.
    pub fn fail(&self, token: u64, status: i32) -> bool {
        self.begin(token, status).is_some()
    }

    fn stride(&self) -> usize {
        round_up(self.ret_bytes, 64) + round_up(self.text_bytes, 64)
    }

    fn content(&self, index: usize) -> (*mut u8, *mut u8) {
        let start = index * self.stride();
        (self.content.at(start), self.content.at(start + round_up(self.ret_bytes, 64)))
    }
}

fn begin<P: Deref<Target = ReplyPool>>(pool: P, token: u64, status: i32) -> Option<Running<P>> {
    let index = (token as u32).checked_sub(1)? as usize;
    let waiting = (token >> 32) as u32;
    if waiting & (PHASE | ASLEEP) != WAITING {
        return None;
    }
    let (running, generation) = (with_phase(waiting, RUNNING), waiting >> GENERATION);
    let word = &pool.cells.get(index)?.state.word;
    let began = [0, ASLEEP].into_iter().any(|asleep| {
        let (from, to) = (waiting | asleep, running | asleep);
        word.compare_exchange(from, to, Ordering::Acquire, Ordering::Relaxed).is_ok()
    });
    began.then(|| Running { pool, index, generation, status, text_len: 0 })
}

/// The caller's right to one cell. Dropping it gives the call up.
#[must_use = "a ticket that is not waited for is given up"]
pub struct Ticket {
    pool: Arc<ReplyPool>,
    index: usize,
    /// The cell's word as it was taken: generation and WAITING.
    word: u32,
}

impl Ticket {
    /// Returns the token the server needs to answer; never 0.
    pub fn token(&self) -> u64 {
        u64::from(self.word) << 32 | (self.index as u64 + 1)
    }

    /// The answer, if it is there: as [`Ticket::wait`], without waiting.
    ///
    /// # Errors
    /// It is not there yet: the ticket.
    pub fn take(self, take: impl FnOnce(&[u8], &[u8])) -> Result<Reply, Ticket> {
        match self.pool.cells[self.index].state.word.load(Ordering::Acquire) & PHASE {
            DONE => Ok(self.done(take)),
            LOST => Ok(self.lost()),
            _ => Err(self),
        }
    }

    /// Gives the call up, if the server has not begun it: then it never will.
    ///
    /// # Errors
    /// It was begun, or answered: the ticket.
    pub fn recall(self) -> Result<(), Ticket> {
        let word = &self.pool.cells[self.index].state.word;
        let free = with_phase(self.word, FREE);
        match word.compare_exchange(self.word, free, Ordering::AcqRel, Ordering::Acquire) {
            Ok(_) => Ok(()),
            Err(_) => Err(self),
        }
    }

    /// Waits a little for an answer that comes at once, as it does while its server has a processor of its
    /// own.
    fn pause(&self, deadline_ns: u64) {
        let impatient = &self.pool.impatient;
        let left = impatient.load(Ordering::Relaxed);
        if left > 0 {
            impatient.store(left - 1, Ordering::Relaxed);
            return;
        }
        let word = &self.pool.cells[self.index].state.word;
        let is_open = || !matches!(word.load(Ordering::Relaxed) & PHASE, DONE | LOST);
        pause_while(PATIENCE_NS.min(deadline_ns.saturating_sub(crate::os::now_ns())), is_open);
        if is_open() {
            impatient.store(IMPATIENT, Ordering::Relaxed);
        }
    }

    /// Sleeps until the answer or the absolute monotonic deadline in ns. With an answer, `take` gets the
    /// result bytes and the text, also when the status says failure.
    pub fn wait(self, deadline_ns: u64, take: impl FnOnce(&[u8], &[u8])) -> Reply {
        self.pause(deadline_ns);
        let cell = &self.pool.cells[self.index];
        loop {
            let word = cell.state.word.load(Ordering::Acquire);
            match word & PHASE {
                DONE => break,
                LOST => return self.lost(),
                _ => {}
            }
            let asleep = word | ASLEEP;
            let slept = &cell.state.word;
            let lies = word == asleep
                || slept.compare_exchange(word, asleep, Ordering::Relaxed, Ordering::Relaxed).is_ok();
            let woke = if lies {
                cell.state.wait(asleep, Some(deadline_ns), self.pool.scope)
            } else {
                WaitResult::Changed
            };
            // A word that another process plays with must not keep the caller either.
            if woke == WaitResult::TimedOut || woke == WaitResult::Changed && now_ns() >= deadline_ns {
                match self.give_up() {
                    WAITING => return Reply::DeadlineNotStarted,
                    DONE => break,
                    LOST => return self.lost(),
                    _ => return Reply::DeadlineMayRun,
                }
            }
        }
        self.done(take)
    }

    /// Hands out an answer that was seen, with Acquire, to be there.
    fn done(&self, take: impl FnOnce(&[u8], &[u8])) -> Reply {
        let cell = &self.pool.cells[self.index];
        // SAFETY: DONE, seen with Acquire: the server has left the cell and this ticket owns the content.
        let Answer { status, text_len } = unsafe { cell.answer.fetch() };
        let text_len = (text_len as usize).min(self.pool.text_bytes);
        let (ret, text) = self.pool.content(self.index);
        // SAFETY: as above; both addresses lie in the cell's content.
        let (ret, text) = unsafe {
            (std::slice::from_raw_parts(ret, self.pool.ret_bytes), std::slice::from_raw_parts(text, text_len))
        };
        take(ret, text);
        Reply::Done(status)
    }

    /// Returns the answer to a call that [`ReplyPool::end_all`] ended.
    fn lost(&self) -> Reply {
        match self.pool.ended.load(Ordering::Acquire) {
            // Only another process can have marked it.
            0 => Reply::DeadlineMayRun,
            ended => Reply::Done((ended as u32).cast_signed()),
        }
    }

    /// Leaves the cell, or finds that it is DONE or LOST and stays; returns the phase it was in. Called
    /// again, it finds a cell of another generation and does nothing.
    fn give_up(&self) -> u32 {
        let word = &self.pool.cells[self.index].state.word;
        let mut now = word.load(Ordering::Acquire);
        // Begin, finish and the sleeper's mark can each come between once; more attempts mean another process
        // that plays with the word.
        for _ in 0..ATTEMPTS {
            if now >> GENERATION != self.word >> GENERATION {
                break;
            }
            let phase = now & PHASE;
            let left = match phase {
                WAITING => FREE,
                RUNNING => ABANDONED,
                _ => return phase,
            };
            let to = with_phase(now, left);
            match word.compare_exchange_weak(now, to, Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) => return phase,
                Err(other) => now = other,
            }
        }
        FREE
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        if self.give_up() == DONE {
            let word = &self.pool.cells[self.index].state.word;
            // Release: the next use of the cell writes after this one has read.
            word.store(with_phase(self.word, FREE), Ordering::Release);
        }
    }
}

/// The server's right, and duty, to answer one call.
#[must_use = "dropping it answers the caller with the status for lost servers"]
pub struct Running<P: Deref<Target = ReplyPool>> {
    pool: P,
    index: usize,
    generation: u32,
    status: i32,
    /// Bytes of text with the answer.
    text_len: u32,
}

impl<P: Deref<Target = ReplyPool>> Running<P> {
    /// Answers: `fill` writes the result and the text into the cell and says how long the text is. Never
    /// waits; one system call when the caller sleeps.
    pub fn finish(mut self, status: i32, fill: impl FnOnce(&mut [u8], &mut [u8]) -> usize) {
        let (ret, text) = self.pool.content(self.index);
        // SAFETY: this `Running` is the only user of the content until its drop; the blocks are this long.
        let (ret, text) = unsafe {
            (
                std::slice::from_raw_parts_mut(ret, self.pool.ret_bytes),
                std::slice::from_raw_parts_mut(text, self.pool.text_bytes),
            )
        };
        let text_len = fill(ret, text).min(self.pool.text_bytes);
        self.status = status;
        self.text_len = text_len as u32;
    }

    fn answer(&self) {
        let cell = &self.pool.cells[self.index];
        // SAFETY: RUNNING or ABANDONED: the caller keeps away from the answer until DONE.
        unsafe { *cell.answer.exclusive() = Answer { status: self.status, text_len: self.text_len } };
        let word = &cell.state.word;
        let mut now = word.load(Ordering::Acquire);
        // Falling asleep and giving up can each come between once; more attempts mean another process that
        // plays with the word.
        for _ in 0..ATTEMPTS {
            let end = match now & PHASE {
                RUNNING if now >> GENERATION == self.generation => DONE,
                ABANDONED if now >> GENERATION == self.generation => FREE,
                // LOST.
                _ => return,
            };
            match word.compare_exchange_weak(now, with_phase(now, end), Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) => break,
                Err(other) => now = other,
            }
        }
        if now & ASLEEP != 0 && now & PHASE == RUNNING {
            cell.state.wake(1, self.pool.scope);
        }
        if let Some(bell) = self.pool.bell.get() {
            bell.notify();
        }
    }
}

impl<P: Deref<Target = ReplyPool>> Drop for Running<P> {
    fn drop(&mut self) {
        self.answer();
    }
}
