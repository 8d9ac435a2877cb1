//! Class reads from outside: plugin code on separate threads, so that a read that does not return blocks no
//! other thread.
//!
//! Invariant: the reads of one component have at most [`PLACES`] threads, whatever is asked, and each caller
//! is answered by its deadline. The threads belong to no runtime: none of them is waited for when a runtime
//! or a process ends.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use tokio::sync::{Semaphore, oneshot};
use tokio::time::timeout_at;
use trocar_model::{MemberId, Refusal};
use trocar_rt::house;

use super::boundary::{Answer, ReadTarget};
use super::calling::GRACE;
use super::instance::Misuse;
use super::realtime::STACK_BYTES;

/// Most threads the reads of one component have at once: one may be slow, and the others are still answered.
const PLACES: usize = 2;
/// Idle threads that are kept for the next reads of any component.
const IDLE: usize = 2;

/// The reads of one component that are under way.
pub(super) struct Reading {
    places: Arc<Semaphore>,
    tickets: AtomicU64,
    /// Reads that were given up and have not returned.
    late: Mutex<Vec<Late>>,
}

struct Late {
    ticket: u64,
    /// `interface/read`.
    name: String,
    since: Instant,
}

impl Default for Reading {
    fn default() -> Self {
        let places = Arc::new(Semaphore::new(PLACES));
        Reading { places, tickets: AtomicU64::new(1), late: Mutex::default() }
    }
}

impl Reading {
    fn late(&self) -> MutexGuard<'_, Vec<Late>> {
        self.late.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Refuses a read if an earlier one of it has not returned, and any read if such reads take all threads.
    fn refuse(&self, member: &MemberId, name: &str) -> Result<(), Refusal> {
        let late = self.late();
        let full = late.len() >= PLACES;
        let Some(first) = late.iter().find(|l| full || l.name == name) else { return Ok(()) };
        let (since, of) = (first.since.elapsed().as_secs_f64(), &member.port.component);
        let text = format!(
            "it was not begun, since the read {} of {of} has not come back for {since:.1} s",
            first.name
        );
        Err(Refusal::CommandFailed { member: member.clone(), text })
    }

    /// Notes a read as late, unless its answer has come in this very moment.
    fn give_up(&self, late: Late, answer: &mut oneshot::Receiver<Answer>) -> Option<Answer> {
        let mut all = self.late();
        // The thread that answers removes its read from this list afterwards.
        let answer = answer.try_recv().ok();
        if answer.is_none() {
            all.push(late);
        }
        answer
    }

    fn came_back(&self, ticket: u64) {
        self.late().retain(|l| l.ticket != ticket);
    }
}

/// One read request.
pub(super) struct Asked {
    pub(super) member: MemberId,
    /// Exact bytes of its argument's type.
    pub(super) arg: Vec<u8>,
    pub(super) ret_bytes: usize,
    pub(super) deadline_ns: u64,
}

/// Answers a class's read. A caller that leaves early does not end it: it is noted as late all the same.
///
/// # Errors
/// DEADLINE when it has not returned; COMMAND_FAILED at once where an earlier one has not; NoThread.
pub(super) async fn answer(read: ReadTarget, asked: Asked) -> Result<Answer, Refusal> {
    let member = asked.member.clone();
    let bounded = tokio::spawn(bounded(read, asked));
    bounded.await.unwrap_or_else(|e| Err(panicked(&member, &e.to_string())))
}

fn panicked(member: &MemberId, why: &str) -> Refusal {
    Refusal::Internal { text: format!("reading {member} panicked: {why}") }
}

async fn bounded(read: ReadTarget, asked: Asked) -> Result<Answer, Refusal> {
    let Asked { member, arg, ret_bytes, deadline_ns } = asked;
    let server = read.server.clone();
    let (reading, name) = (&server.reading, format!("{}/{}", member.port.port, member.member));
    let deadline =
        |may_still_run| Refusal::Deadline { member: member.clone(), after_ns: deadline_ns, may_still_run };
    let began = Instant::now();
    let until = began + Duration::from_nanos(deadline_ns);
    reading.refuse(&member, &name)?;
    let Ok(Ok(place)) = timeout_at(until.into(), reading.places.clone().acquire_owned()).await else {
        return Err(deadline(false));
    };
    // The former holder of the place may have been found late meanwhile.
    reading.refuse(&member, &name)?;
    let ticket = reading.tickets.fetch_add(1, Ordering::Relaxed);
    let (tell, mut told) = oneshot::channel();
    let run = move || {
        // A failure means that the caller has given up.
        let _ = tell.send(read.answer(&arg, ret_bytes));
        read.server.reading.came_back(ticket);
        drop(place);
    };
    server
        .hub
        .readers
        .run(Box::new(run))
        .map_err(|e| Refusal::NoThread { id: server.id.clone(), why: e.to_string() })?;
    match timeout_at((until + GRACE).into(), &mut told).await {
        Ok(answer) => answer.map_err(|e| panicked(&member, &e.to_string())),
        Err(_) => {
            let late = Late { ticket, name: name.clone(), since: began };
            if let Some(answer) = reading.give_up(late, &mut told) {
                return Ok(answer);
            }
            server.counters.failed(Misuse::ReadHung, name.as_bytes());
            Err(deadline(true))
        }
    }
}

type Job = Box<dyn FnOnce() + Send>;

/// Threads of one LCM that run reads.
#[derive(Default)]
pub(super) struct Readers {
    idle: Mutex<Vec<mpsc::Sender<Job>>>,
}

impl Readers {
    fn idle(&self) -> MutexGuard<'_, Vec<mpsc::Sender<Job>>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `job` on an idle thread, or on a new one.
    ///
    /// # Errors
    /// The machine gives no more threads.
    fn run(self: &Arc<Self>, mut job: Job) -> std::io::Result<()> {
        loop {
            let Some(thread) = self.idle().pop() else { break };
            match thread.send(job) {
                Ok(()) => return Ok(()),
                Err(back) => job = back.0,
            }
        }
        let readers = Arc::downgrade(self);
        let work = move || {
            loop {
                job();
                let Some(readers) = readers.upgrade() else { return };
                let (give, given) = mpsc::channel();
                let mut idle = readers.idle();
                if idle.len() >= IDLE {
                    return;
                }
                idle.push(give);
                drop(idle);
                drop(readers);
                // Without the LCM there is no next job.
                match given.recv() {
                    Ok(next) => job = next,
                    Err(_) => return,
                }
            }
        };
        house::spawn(thread::Builder::new().name("trocar-read".into()).stack_size(STACK_BYTES), work)
            .map(drop)
    }
}
