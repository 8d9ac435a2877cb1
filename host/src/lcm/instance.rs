//! One component of this process: its plugin instance, its queues, its published state, its counters.
//!
//! Invariant: `gate` is the component's true state; only jobs on its executor and its own failures change it. Nothing here
//! is removed while a peer still holds it: bindings keep an `Arc`.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use trocar_model::{ClassInfo, ComponentId, ExecutionModel, Health, Ports, State, StopReason};
use trocar_plugin_api::abi::{
    ErrBuf, HostTable, NOT_ACTIVE, Outcome, PEER_LOST, QUEUE_FULL, STATUS_OK, STATUS_PANICKED, Tick,
};
use trocar_rt::cell::BindingCell;
use trocar_rt::mailbox::{EntryHead, Mailbox};
use trocar_rt::os;
use trocar_rt::reply::ReplyPool;
use trocar_rt::state::{StateReader, StateWriter, state_table};
use trocar_rt::timing::CycleStats;
use trocar_rt::wake::Waker;

use super::boundary::LoadedClass;
use super::boundary::{
    ERR_BYTES, EntryError, HostContext, Object, SharedTable, Slots, as_bytes, outcome_of, sentence,
};
use super::context::{self, ExecutorId};
use super::gate::{ACTIVE, pack, unpack};
use super::hub::Hub;
use super::inbox::{ENTRY_EVENT, Inbox};
use super::{News, Report, system};

/// Longest stay inside a component's code before it counts as unresponsive, ns; five periods when those are longer.
const PATIENCE_NS: u64 = 50_000_000;

/// Rows of a state table.
const STATE_ROWS: usize = 256;

/// Counted misuse and loss, visible in GetState and Describe.
#[derive(Default)]
pub(super) struct Counters {
    would_block: AtomicU64,
    overlap: AtomicU64,
    commands: AtomicU64,
}

impl Counters {
    pub(super) fn would_block(&self) {
        self.would_block.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn overlap(&self) {
        self.overlap.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn commands(&self) -> u64 {
        self.commands.load(Ordering::Relaxed)
    }
}

/// What only the holder of the entry lock touches.
pub(super) struct Inner {
    rows: StateWriter,
    /// Where results of queued commands are written before they go to the reply cell.
    ret: Vec<u64>,
    pub(super) cycle: u64,
    pub(super) last_begin_ns: u64,
}

pub(super) type Entered<'a> = super::boundary::Entered<'a, Inner>;

pub(super) struct Instance {
    /// Short, unique within the process, never reused.
    pub(super) number: u32,
    pub(super) id: ComponentId,
    pub(super) info: Arc<ClassInfo>,
    pub(super) ports: Mutex<Arc<Ports>>,
    pub(super) object: Object<Inner>,
    pub(super) rows: StateReader,
    pub(super) state_bytes: usize,
    pub(super) slots: Slots,
    pub(super) counters: Counters,
    pub(super) stats: CycleStats,
    /// Queue of the control plane.
    pub(super) external: Arc<Inbox>,
    inboxes: BindingCell<Vec<Arc<Inbox>>>,
    gate: AtomicU32,
    fault: Mutex<String>,
    overrun: AtomicBool,
    /// When the entry that runs now began, ns; 0 between entries.
    busy_since_ns: AtomicU64,
    /// Nominal period, ns; 0 without one.
    period_ns: u64,
    /// The health that was last told.
    told: Mutex<Health>,
    signalled: AtomicBool,
    /// Its executor steps it on a grid, so nobody needs to wake it.
    on_grid: AtomicBool,
    passive: bool,
    executor: OnceLock<(ExecutorId, Arc<Waker>)>,
    host: Arc<HostContext>,
    host_table: SharedTable,
    hub: Arc<Hub>,
    /// First id that is not the class's own command but the system interface's.
    system_commands: u32,
    /// Position of the system interface's first event.
    system_events: usize,
    /// Keeps the library mapped.
    _class: LoadedClass,
}

impl Instance {
    /// `passive`: execution model `none`. `period_ns`: of its grid, 0 without one.
    pub(super) fn new(
        number: u32,
        id: ComponentId,
        info: Arc<ClassInfo>,
        class: LoadedClass,
        hub: Arc<Hub>,
        passive: bool,
        period_ns: u64,
    ) -> Arc<Self> {
        let ports = &info.ports;
        let state_bytes = ports.state.as_ref().map_or(0, trocar_model::Type::size);
        let (writer, rows) = state_table(state_bytes, STATE_ROWS);
        let commands = || ports.provided.iter().flat_map(|p| &p.commands);
        let max_arg = commands().filter_map(|c| c.arg.as_ref()).map(|a| a.ty.size()).max().unwrap_or(0);
        let max_ret = commands().filter_map(|c| c.ret.as_ref()).map(|t| t.size()).max().unwrap_or(0);
        let system = ports.provided.last();
        let system_commands = (commands().count() - system.map_or(0, |s| s.commands.len())) as u32;
        let events = ports.provided.iter().map(|p| p.events.len()).sum::<usize>();
        let external = Arc::new(Inbox {
            mailbox: Mailbox::new(64, max_arg, system_commands as usize),
            replies: ReplyPool::new(16, max_ret, ERR_BYTES),
            targets: (0..system_commands).collect(),
        });
        let host = Arc::new(HostContext { number, logs: hub.logs.clone(), instance: OnceLock::new() });
        let instance = Arc::new(Instance {
            number,
            object: Object::new(
                class.table(),
                Inner { rows: writer, ret: vec![0; max_ret.div_ceil(8)], cycle: 0, last_begin_ns: 0 },
            ),
            rows,
            state_bytes,
            slots: Slots::new(ports),
            counters: Counters::default(),
            stats: CycleStats::new(period_ns),
            inboxes: BindingCell::new(Box::new(vec![external.clone()])),
            external,
            gate: AtomicU32::new(pack(State::Created)),
            fault: Mutex::new(String::new()),
            overrun: AtomicBool::new(false),
            busy_since_ns: AtomicU64::new(0),
            period_ns,
            told: Mutex::new(Health::Ok),
            signalled: AtomicBool::new(false),
            on_grid: AtomicBool::new(false),
            passive,
            executor: OnceLock::new(),
            host_table: host.shared_table(),
            host,
            hub,
            system_commands,
            system_events: events - system.map_or(0, |s| s.events.len()),
            ports: Mutex::new(Arc::new(ports.clone())),
            id,
            info,
            _class: class,
        });
        let _ = instance.host.instance.set(Arc::downgrade(&instance));
        instance
    }

    /// Marks this component as the one whose code runs on this thread, while `f` runs.
    pub(super) fn as_running<R>(&self, f: impl FnOnce() -> R) -> R {
        let before = context::swap_component(Arc::as_ptr(&self.host));
        let result = f();
        context::swap_component(before);
        result
    }

    pub(super) fn attach(&self, executor: ExecutorId, waker: Arc<Waker>) {
        let _ = self.executor.set((executor, waker));
    }

    pub(super) fn executor_id(&self) -> ExecutorId {
        self.executor.get().map_or(0, |(id, _)| *id)
    }

    pub(super) fn host_table(&self) -> *const HostTable {
        self.host_table.pointer()
    }

    pub(super) fn state(&self) -> State {
        unpack(self.gate.load(Ordering::Acquire))
    }

    pub(super) fn is_active(&self) -> bool {
        self.gate.load(Ordering::Acquire) == ACTIVE
    }

    pub(super) fn is_passive(&self) -> bool {
        self.passive
    }

    /// True when the calling thread may run this component's commands directly.
    pub(super) fn runs_here(&self) -> bool {
        let here = context::executor();
        self.passive || (here != 0 && here == self.executor_id())
    }

    /// Something is there for this component: marks it and wakes its executor.
    pub(super) fn signal(&self) {
        self.signalled.store(true, Ordering::Release);
        if let Some((_, waker)) = self.executor.get()
            && self.wants_wake()
        {
            context::wake(waker);
        }
    }

    /// A component on a grid looks at its next cycle; only sleepers are woken.
    fn wants_wake(&self) -> bool {
        !self.passive && !self.on_grid.load(Ordering::Relaxed)
    }

    /// Says whether its executor steps it on a grid.
    pub(super) fn set_on_grid(&self, on: bool) {
        self.on_grid.store(on, Ordering::Relaxed);
    }

    pub(super) fn has_signal(&self) -> bool {
        self.signalled.load(Ordering::Acquire)
    }

    /// True once after each signal.
    pub(super) fn take_signal(&self) -> bool {
        self.signalled.swap(false, Ordering::Acquire)
    }

    /// Sets state and fault text, tells the world.
    pub(super) fn set_state(&self, state: State, fault: &str) {
        *self.fault.lock().unwrap_or_else(PoisonError::into_inner) = fault.to_owned();
        let before = self.gate.swap(pack(state), Ordering::AcqRel);
        if before == pack(state) {
            return;
        }
        let mut row = [0u8; system::MAX_BYTES];
        self.write_status(&mut row);
        self.system_event(system::STATE_CHANGED, &row);
        // Nobody listening is fine: the inventory has it.
        let _ = self.hub.news.send(News::State(self.report(false)));
    }

    pub(super) fn report(&self, with_ports: bool) -> Report {
        Report {
            id: self.id.clone(),
            state: self.state(),
            health: self.health(),
            fault: self.fault.lock().unwrap_or_else(PoisonError::into_inner).clone(),
            ports: with_ports.then(|| self.ports()),
            warnings: Vec::new(),
        }
    }

    pub(super) fn ports(&self) -> Arc<Ports> {
        self.ports.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn health(&self) -> Health {
        let since = self.busy_since_ns.load(Ordering::Relaxed);
        if since != 0 && os::now_ns().saturating_sub(since) > PATIENCE_NS.max(5 * self.period_ns) {
            return Health::Unresponsive;
        }
        if self.overrun.load(Ordering::Relaxed) { Health::Overrun } else { Health::Ok }
    }

    /// Tells the world when the health is another than it last heard; the watchdog's question.
    pub(super) fn tell_health(&self) {
        let now = self.health();
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        if *told == now {
            return;
        }
        *told = now;
        drop(told);
        if now == Health::Unresponsive {
            let text = "does not come back out of its own code";
            log::warn!("{} {text}", self.id);
            self.message(system::WARNING, text);
        }
        // Nobody listening is fine: the inventory has it.
        let _ = self.hub.news.send(News::State(self.report(false)));
    }

    /// Real-time: a flag, told by whoever asks.
    pub(super) fn set_overrun(&self, overrun: bool) {
        self.overrun.store(overrun, Ordering::Relaxed);
    }

    /// An entry failed in a way that ends trust in the instance: safe state, FAULT, said everywhere.
    pub(super) fn fail(&self, entered: &mut Entered<'_>, entry: &str, error: &EntryError) {
        let text = format!("{entry}: {}", error.text);
        self.set_state(State::Fault, &text);
        self.make_safe(entered);
        self.publish_state(entered);
        log::error!("{} is in FAULT: {text}", self.id);
        self.message(system::ERROR, &text);
    }

    /// Brings the device to its safe condition; a failure is said, not passed on: there is nothing safer to do.
    pub(super) fn make_safe(&self, entered: &mut Entered<'_>) {
        if let Err(e) = entered.make_safe() {
            log::error!("{}: make_safe: {}", self.id, e.text);
            self.message(system::ERROR, &e.text);
        }
    }

    /// Emits `status`, `warning` or `error` of the system interface.
    pub(super) fn message(&self, event: usize, text: &str) {
        let mut row = [0u8; system::MESSAGE_BYTES];
        system::write_message(os::now_ns(), text, &mut row);
        self.system_event(event, &row);
    }

    fn system_event(&self, event: usize, row: &[u8]) {
        let cell = self.slots.event(self.system_events + event);
        cell.emit(&row[..cell.bytes.min(row.len())]);
    }

    /// Which read of the system interface a command id is.
    pub(super) fn system_command(&self, command: u32) -> Option<usize> {
        command.checked_sub(self.system_commands).map(|n| n as usize)
    }

    /// Answers a read of the system interface into `out`; returns its stamp.
    pub(super) fn system_read(&self, which: usize, out: &mut [u8]) -> u64 {
        match which {
            system::PERIOD_STATISTICS => {
                let s = self.statistics();
                system::write_statistics(&s, out);
                s.stamp_ns
            }
            system::GET_STATE => self.write_status(out),
            _ => 0,
        }
    }

    fn write_status(&self, out: &mut [u8]) -> u64 {
        let stamp_ns = os::now_ns();
        let fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner);
        system::write_status(stamp_ns, &self.state().to_string(), &self.health().to_string(), &fault, out);
        stamp_ns
    }

    fn statistics(&self) -> system::Statistics {
        let s = self.stats.snapshot();
        let seconds = |ns: f64| ns * 1e-9;
        system::Statistics {
            stamp_ns: os::now_ns(),
            period: [
                seconds(s.period.avg_ns),
                seconds(s.period.std_ns),
                seconds(s.period.min_ns as f64),
                seconds(s.period.max_ns as f64),
            ],
            compute: [
                seconds(s.compute.avg_ns),
                seconds(s.compute.std_ns),
                seconds(s.compute.min_ns as f64),
                seconds(s.compute.max_ns as f64),
            ],
            lateness: [
                seconds(s.lateness_p50_ns as f64),
                seconds(s.lateness_p99_ns as f64),
                seconds(s.lateness_max_ns as f64),
            ],
            load: s.load,
            executed: s.executed,
            skipped: s.skipped,
            overruns: s.overruns,
        }
    }

    /// Changes the list of queues; managers only.
    pub(super) fn edit_inboxes(&self, f: impl FnOnce(&mut Vec<Arc<Inbox>>)) {
        let mut inboxes = self.inboxes.enter().clone();
        f(&mut inboxes);
        self.inboxes.swap(Box::new(inboxes));
    }

    pub(super) fn reclaim(&self) -> usize {
        self.slots.reclaim() + self.inboxes.reclaim()
    }

    /// Commands rejected and events dropped over all queues into this component.
    pub(super) fn queue_losses(&self) -> u64 {
        self.inboxes.enter().iter().map(|i| i.mailbox.stats()).map(|s| s.rejected + s.dropped).sum()
    }

    /// Answers everything queued, unexecuted.
    pub(super) fn refuse_queued(&self, outcome: Outcome) {
        for inbox in self.inboxes.enter().iter() {
            inbox.refuse_all(outcome);
        }
    }

    /// Runs what is queued: what was there, plus once what arrived meanwhile. Real-time.
    pub(super) fn drain(&self, entered: &mut Entered<'_>) {
        let inboxes = self.inboxes.enter();
        for inbox in inboxes.iter() {
            let run = |head: EntryHead, payload: &[u8]| {
                let Some(target) = inbox.targets.get(head.index as usize) else { return };
                if head.kind == ENTRY_EVENT {
                    self.deliver(entered, *target, payload);
                } else {
                    self.answer(entered, inbox, *target, head.reply, payload);
                }
            };
            // Superseded by a newer one of the same command.
            let skip = |head: EntryHead| {
                inbox.replies.fail(head.reply, QUEUE_FULL);
            };
            inbox.mailbox.drain(run, skip);
        }
    }

    fn deliver(&self, entered: &mut Entered<'_>, handler: u32, payload: &[u8]) {
        if !self.is_active() {
            return;
        }
        if let Err(e) = entered.on_event(handler, payload.as_ptr())
            && e.panicked()
        {
            self.fail(entered, "on_event", &e);
        }
    }

    fn answer(&self, entered: &mut Entered<'_>, inbox: &Inbox, command: u32, reply: u64, payload: &[u8]) {
        let running = if reply == 0 {
            None
        } else {
            match inbox.replies.begin(reply, PEER_LOST) {
                Some(running) => Some(running),
                // The caller gave up before it began: not executed, as it was told.
                None => return,
            }
        };
        let mut room = [0u8; ERR_BYTES];
        let mut err = ErrBuf { ptr: room.as_mut_ptr(), cap: room.len(), len: 0 };
        let ret = entered.inner().ret.as_mut_ptr();
        let outcome = if self.is_active() {
            self.command_inside(entered, command, payload.as_ptr(), ret.cast(), &raw mut err)
        } else {
            NOT_ACTIVE
        };
        if let Some(running) = running {
            let text = &room[..err.len.min(ERR_BYTES)];
            let value = as_bytes(&entered.inner().ret);
            running.finish(outcome, |ret, room| {
                let n = ret.len().min(value.len());
                ret[..n].copy_from_slice(&value[..n]);
                let n = room.len().min(text.len());
                room[..n].copy_from_slice(&text[..n]);
                n
            });
        }
    }

    /// Runs one command directly and leaves.
    pub(super) fn run_command(
        &self,
        mut entered: Entered<'_>,
        command: u32,
        arg: *const u8,
        ret: *mut u8,
        err: *mut ErrBuf,
    ) -> Outcome {
        let outcome = self.command_inside(&mut entered, command, arg, ret, err);
        drop(entered);
        self.drain_if_passive();
        outcome
    }

    fn command_inside(
        &self,
        entered: &mut Entered<'_>,
        command: u32,
        arg: *const u8,
        ret: *mut u8,
        err: *mut ErrBuf,
    ) -> Outcome {
        let before = context::swap_component(Arc::as_ptr(&self.host));
        let status = entered.command(command, arg, ret, err);
        context::swap_component(before);
        self.counters.commands.fetch_add(1, Ordering::Relaxed);
        if status == STATUS_PANICKED {
            let text = sentence(err);
            self.fail(entered, "command", &EntryError { status, text });
        } else {
            self.publish_state(entered);
        }
        if status >= STATUS_OK { trocar_plugin_api::abi::EXECUTED } else { outcome_of(status) }
    }

    /// Runs what was queued while somebody was inside a passive component.
    pub(super) fn drain_if_passive(&self) {
        if !self.passive {
            return;
        }
        while self.signalled.swap(false, Ordering::AcqRel) {
            match self.object.try_enter() {
                Some(mut entered) => self.drain(&mut entered),
                // Whoever is inside looks again when leaving.
                None => {
                    self.signalled.store(true, Ordering::Release);
                    return;
                }
            }
        }
    }

    /// Leaves after a callback of the device's own thread.
    pub(super) fn after_callback(&self) {
        if let Some(mut entered) = self.object.adopt() {
            self.drain(&mut entered);
            self.publish_state(&mut entered);
        }
    }

    /// One step with its timing. Real-time.
    pub(super) fn step(&self, entered: &mut Entered<'_>, tick: &Tick) {
        self.busy_since_ns.store(tick.now_ns, Ordering::Relaxed);
        let before = context::swap_component(Arc::as_ptr(&self.host));
        self.drain(entered);
        if self.is_active() {
            match entered.step(tick) {
                Ok(()) => self.publish_state(entered),
                Err(e) => self.fail(entered, "step", &e),
            }
        }
        context::swap_component(before);
        self.busy_since_ns.store(0, Ordering::Relaxed);
    }

    /// Publishes a row of the state table. Real-time.
    pub(super) fn publish_state(&self, entered: &mut Entered<'_>) {
        if self.state_bytes == 0 {
            return;
        }
        let stamp_ns = os::now_ns();
        entered.with_state(|inner, fill| {
            inner.rows.publish(stamp_ns, inner.cycle, fill);
        });
    }

    /// Everything that can still reach it is told it is gone.
    pub(super) fn close(&self) {
        self.refuse_queued(PEER_LOST);
    }

    /// Where a restarted or failed component stands after `stop`.
    pub(super) fn stopped(&self, reason: StopReason) {
        self.set_state(State::Stopped(reason), "");
    }
}

/// Models whose threads do not look by themselves.
pub(super) fn is_passive(model: Option<ExecutionModel>) -> bool {
    model == Some(ExecutionModel::None)
}
