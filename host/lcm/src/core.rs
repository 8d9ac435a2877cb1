//! The part of a component that the others of this process hold: enough to tell it that something has come,
//! to ask how it stands, and to run its commands and handlers.
//!
//! Invariant: `gate` is the component's true state; only jobs on its executor and its own failures change it.
//! A core names nothing that stands behind a slot, and lives as long as a binding holds it: after its
//! component is gone it is not ACTIVE, and has no instance to enter.

mod calls;
mod peers;
mod queues;
mod rows;
mod running;
mod taps;
mod terms;
mod views;
mod waking;

use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock, Weak};

use trocar_model::{ClassInfo, ComponentId, Execution, Safety, State};
use trocar_plugin_api::abi::{NOT_ACTIVE, Outcome, PEER_LOST};
use trocar_rt::cell::BindingCell;
use trocar_rt::mark::Mark;
use trocar_rt::state::{StateReader, StateWriter, state_table};
use trocar_rt::wake::Waker;

use self::peers::Peers;
use self::terms::Terms;
use super::books::Books;
use super::boundary::{EntryError, LoadedClass, Object};
use super::context::ExecutorId;
use super::gate::{ACTIVE, Presence, pack, unpack};
use super::goal::Goal;
use super::hub::Hub;
use super::inbox::Inbox;
use super::logs::{self, LogRing};
use super::pending::Owed;
use super::thread::Thread;
use super::watch::Watch;

pub(super) use self::taps::{CommandTap, RowTap, TellsCommands, TellsRows};
pub(super) use self::views::{ShownRows, View};

/// Rows of a state table without a configured length.
const STATE_ROWS: usize = 256;

/// Number of calls whose rounding mode is checked, after a Start and after a call that changed it. Reading
/// the mode costs 10 to 20 ns on some processors, several times a direct call: not every call can be checked.
pub(super) const CALLS_ON_TRIAL: u32 = 256;

/// Data that only the holder of the entry lock touches.
pub(super) struct Inner {
    rows: StateWriter,
    /// The taps of its rows and of its commands, by the present ports.
    pub(super) row_tap: Option<RowTap>,
    pub(super) command_tap: Option<CommandTap>,
    /// Kind of goal of each command, by the present ports.
    pub(super) goals: Arc<[Goal]>,
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
    in_callback: Option<Outer>,
}

/// Activity of a device's thread before it came in; or of a thread of this LCM, when a component's code is
/// the device.
struct Outer {
    component: AtomicPtr<Core>,
    stepping: bool,
    /// Former note in the watch of the component it came into.
    watched: u64,
}

pub(super) type Entered<'a> = super::boundary::Entered<'a, Inner>;

/// The whole component, for what is rare and needs all of it.
pub(super) trait Component: Send + Sync {
    /// Ends trust in the instance: safe state, FAULT, reported everywhere.
    fn fail(&self, entered: &mut Entered<'_>, entry: &str, error: &EntryError);

    /// Brings the device to its safe condition; a failure is reported by the component itself.
    fn make_safe(&self, entered: &mut Entered<'_>);

    /// Reports a sentence about it everywhere, and keeps it with its state.
    fn warn(&self, text: &str);

    /// `interface/command` of the command at this position, by the present ports.
    fn command_name(&self, command: u32) -> Option<String>;

    /// Notes that its code wants to be asked for other ports. Never waits.
    fn wish_ports(&self);
}

/// Parts that an instance has by its present ports from the beginning.
pub(super) struct Beginning {
    pub(super) external: Arc<Inbox>,
    pub(super) row_tap: Option<RowTap>,
    pub(super) command_tap: Option<CommandTap>,
    pub(super) goals: Arc<[Goal]>,
    /// Words that a result of any command needs.
    pub(super) ret_words: usize,
}

pub(super) struct Core {
    /// Short, unique within the process, never reused.
    pub(super) number: u32,
    pub(super) id: ComponentId,
    pub(super) object: Object<Inner>,
    pub(super) rows: StateReader,
    pub(super) state_bytes: usize,
    pub(super) books: Books,
    /// State that the watchdog looks at.
    pub(super) watch: Watch,
    gate: AtomicU32,
    /// True while it is stopped in order to be removed.
    going: AtomicBool,
    /// From the moment a start or resume is entered until a stop has made the component safe.
    unsettled: AtomicBool,
    /// The decision by which it runs.
    started_by: AtomicU64,
    closed: AtomicBool,
    signalled: Mark,
    /// See [`Core::teller`].
    teller: AtomicU64,
    owed: Owed,
    terms: Terms,
    executor: ExecutorId,
    waker: Arc<Waker>,
    watchdog: Arc<Waker>,
    peers: Peers<Core>,
    /// The tap of its commands, for threads that are not inside.
    command_tap: BindingCell<Option<CommandTap>>,
    /// Rows behind GetState, each a `ComponentStatus`.
    status_rows: StateReader,
    logs: Arc<LogRing>,
    me: Weak<Core>,
    component: OnceLock<Weak<dyn Component>>,
    /// Keeps the library mapped.
    _class: LoadedClass,
}

impl Core {
    pub(super) fn new(
        (number, id): (u32, ComponentId),
        (info, class): (&ClassInfo, LoadedClass),
        (hub, status_rows): (&Hub, StateReader),
        (execution, thread): (&Execution, Thread),
        begin: Beginning,
    ) -> Arc<Core> {
        let state_bytes = info.ports.state.as_ref().map_or(0, trocar_model::Type::size);
        let kept = execution.history.map_or(STATE_ROWS, |rows| rows as usize);
        let (writer, rows) = state_table(state_bytes, kept);
        let terms = Terms::of(execution, &thread, info.safety == Safety::Actuator);
        let inner = Inner {
            rows: writer,
            row_tap: begin.row_tap,
            command_tap: begin.command_tap.clone(),
            goals: begin.goals,
            untold: None,
            ret: vec![0; begin.ret_words],
            cycle: 0,
            cycle_at_start: 0,
            on_trial: 0,
            started: false,
            to_stop: false,
            last_begin_ns: 0,
            in_callback: None,
        };
        Arc::new_cyclic(|me| Core {
            number,
            id,
            object: Object::new(class.table(), inner),
            rows,
            state_bytes,
            books: Books::new(terms.period_ns),
            watch: Watch::default(),
            gate: AtomicU32::new(pack(State::Created)),
            going: AtomicBool::new(false),
            unsettled: AtomicBool::new(false),
            started_by: AtomicU64::new(0),
            closed: AtomicBool::new(false),
            signalled: Mark::default(),
            teller: AtomicU64::new(0),
            owed: Owed::default(),
            terms,
            executor: thread.id,
            waker: thread.waker,
            watchdog: hub.watch.clone(),
            peers: Peers::new(begin.external),
            command_tap: BindingCell::new(Box::new(begin.command_tap)),
            status_rows,
            logs: hub.logs.clone(),
            me: me.clone(),
            component: OnceLock::new(),
            _class: class,
        })
    }

    /// Sets the component it is the core of; once.
    pub(super) fn belong(&self, component: Weak<dyn Component>) {
        let _ = self.component.set(component);
    }

    /// Its component; `None` when that is gone. Not for a step: the last owner drops it.
    pub(super) fn component(&self) -> Option<Arc<dyn Component>> {
        self.component.get().and_then(Weak::upgrade)
    }

    /// Tells whether its component is there.
    pub(super) fn has_component(&self) -> bool {
        self.component.get().is_some_and(|component| component.strong_count() > 0)
    }

    pub(super) fn state(&self) -> State {
        unpack(self.gate.load(Ordering::Acquire))
    }

    #[inline]
    pub(super) fn is_active(&self) -> bool {
        self.gate.load(Ordering::SeqCst) == ACTIVE
    }

    /// Sets the state and returns the former one. The component reports the change.
    pub(super) fn set_gate(&self, state: State) -> State {
        unpack(self.gate.swap(pack(state), Ordering::SeqCst))
    }

    /// Sets the state if it is still `from`; true if it was. The component reports the change.
    pub(super) fn set_gate_from(&self, from: State, state: State) -> bool {
        self.gate.compare_exchange(pack(from), pack(state), Ordering::SeqCst, Ordering::Relaxed).is_ok()
    }

    /// State of the component for its callers.
    pub(super) fn presence(&self) -> Presence {
        if self.going.load(Ordering::SeqCst) || self.is_closed() {
            Presence::Gone
        } else if self.is_active() {
            Presence::Active
        } else {
            Presence::NotActive
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

    /// Notes that its code may set something in motion, or that all of it is at rest.
    pub(super) fn set_unsettled(&self, unsettled: bool) {
        self.unsettled.store(unsettled, Ordering::SeqCst);
    }

    /// Notes the decision by which it is set in motion.
    pub(super) fn set_started_by(&self, decision: u64) {
        self.started_by.store(decision, Ordering::SeqCst);
    }

    /// The decision by which it was set in motion last.
    pub(super) fn started_by(&self) -> u64 {
        self.started_by.load(Ordering::SeqCst)
    }

    /// Tells whether it was started and no stop has brought it to rest since, whatever its state.
    pub(super) fn is_unsettled(&self) -> bool {
        self.unsettled.load(Ordering::SeqCst)
    }

    /// Logs a line of its code. Real-time.
    pub(super) fn log(&self, level: u32, target: &[u8], text: &[u8]) {
        self.logs.push(self.number, level, target, text);
    }

    /// Logs a line for the host's log about this component; the log thread prints it. Real-time.
    pub(super) fn say(&self, level: log::Level, text: &str) {
        self.log(level as u32, logs::HOST.as_bytes(), text.as_bytes());
    }

    /// Ends trust in its instance: see [`Component::fail`].
    #[cold]
    pub(super) fn fail(&self, entered: &mut Entered<'_>, entry: &str, error: &EntryError) {
        if let Some(component) = self.component() {
            component.fail(entered, entry, error);
        }
    }

    /// Sets the tap of its commands, for all threads. By the thread that is inside, or before any is.
    pub(super) fn set_command_tap(&self, entered: &mut Entered<'_>, tap: Option<&CommandTap>) {
        entered.inner().command_tap = tap.cloned();
        self.command_tap.swap(Box::new(tap.cloned()));
    }

    /// Tells the tap of a command that is not carried out. Any thread; real-time.
    #[cold]
    pub(super) fn tell_turned_away(&self, command: u32, arg: *const u8, outcome: Outcome) {
        self.command_tap.look(|tap| {
            if let Some(tap) = tap.as_ref().filter(|tap| tap.is_listened()) {
                tap.to.tell(command, arg, outcome, false);
            }
        });
    }

    /// Drops what cycles that have ended looked at; returns how much is left.
    pub(super) fn reclaim(&self) -> usize {
        self.peers.reclaim() + self.command_tap.reclaim()
    }
}
