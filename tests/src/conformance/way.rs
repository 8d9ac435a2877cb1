//! How two components are connected: where their threads come from.
//!
//! Invariant: a deployment says only where client and server run and what follows from it; the cases do the
//! rest.

use std::cell::Cell;
use std::panic;
use std::sync::{Mutex, PoisonError};

use trocar::model::{Execution, ExecutionModel};

use super::Languages;

/// How a command of the client gets to the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// Through a queue, to the server's own thread.
    Queue,
    /// Directly: both share a thread. From another thread through a queue.
    Thread,
    /// Directly, in whatever thread calls: the server has none of its own.
    Caller,
    /// Through a queue of memory that two processes share, of which both have the code of the server's class:
    /// reads are answered as in one.
    Process,
    /// The same where only the server's process has that code: reads with an argument are asked for, and
    /// answered there beside the component.
    Apart,
    /// Over a line between machines: reads with an argument are asked for as well; a call that was sent may
    /// have begun, whatever becomes of its answer; each side has a queue.
    Machine,
}

impl Reach {
    pub const ALL: [Reach; 6] =
        [Reach::Queue, Reach::Thread, Reach::Caller, Reach::Process, Reach::Apart, Reach::Machine];

    /// Reads with an argument are asked for.
    #[must_use]
    pub fn asks(self) -> bool {
        matches!(self, Reach::Apart | Reach::Machine)
    }

    /// Commands wait in a queue for the server's own thread.
    #[must_use]
    pub fn queues(self) -> bool {
        matches!(self, Reach::Queue | Reach::Process | Reach::Apart | Reach::Machine)
    }
}

/// Where client and server run.
pub trait Deployment: Sync + std::panic::RefUnwindSafe {
    fn name(&self) -> &'static str;
    /// The client's commands reach the server without a queue.
    fn inline(&self) -> bool;
    /// Execution of the client `host/client`, which is made first when [`Deployment::client_leads`].
    fn client(&self) -> Execution;
    /// Execution of the server `host/server`.
    fn server(&self) -> Execution;
    /// The server runs in the client's thread.
    fn client_leads(&self) -> bool {
        false
    }
    /// Each in a process of its own.
    fn two_processes(&self) -> bool {
        false
    }
    /// What connections between clients and servers are pinned to; empty: to nothing.
    fn carrier(&self) -> &'static str {
        ""
    }
    /// Each end maps the memory they share for itself, frames for reading only.
    fn maps(&self) -> bool {
        self.two_processes() || self.carrier() == "memfd"
    }
    /// They are processes of the built program.
    fn built_processes(&self) -> bool {
        false
    }
    /// The server has a step.
    fn server_steps(&self) -> bool {
        true
    }
    /// The server steps also when there is nothing to do.
    fn server_steps_unasked(&self) -> bool {
        matches!(self.server().model, Some(ExecutionModel::Periodic | ExecutionModel::Continuous))
    }
    /// One of them keeps a processor to itself.
    fn never_rests(&self) -> bool {
        self.server_never_rests() || self.client().model == Some(ExecutionModel::Continuous)
    }
    /// The server publishes rows without end, so that what it has just written is soon kept no more.
    fn server_never_rests(&self) -> bool {
        self.server().model == Some(ExecutionModel::Continuous)
    }
}

/// A deployment and the languages: what a case is given.
#[derive(Clone, Copy)]
pub struct Way {
    pub deployment: &'static dyn Deployment,
    pub languages: Languages,
}

/// How often a case is played where the machine gives it no time.
const RUNS: usize = 5;

thread_local! {
    /// A process of a lab that was dropped on this thread was lost to its GCM, or to the other one, although
    /// nobody ended it.
    static WAS_AWAY: Cell<bool> = const { Cell::new(false) };
}

/// A process of the lab that is dropped here was lost to its GCM, or to the other one, for a while.
pub(super) fn note_away() {
    WAS_AWAY.set(true);
}

impl Way {
    #[must_use]
    pub fn reach(&self) -> Reach {
        let Way { deployment: d, languages } = self;
        match (d.client_leads(), d.inline(), d.two_processes()) {
            (true, ..) => Reach::Thread,
            (false, true, _) => Reach::Caller,
            (false, false, false) => Reach::Queue,
            (false, false, true) if d.carrier() == "net" => Reach::Machine,
            // The client's process has the code of the client's plugin, and nothing else.
            (false, false, true) if languages.client == languages.server => Reach::Process,
            (false, false, true) => Reach::Apart,
        }
    }

    /// Number of calls that may have begun, as far as a caller knows, of one that waited in a queue.
    #[must_use]
    pub fn may_have_begun(&self) -> u64 {
        u64::from(self.reach() == Reach::Machine)
    }

    /// Plays a case. A machine that gives a process no time for long makes its GCM, or the process it is
    /// linked to, think it lost, as it should: that is another promise's business, and such a run is done
    /// again.
    ///
    /// # Panics
    /// As the case.
    pub fn play(self, case: fn(&Way)) {
        let _told = self.told_in_a_failure();
        // Threads that never rest leave no processor to each other.
        static RESTLESS: Mutex<()> = Mutex::new(());
        let one_at_a_time = || RESTLESS.lock().unwrap_or_else(PoisonError::into_inner);
        let _alone = self.deployment.never_rests().then(one_at_a_time);
        if !self.deployment.two_processes() {
            return case(&self);
        }
        for _ in 1..RUNS {
            WAS_AWAY.set(false);
            match panic::catch_unwind(|| case(&self)) {
                Ok(()) => return,
                Err(_) if WAS_AWAY.get() => eprintln!("a process stood still for too long: once more"),
                Err(why) => panic::resume_unwind(why),
            }
        }
        case(&self);
    }

    /// Names deployment and languages beside whatever fails until the answer is dropped.
    #[must_use]
    pub fn told_in_a_failure(self) -> Told {
        Told(self)
    }
}

pub struct Told(Way);

impl Drop for Told {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("this way: {}, {:?}", self.0.deployment.name(), self.0.languages);
        }
    }
}

pub(super) fn model(model: ExecutionModel) -> Execution {
    Execution { model: Some(model), ..Execution::default() }
}

fn inside_client(model: ExecutionModel) -> Execution {
    Execution { model: Some(model), inside: Some("host/client".into()), ..Execution::default() }
}

/// Each has its own thread.
pub struct OtherThread;

impl Deployment for OtherThread {
    fn name(&self) -> &'static str {
        "other thread"
    }
    fn inline(&self) -> bool {
        false
    }
    fn client(&self) -> Execution {
        model(ExecutionModel::OnSignal)
    }
    fn server(&self) -> Execution {
        model(ExecutionModel::OnSignal)
    }
}

/// The client leads a stream and the server is in it.
pub struct SameStream;

impl Deployment for SameStream {
    fn name(&self) -> &'static str {
        "same stream"
    }
    fn inline(&self) -> bool {
        true
    }
    fn client(&self) -> Execution {
        model(ExecutionModel::Stream)
    }
    fn server(&self) -> Execution {
        Execution { stream_of: Some("host/client".into()), ..Execution::default() }
    }
    fn client_leads(&self) -> bool {
        true
    }
}

/// The server runs inside the client's step, before it.
pub struct ExecIn;

impl Deployment for ExecIn {
    fn name(&self) -> &'static str {
        "exec_in"
    }
    fn inline(&self) -> bool {
        true
    }
    fn client(&self) -> Execution {
        model(ExecutionModel::OnSignal)
    }
    fn server(&self) -> Execution {
        inside_client(ExecutionModel::ExecIn)
    }
    fn client_leads(&self) -> bool {
        true
    }
}

/// The server runs inside the client's step, after it.
pub struct ExecOut;

impl Deployment for ExecOut {
    fn name(&self) -> &'static str {
        "exec_out"
    }
    fn inline(&self) -> bool {
        true
    }
    fn client(&self) -> Execution {
        model(ExecutionModel::OnSignal)
    }
    fn server(&self) -> Execution {
        inside_client(ExecutionModel::ExecOut)
    }
    fn client_leads(&self) -> bool {
        true
    }
}

/// The server has no thread: its callers' threads run it.
pub struct Passive;

impl Deployment for Passive {
    fn name(&self) -> &'static str {
        "passive"
    }
    fn inline(&self) -> bool {
        true
    }
    fn client(&self) -> Execution {
        model(ExecutionModel::OnSignal)
    }
    fn server(&self) -> Execution {
        model(ExecutionModel::None)
    }
    fn server_steps(&self) -> bool {
        false
    }
}

/// Each has its own thread, and between them is memory that both map, as if they were in two processes.
pub struct SharedMemory;

impl Deployment for SharedMemory {
    fn name(&self) -> &'static str {
        "shared memory in one process"
    }
    fn inline(&self) -> bool {
        false
    }
    fn client(&self) -> Execution {
        model(ExecutionModel::OnSignal)
    }
    fn server(&self) -> Execution {
        model(ExecutionModel::OnSignal)
    }
    fn carrier(&self) -> &'static str {
        "memfd"
    }
}
