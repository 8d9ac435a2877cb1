//! One component of this process: its plugin instance, its queues, its published state, its counters.
//!
//! Invariant: `gate` is the component's true state; only jobs on its executor and its own failures change it.
//! Nothing here is removed while a peer still holds it: bindings keep an `Arc`.

mod counters;
mod drain;
mod running;
mod status;
mod views;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use trocar_loader::system;
use trocar_model::{ClassInfo, ComponentId, Execution, State, StopReason};
use trocar_plugin_api::abi::{
    HostTable, INVALID_ARGUMENT, LOG_WARN, NOT_ACTIVE, Outcome, PEER_LOST, WOULD_BLOCK,
};
use trocar_rt::cell::BindingCell;
use trocar_rt::mark::Mark;
use trocar_rt::state::{StateReader, StateWriter, state_table};
use trocar_rt::timing::CycleStats;
use trocar_rt::wake::Waker;

pub(super) use self::counters::{Counters, LastWords, Misuse};
pub(super) use self::drain::CALLS_ON_TRIAL;
pub(super) use self::running::Stepped;
use self::running::Terms;
pub(super) use self::status::Loss;
use self::views::Views;
pub(super) use self::views::{ShownRows, View};
use super::boundary::LoadedClass;
use super::boundary::{
    AllRemains, CommandTap, EntryError, HostContext, NoRoom, Object, OutCell, SharedTable,
};
use super::context::{self, ExecutorId};
use super::described::Described;
use super::desk::{Account, Asker};
use super::gate::{ACTIVE, Standing, pack, unpack};
use super::hub::Hub;
use super::inbox::Inbox;
use super::pending::Owed;
use super::reading::Reading;
use super::realtime::Settings;
use super::supervise::{Entry, Moment, Watch};
use super::thread::Thread;

/// Rows of a state table without a configured length.
const STATE_ROWS: usize = 256;
/// Rows of the table behind GetState.
const STATUS_ROWS: usize = 8;

/// Reason to keep a component whose handles outlive it.
pub(super) const HELD: &str =
    "its code still holds ports or host handles of it, in a static or in a thread that did not end";

/// Data that only the holder of the entry lock touches.
pub(super) struct Inner {
    rows: StateWriter,
    /// The taps of its rows and of its commands, by the present ports.
    pub(super) row_tap: Option<Arc<OutCell>>,
    pub(super) command_tap: Option<CommandTap>,
    /// Stamp, ns, and number of the newest row, if its tap was not told of it yet.
    untold: Option<(u64, u64)>,
    /// Room for results of queued commands before they go to the reply cell.
    pub(super) ret: Vec<u64>,
    /// Cycles so far, over all Starts: ticks of rows never go back, or none could be found by its tick.
    pub(super) cycle: u64,
    /// Cycles before the last Start.
    pub(super) cycle_at_start: u64,
    /// True once it was started after its creation: there is run-time state to go on with.
    pub(super) started: bool,
    /// True after its start or resume was entered, until a stop returns.
    pub(super) to_stop: bool,
    pub(super) last_begin_ns: u64,
    /// Number of its next calls after which the rounding mode is checked.
    pub(super) on_trial: u32,
    /// Set while a thread of the device is inside: the thread's activity before.
    in_callback: Option<running::Outer>,
}

impl Inner {
    /// Tells the tap of the newest row, unless it knows that row.
    fn tell_row(&mut self) {
        if let Some((stamp_ns, row)) = self.untold.take()
            && let Some(tap) = &self.row_tap
        {
            tap.tell_row(self.rows.newest(), stamp_ns, row);
        }
    }
}

pub(super) type Entered<'a> = super::boundary::Entered<'a, Inner>;

pub(super) struct Instance {
    /// Short, unique within the process, never reused.
    pub(super) number: u32,
    pub(super) id: ComponentId,
    pub(super) info: Arc<ClassInfo>,
    /// The ports by the present description.
    pub(super) described: Described,
    pub(super) object: Object<Inner>,
    pub(super) rows: StateReader,
    pub(super) state_bytes: usize,
    pub(super) counters: Counters,
    pub(super) stats: CycleStats,
    /// Reads from outside.
    pub(super) reading: Reading,
    inboxes: BindingCell<Vec<Arc<Inbox>>>,
    views: Views,
    /// Lets managers change the lists one after the other.
    editing: Mutex<()>,
    pub(super) owed: Owed,
    gate: AtomicU32,
    fault: Mutex<String>,
    /// State that the watchdog looks at.
    pub(super) watch: Watch,
    /// Rows behind GetState, each a `ComponentStatus`.
    status: Mutex<StateWriter>,
    status_rows: StateReader,
    /// Settings of its thread that the machine granted or refused; set once.
    settings: OnceLock<Arc<Settings>>,
    /// Sentences shown with its state beside those of its thread.
    warnings: Mutex<Vec<String>>,
    /// Threads its own code may have started.
    brood: Mutex<BTreeMap<i32, (String, bool)>>,
    /// The moment before its code first ran.
    made: OnceLock<Moment>,
    /// Required ports whose connection was lost or cut, and the time from which it counts as lost, ns.
    missing: Mutex<BTreeMap<String, u64>>,
    signalled: Mark,
    /// See [`Instance::teller`].
    teller: AtomicU64,
    /// True while it is stopped in order to be removed.
    going: AtomicBool,
    closed: AtomicBool,
    terms: Terms,
    executor: ExecutorId,
    waker: Arc<Waker>,
    host: Arc<HostContext>,
    host_table: Arc<SharedTable>,
    pub(super) hub: Arc<Hub>,
    /// Takes what is left of it when it is dropped.
    remains: Arc<AllRemains>,
    /// Keeps the library mapped.
    _class: LoadedClass,
}

impl Instance {
    /// # Errors
    /// There is no memory for the frames of its outputs.
    pub(super) fn new(
        number: u32,
        id: ComponentId,
        info: Arc<ClassInfo>,
        class: LoadedClass,
        (hub, remains): (Arc<Hub>, Arc<AllRemains>),
        execution: &Execution,
        thread: Thread,
    ) -> Result<Arc<Self>, NoRoom> {
        let ports = &info.ports;
        let state_bytes = ports.state.as_ref().map_or(0, trocar_model::Type::size);
        let kept = execution.history.map_or(STATE_ROWS, |rows| rows as usize);
        let (writer, rows) = state_table(state_bytes, kept);
        let (status, status_rows) = state_table(system::MAX_BYTES, STATUS_ROWS);
        let terms = Terms::of(execution, &thread);
        let described = Described::new(ports.clone())?;
        let now = described.now();
        let host = HostContext::new(number, id.clone(), &hub.logs, &hub.desk);
        let instance = Arc::new(Instance {
            number,
            object: Object::new(
                class.table(),
                Inner {
                    rows: writer,
                    row_tap: now.row_tap().cloned(),
                    command_tap: now.command_tap.clone(),
                    untold: None,
                    ret: vec![0; now.ret_words()],
                    cycle: 0,
                    cycle_at_start: 0,
                    on_trial: 0,
                    started: false,
                    to_stop: false,
                    last_begin_ns: 0,
                    in_callback: None,
                },
            ),
            rows,
            state_bytes,
            counters: Counters::default(),
            stats: CycleStats::new(terms.period_ns()),
            reading: Reading::default(),
            inboxes: BindingCell::new(Box::new(vec![now.external.clone()])),
            views: Views::default(),
            editing: Mutex::new(()),
            owed: Owed::default(),
            described,
            gate: AtomicU32::new(pack(State::Created)),
            fault: Mutex::new(String::new()),
            watch: Watch::default(),
            status: Mutex::new(status),
            status_rows,
            settings: OnceLock::new(),
            warnings: Mutex::new(Vec::new()),
            brood: Mutex::new(BTreeMap::new()),
            made: OnceLock::new(),
            missing: Mutex::new(BTreeMap::new()),
            signalled: Mark::default(),
            teller: AtomicU64::new(0),
            going: AtomicBool::new(false),
            closed: AtomicBool::new(false),
            terms,
            executor: thread.id,
            waker: thread.waker,
            host_table: host.shared_table(),
            host,
            hub,
            remains,
            id,
            info,
            _class: class,
        });
        let me = Arc::downgrade(&instance);
        instance.hub.desk.enter(number, me.clone());
        let _ = instance.host.instance.set(me);
        instance.publish_status();
        Ok(instance)
    }

    pub(super) fn executor_id(&self) -> ExecutorId {
        self.executor
    }

    /// Services it has asked for that are not answered yet.
    pub(super) fn account(&self) -> &Account {
        &self.host.account
    }

    /// Asks for a service. Any thread of its code. Never waits, locks or allocates.
    pub(super) fn ask_service(&self, token: u64, request: &[u8]) -> Outcome {
        if context::in_step() {
            self.counters.misuse(Misuse::ServiceFromStep);
            return WOULD_BLOCK;
        }
        self.hub.desk.ask(self.account(), self.number, token, request).unwrap_or_else(|why| {
            self.log(LOG_WARN, "services", why);
            INVALID_ARGUMENT
        })
    }

    /// Logs a line of the host's own under this component's name. Real-time.
    pub(super) fn log(&self, level: u32, target: &str, text: &str) {
        self.host.logs.push(self.number, level, target.as_bytes(), text.as_bytes());
    }

    /// Logs a line for the host's log about this component; the log thread prints it. Real-time.
    pub(super) fn say(&self, level: log::Level, text: &str) {
        self.log(level as u32, super::logs::HOST, text);
    }

    /// A counted reference to itself; `None` while it is being dropped.
    pub(super) fn me(&self) -> Option<Arc<Instance>> {
        self.host.instance.get().and_then(std::sync::Weak::upgrade)
    }

    pub(super) fn host_table(&self) -> *const HostTable {
        self.host_table.pointer()
    }

    pub(super) fn state(&self) -> State {
        unpack(self.gate.load(Ordering::Acquire))
    }

    pub(super) fn is_active(&self) -> bool {
        self.gate.load(Ordering::SeqCst) == ACTIVE
    }

    /// Handles a failure that ends trust in the instance: safe state, FAULT, reported everywhere.
    pub(super) fn fail(&self, entered: &mut Entered<'_>, entry: &str, error: &EntryError) {
        let text = format!("{entry}: {}", error.text);
        // No more of its code runs, then the device is made safe, and only then the failure is reported.
        let before = self.shut(State::Fault, &text);
        // A failure is reported in there, and there is nothing safer to do.
        let _ = self.make_safe(entered);
        let on_failure = self.on_failure();
        on_failure.map(|said| self.keep_warning(said));
        self.tell_change(before);
        self.refuse_queued(self.turned_away());
        self.publish_state(entered);
        self.say(log::Level::Error, &format!("it is in FAULT: {text}"));
        self.message(system::ERROR, &text);
        if let Some(said) = on_failure {
            self.say(log::Level::Warn, said);
            self.message(system::WARNING, said);
        }
    }

    /// Brings the device to its safe condition.
    ///
    /// # Errors
    /// The device did not get there: this was reported everywhere, and a component that moves something, or
    /// panicked, is in FAULT.
    pub(super) fn make_safe(&self, entered: &mut Entered<'_>) -> Result<(), EntryError> {
        let done = self.as_running(Entry::MakeSafe, || entered.make_safe());
        done.inspect_err(|e| self.not_made_safe("make_safe", e))
    }

    /// Makes it safe if that is owed, without a report, which no one could receive any more; on its own
    /// thread.
    pub(super) fn make_safe_silently(&self) {
        if self.watch.owes_safe()
            && let Some(mut entered) = self.object.try_enter()
        {
            let _ = self.as_running(Entry::MakeSafe, || entered.make_safe());
            self.watch.takes_owed_safe();
        }
    }

    pub(super) fn reclaim(&self) -> usize {
        self.described.reclaim() + self.inboxes.reclaim() + self.views.reclaim()
    }

    /// Ends the plugin's instance. False when it is left with everything it was given: when another thread
    /// still makes it safe, or when handles outlive it; those then report that nobody is connected.
    pub(super) fn destroy(&self, entered: &mut Entered<'_>) -> bool {
        let destroyed = self.as_running(Entry::Destroy, || entered.destroy());
        let why = match destroyed {
            false => "another thread is still making it safe",
            true if self.host.is_held() => HELD,
            true => return true,
        };
        if let Some(me) = self.me() {
            self.hub.retire(self.number, &self.id, me, why);
        }
        false
    }

    /// Tells whether its code holds ports or host handles that were to go with one of its instances.
    pub(super) fn holds_on(&self) -> bool {
        self.host.is_held()
    }

    /// Tells everything that can still reach the component that it is gone.
    pub(super) fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.show_standing();
        self.refuse_queued(PEER_LOST);
    }

    /// Notes that it is about to be removed, or that it is not after all and runs again.
    pub(super) fn set_going(&self, going: bool) {
        self.going.store(going, Ordering::Release);
        self.show_standing();
    }

    /// State of the component for its callers.
    pub(super) fn standing(&self) -> Standing {
        if self.going.load(Ordering::SeqCst) || self.is_closed() {
            Standing::Gone
        } else if self.is_active() {
            Standing::Active
        } else {
            Standing::NotActive
        }
    }

    /// Outcome for callers that cannot be served any more: stopped is not ACTIVE, removed is gone. Real-time.
    #[cold]
    pub(super) fn turned_away(&self) -> Outcome {
        if self.going.load(Ordering::Acquire) || self.is_closed() { PEER_LOST } else { NOT_ACTIVE }
    }

    /// Tells whether it is removed, or replaced by another instance; it sends nothing more then.
    pub(super) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    /// Sets the state of a restarted or failed component after `stop`.
    pub(super) fn stopped(&self, reason: StopReason) {
        self.set_state(State::Stopped(reason), "");
    }
}

impl Asker for Instance {
    fn id(&self) -> &ComponentId {
        &self.id
    }

    fn account(&self) -> &Account {
        Instance::account(self)
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // While a cycle may look there, the follower of ports is woken.
        if self.remains.take(&self.host, self.host_table.clone(), self.described.all_slots()) {
            self.hub.ports.notify();
        }
    }
}
