//! Making, configuring, running and removing one component.
//!
//! Invariant: no lock is held while component code runs or is waited for; parts made before a refusal are
//! removed again.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use trocar_lcm_api::{Halted, News, Order, Stop};
use trocar_model::{
    ClassInfo, ComponentId, Execution, ExecutionModel, Health, Refusal, State, StopReason, Verb, allowed,
};
use trocar_rt::os;

use super::super::Report;
use super::super::boundary::{EntryResult, LoadedClass};
use super::super::classes::Classes;
use super::super::executor::Executor;
use super::super::instance::{Entered, Instance};
use super::super::lifecycle::{
    Ran, RunResult, component_error, configure, make, reset, resume, start, stop, tell_ports, undo_configure,
    undo_start,
};
use super::super::supervise::{Guarded, LEAVE_NS, Manners, Strangers, cannot_go_on, give_up};
use super::super::watch::{Busy, Entry};
use super::{LocalLcm, Slot, join_all};

fn wrong_state(id: &ComponentId, state: State, verb: Verb, why: String) -> Refusal {
    Refusal::WrongState { id: id.clone(), state, verb, allowed: allowed(state), why }
}

/// Refuses while a required port has lost its connection: the component would be stopped again as soon as
/// that is seen.
fn still_connected(instance: &Instance, verb: Verb) -> Result<(), Refusal> {
    let ports: Vec<String> = instance.missing().into_iter().map(|(port, _)| port).collect();
    if ports.is_empty() { Ok(()) } else { Err(Refusal::Unconnected { id: instance.id.clone(), verb, ports }) }
}

/// Longest wait for a component that is being removed, before its thread is left behind; and for one that is
/// being stopped, from when it was found unresponsive.
const HUNG: Duration = Duration::from_secs(1);
/// Reason why a removed component is not destroyed.
const STRAYS: &str = "threads of its own still run";
/// Likewise, of one that no thread was left to destroy.
const BROKE: &str = "its thread broke down before that";
/// Time between two looks whether that still holds.
const LOOK: Duration = Duration::from_millis(10);
/// A moment on the monotonic clock that never comes, ns.
const NEVER_NS: u64 = u64::MAX / 4;

/// Keeps a component until the process ends.
fn retire(instance: &Arc<Instance>, why: &str) {
    instance.hub.retire(instance.number, &instance.id, instance.clone(), why);
}

/// Ends the process, or leaves it unfit, after a thread of components broke down.
fn broken(member: &Instance, why: String) {
    cannot_go_on(&member.hub, why);
}

impl LocalLcm {
    pub(super) async fn create(
        &self,
        id: ComponentId,
        component: Box<trocar_model::Component>,
        order: &Order,
    ) -> Result<Report, Refusal> {
        {
            let held = self.held();
            if held.closed {
                return Err(Refusal::lost(self.hub.process.clone()));
            }
            if held.components.contains_key(&id) {
                return Err(Refusal::ComponentExists { id });
            }
        }
        let Some(classes) = self.classes.clone() else {
            return Err(Refusal::NotImplemented {
                what: format!(
                    "creating {} in a process without plugin directories",
                    component.class.full_name()
                ),
                hint: "start the host with --plugins DIR".into(),
            });
        };
        self.lets_in(classes.as_ref(), &component.class)?;
        let class = self.load(classes, &component.class, &id, order.deadline).await?;
        let execution = component.execution.clone();
        let (executor, own) = self.executor_for(&id, &execution)?;
        let number = self.next_number.fetch_add(1, Ordering::Relaxed);
        let made = Instance::new(
            (number, id.clone()),
            (component.class.clone(), class),
            (self.hub.clone(), self.remains.clone()),
            &execution,
            executor.thread(),
        );
        let instance = made.map_err(|no_room| {
            if own {
                executor.close();
            }
            no_room.refusal(&id)
        })?;
        self.roster.add(Guarded::new(instance.clone(), executor.clone()));
        self.hub.logs.name(number, Some(&id));
        let slot = Slot { instance, executor, execution, config: None, phase: None };
        let done = self.inside(&slot, Entry::Create, order, make).await;
        let kept = match done {
            Ok(Ok(())) => self.take_in(id, &slot),
            // There is no component that could be in FAULT; a panic is reported as everywhere.
            Ok(Err((entry, e))) if e.panicked() => Err(component_error(&id, entry, e)),
            Ok(Err((entry, e))) => Err(Refusal::ComponentRefused { id, entry, text: e.text }),
            Err(refusal) => Err(refusal),
        };
        kept.inspect_err(|_| self.abandon(&slot, own))
    }

    /// Loads a class on a thread that may wait.
    async fn load(
        &self,
        classes: Arc<dyn Classes>,
        class: &Arc<ClassInfo>,
        id: &ComponentId,
        deadline: Instant,
    ) -> Result<LoadedClass, Refusal> {
        let (info, process) = (class.clone(), self.hub.process.clone());
        let loading = tokio::task::spawn_blocking(move || classes.load(&info));
        match tokio::time::timeout_at(deadline.into(), loading).await {
            Ok(Ok(loaded)) => loaded,
            Ok(Err(e)) => Err(Refusal::Internal { text: format!("loading panicked: {e}") }),
            Err(_) => Err(Refusal::LcmTimeout { process, what: format!("loading the class of {id}") }),
        }
    }

    /// Takes a component that was made into the list.
    ///
    /// # Errors
    /// This LCM was closed meanwhile, or has another one of that name.
    fn take_in(&self, id: ComponentId, slot: &Slot) -> Result<Report, Refusal> {
        slot.instance.threads.set_settings(slot.executor.settings.clone());
        self.lock_pools(&slot.instance);
        let report = slot.instance.report(true);
        let mut held = self.held();
        if held.closed {
            return Err(Refusal::lost(self.hub.process.clone()));
        }
        // Another Create of it, of a later session, was faster.
        if held.components.contains_key(&id) {
            return Err(Refusal::ComponentExists { id });
        }
        let mut kept = slot.clone();
        kept.give_phase(held.phases.get(&id));
        held.components.insert(id, kept);
        drop(held);
        self.reorder(slot);
        Ok(report)
    }

    fn abandon(&self, slot: &Slot, own: bool) {
        self.hub.logs.name(slot.instance.number, None);
        self.roster.remove(slot.instance.number);
        let instance = slot.instance.clone();
        // A create that returns after its caller gave up leaves nothing behind.
        slot.executor.submit(move |_| {
            if let Some(mut entered) = instance.object.try_enter() {
                instance.destroy(&mut entered);
            }
        });
        if own {
            slot.executor.close();
        }
    }

    /// The thread a component will run on, and whether it is its own.
    fn executor_for(
        &self,
        id: &ComponentId,
        execution: &Execution,
    ) -> Result<(Arc<Executor>, bool), Refusal> {
        if let Some(other) = execution.stream_of.as_ref().or(execution.inside.as_ref()) {
            let slot = self.slot(&ComponentId::parse(other)?)?;
            if execution.inside.is_some() && slot.execution.model == Some(ExecutionModel::OnCallback) {
                return Err(Refusal::ArgumentInvalid {
                    what: format!("Create {id}"),
                    why: format!(
                        "inside: {other} is called by threads of its device (on_callback); there is no step to run in"
                    ),
                    field: "execution.inside".into(),
                });
            }
            return Ok((slot.executor, false));
        }
        Executor::spawn(id.component.as_str(), execution, &self.memory, broken)
            .map(|e| (e, true))
            .map_err(|e| Refusal::NoThread { id: id.clone(), why: e.to_string() })
    }

    pub(super) async fn configure(
        &self,
        id: &ComponentId,
        to: &serde_json::Value,
        (from_state, to_state): (State, State),
        order: &Order,
    ) -> Result<Report, Refusal> {
        let slot = self.slot(id)?;
        if to_state == State::Created {
            // The undoing of a Create reverts the configuration; the instance is removed next.
            slot.instance.set_state_from(State::Ready, State::Created, "");
            return Ok(slot.instance.report(true));
        }
        let json = to.to_string();
        let (given, before, former) = (json.clone(), slot.config.clone(), slot.config.clone());
        let work = move |instance: &Instance, entered: &mut Entered<'_>| {
            // The component may have failed, or have been stopped, while this waited for its turn.
            let stands = instance.state();
            let fits = stands == from_state && stands != State::Fault;
            (stands, fits.then(|| configure(instance, entered, &given, former.as_deref(), to_state)))
        };
        let undo = move |instance: &Instance,
                         entered: &mut Entered<'_>,
                         (from, done): (State, Option<EntryResult>)| {
            if let Some(Ok(())) = done {
                undo_configure(instance, entered, before.as_deref(), from);
            }
        };
        let (stands, done) = self.inside_or(&slot, Entry::Configure, order, work, undo).await?;
        let Some(done) = done else {
            let why = format!("it was {from_state} when this was decided");
            return Err(wrong_state(id, stands, Verb::Configure, why));
        };
        done.map_err(|(entry, e)| component_error(id, entry, e))?;
        if let Some(slot) = self.held().components.get_mut(id) {
            slot.config = Some(json);
        }
        self.lock_pools(&slot.instance);
        let lost_connections = self.cut_lost(&slot.instance);
        Ok(Report { lost_connections, ..slot.instance.report(true) })
    }

    pub(super) async fn run_verb(
        &self,
        id: &ComponentId,
        verb: Verb,
        order: &Order,
    ) -> Result<Report, Refusal> {
        let slot = self.slot(id)?;
        let entry = match verb {
            Verb::Stop => {
                goes_on_no_more(&slot);
                return self.stop_one(&slot, order.deadline).await;
            }
            Verb::Remove => {
                slot.instance.set_going(true);
                return self.stop_one(&slot, order.deadline).await;
            }
            Verb::Resume => Entry::Resume,
            Verb::Reset => Entry::Create,
            Verb::Start | Verb::Configure => Entry::Start,
        };
        let moves = matches!(verb, Verb::Start | Verb::Resume);
        if moves && slot.instance.is_actuator() {
            still_connected(&slot.instance, verb)?;
        }
        let (stands, done) = self.drive(&slot, verb, entry, order).await?;
        let Some(done) = done else {
            return Err(wrong_state(id, stands, verb, "it failed before this came to its turn".into()));
        };
        if let Ran::HeldOff(why) = done.map_err(|(entry, e)| component_error(id, entry, e))? {
            return Err(wrong_state(id, slot.instance.state(), verb, why.into()));
        }
        // The component was stopped again at once: no caller may be told that it runs.
        if moves && slot.instance.state() == State::Stopped(StopReason::PeerLost) {
            still_connected(&slot.instance, verb)?;
            let why = "what it requires went away while it was being set in motion".to_owned();
            return Err(wrong_state(id, slot.instance.state(), verb, why));
        }
        slot.executor.waker.notify();
        if verb == Verb::Reset {
            self.other_code(&slot.instance).iter().for_each(|text| slot.instance.warn(text));
        }
        self.lock_pools(&slot.instance);
        let lost_connections = self.cut_lost(&slot.instance);
        Ok(Report { lost_connections, ..slot.instance.report(true) })
    }

    /// Starts, resumes or resets a component on its own thread. Its state before, and the result; no result
    /// where it had failed before this came to its turn.
    async fn drive(
        &self,
        slot: &Slot,
        verb: Verb,
        entry: Entry,
        order: &Order,
    ) -> Result<(State, Option<RunResult>), Refusal> {
        let (config, ordered) = (slot.config.clone(), order.clone());
        let guarded = Guarded::new(slot.instance.clone(), slot.executor.clone());
        let alone = self.is_alone(slot);
        let work = move |instance: &Instance, entered: &mut Entered<'_>| {
            let from = instance.state();
            let done = match verb {
                // The component failed while this waited for its turn.
                Verb::Start | Verb::Resume if from == State::Fault => return (from, None),
                Verb::Start => start(instance, entered, &ordered),
                Verb::Resume => resume(instance, entered, &ordered),
                Verb::Reset => reset(instance, entered, config.as_deref(), || outlasts(&guarded, alone))
                    .map(|()| Ran::Runs),
                Verb::Stop | Verb::Configure | Verb::Remove => Ok(Ran::Runs),
            };
            (from, Some(done))
        };
        let undo = move |instance: &Instance,
                         entered: &mut Entered<'_>,
                         (from, done): (State, Option<RunResult>)| match verb {
            _ if matches!(done, None | Some(Ok(Ran::HeldOff(_)))) => {}
            Verb::Start | Verb::Resume => undo_start(instance, entered, from),
            // There is no way back to the former instance; the new one does not run, and that was reported.
            _ => tell_ports(instance),
        };
        self.inside_or(slot, entry, order, work, undo).await
    }

    /// A warning that Reset keeps the code of the Create, if the plugin's file has changed since.
    fn other_code(&self, instance: &Instance) -> Option<String> {
        let (info, id) = (&instance.info, &instance.id);
        let classes = self.classes.as_ref()?.catalog();
        let other = classes.iter().find(|class| class.full_name() == info.full_name())?;
        (other.hash != info.hash).then(|| {
            let short = |hash: &str| hash.chars().take(8).collect::<String>();
            format!(
                "reset: it is made again from the code it was created with, plugin {} {} ({}); the file is {} ({}) now: \
                 remove and create {id} to take that",
                info.plugin,
                info.version,
                short(&info.hash),
                other.version,
                short(&other.hash),
            )
        })
    }

    /// Stops what is named now, and holds off what was decided before and would set it in motion later.
    pub(super) async fn halt(&self, stop: &Stop, order: &Order) -> Vec<Halted> {
        if let Some(told) = self.hub.latches.stop(stop, order.decision) {
            // A failure is fine without listeners: the inventory has it.
            let _ = self.hub.news.send(News::StoppedHere(told));
        }
        let named: Vec<(ComponentId, Slot)> = {
            let held = self.held();
            let is_named = |id: &ComponentId| stop.targets.iter().any(|target| target.names(id));
            held.components
                .iter()
                .filter(|(id, _)| is_named(id))
                .map(|(id, s)| (id.clone(), s.clone()))
                .collect()
        };
        join_all(named.into_iter().map(async |(id, slot)| {
            let was = slot.instance.state();
            // Somebody who knew of this Stop has started it.
            if was == State::Active && slot.instance.started_by() > order.decision.0 {
                return Halted { id, was, done: Ok(slot.instance.report(false)) };
            }
            goes_on_no_more(&slot);
            // A Start under way takes itself back, and is waited for, as is a stop under way.
            let done = match runs(&slot, was) {
                true => self.stop_one(&slot, order.deadline).await,
                false => Ok(slot.instance.report(false)),
            };
            Halted { id, was, done }
        }))
        .await
    }

    /// Acts first: no further step begins once this returns or times out.
    async fn stop_one(&self, slot: &Slot, deadline: Instant) -> Result<Report, Refusal> {
        if slot.instance.is_active() {
            slot.instance.stopped(StopReason::Requested);
        }
        // Done at once: its thread may be inside another component, and no waiting call will be run any more.
        slot.instance.refuse_queued(slot.instance.turned_away());
        let work = |instance: &Instance, entered: &mut Entered<'_>| match instance.state() {
            // Never started, or a start that came too late was reverted.
            State::Created | State::Ready if !entered.inner().to_stop => Ok(()),
            // At the end of a host all are stopped: a component that has stopped already does not stop again.
            State::Stopped(_) if !entered.inner().to_stop => Ok(()),
            _ => stop(instance, entered),
        };
        let order = Order::from(deadline);
        let done = tokio::select! {
            biased;
            done = self.inside(slot, Entry::Stop, &order, work) => done,
            () = hangs(slot) => {
                let (process, what) = (self.hub.process.clone(), format!("stop of {}", slot.instance.id));
                Err(Refusal::LcmTimeout { process, what })
            }
        };
        match done {
            Ok(Ok(())) => Ok(slot.instance.report(false)),
            Ok(Err((entry, e))) => Err(component_error(&slot.instance.id, entry, e)),
            Err(refusal) => {
                let why = format!("stop: it did not come back; its thread is inside {}", self.held_by(slot));
                slot.instance.set_state(State::Fault, &why);
                if slot.instance.is_actuator() {
                    give_up(&Guarded::new(slot.instance.clone(), slot.executor.clone()));
                }
                Err(refusal)
            }
        }
    }

    /// Names the component whose code does not return and holds this one's thread.
    fn held_by(&self, slot: &Slot) -> String {
        match (self.holder_of(slot), slot.instance.watch.busy()) {
            (Some(id), _) => format!("the code of {id}"),
            (None, Some(busy)) => format!("its own code ({})", busy.entry.name()),
            (None, None) => "its own code".to_owned(),
        }
    }

    /// Another component whose code runs on this one's thread now.
    fn holder_of(&self, slot: &Slot) -> Option<ComponentId> {
        let held = self.held();
        let mut others = held.components.values().filter(|s| s.executor.id == slot.executor.id);
        if slot.instance.watch.busy().is_some() {
            return None;
        }
        others.find(|s| s.instance.watch.busy().is_some()).map(|s| s.instance.id.clone())
    }

    /// Warning about threads that a removed component left running, after some time to end.
    async fn leftovers(&self, slot: &Slot) -> Option<String> {
        let guarded = Guarded::new(slot.instance.clone(), slot.executor.clone());
        let until = Instant::now() + Duration::from_nanos(LEAVE_NS);
        loop {
            let left = Strangers::look().left_behind(&guarded);
            if left.is_empty() {
                return None;
            }
            if Instant::now() >= until {
                let (id, n, left) = (&slot.instance.id, left.len(), left.join(", "));
                let text = format!(
                    "{id} is removed, and {n} of its own threads still run: {left}; what they may use is kept until the \
                     process ends"
                );
                log::warn!("{text}");
                return Some(text);
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    /// Tells whether no other component runs on its thread.
    fn is_alone(&self, slot: &Slot) -> bool {
        self.held().components.values().filter(|s| s.executor.id == slot.executor.id).count() == 1
    }

    pub(super) async fn destroy(&self, id: &ComponentId, deadline: Instant) -> Result<Report, Refusal> {
        let slot = self.slot(id)?;
        let mut report = slot.instance.report(false);
        slot.instance.set_going(true);
        let patience = deadline.min(Instant::now() + HUNG);
        let number = slot.instance.number;
        let (tell, told) = oneshot::channel();
        let guarded = Guarded::new(slot.instance.clone(), slot.executor.clone());
        // Its thread does this whenever it comes to it, also long after the remover has given up.
        slot.executor.submit(move |crew| {
            crew.members.retain(|m| m.instance.number != number);
            end(&guarded, crew.members.is_empty());
            // Otherwise the remover looks for such threads, and gives them time to end.
            let late = tell.send(()).is_err();
            if late && !Strangers::look().left_behind(&guarded).is_empty() {
                retire(&guarded.instance, STRAYS);
            }
        });
        let told = tokio::time::timeout_at(patience.into(), told).await;
        if let Ok(Err(_)) = told
            && slot.instance.object.is_made()
        {
            // The thread ended without it. A peer may be inside still, and owes it that it is made safe.
            retire(&slot.instance, BROKE);
            report.warnings.push(format!("{id} is removed, but not destroyed: {BROKE}"));
        }
        let done = told.is_ok();
        if !done {
            report.warnings.push(self.leave_behind(&slot));
        }
        self.roster.remove(number);
        self.hub.logs.name(number, None);
        {
            let mut held = self.held();
            held.components.remove(id);
            held.leaving.push(slot.instance.clone());
            if !held.components.values().any(|s| s.executor.id == slot.executor.id) {
                slot.executor.close();
            }
        }
        slot.instance.look_at_ports();
        if done && let Some(left) = self.leftovers(&slot).await {
            // These threads may hold what the host gave the component.
            retire(&slot.instance, STRAYS);
            report.warnings.push(left);
        }
        Ok(report)
    }

    /// Removes a component although its thread does not return; returns the warning about it.
    fn leave_behind(&self, slot: &Slot) -> String {
        let (instance, id) = (&slot.instance, &slot.instance.id);
        let why = format!("its thread has not come back out of {}", self.held_by(slot));
        if instance.is_actuator() && instance.set_state_from(State::Active, State::Fault, &why) {
            give_up(&Guarded::new(instance.clone(), slot.executor.clone()));
        }
        instance.close();
        format!(
            "{id} is removed, but {why}: it is stopped and destroyed when that comes back, and kept until then"
        )
    }
}

/// A component that would go on by itself waits for somebody who asks.
fn goes_on_no_more(slot: &Slot) {
    let (from, to) = (State::Stopped(StopReason::Restarted), State::Stopped(StopReason::Requested));
    slot.instance.set_state_from(from, to, "");
}

/// Tells whether the component runs, is being started, or has not been brought to rest since. One in FAULT
/// was made safe when it failed.
fn runs(slot: &Slot, state: State) -> bool {
    let starts = |busy: Busy| matches!(busy.entry, Entry::Start | Entry::Resume);
    match state {
        State::Active => true,
        State::Fault => false,
        State::Created | State::Ready | State::Stopped(_) => {
            slot.instance.is_unsettled() || slot.instance.watch.busy().is_some_and(starts)
        }
    }
}

/// Ends when the component has been unresponsive for so long that no caller should wait for it any more.
async fn hangs(slot: &Slot) {
    let mut since = None;
    loop {
        if slot.instance.watch.health() != Health::Unresponsive {
            since = None;
        } else if since.get_or_insert_with(Instant::now).elapsed() >= HUNG {
            return;
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// Tells whether threads that use the instance still run after the stop; they get some time to end if no
/// other component waits for this thread.
fn outlasts(guarded: &Guarded, alone: bool) -> bool {
    let until = Instant::now() + Duration::from_nanos(if alone { LEAVE_NS } else { 0 });
    while Strangers::look().outlast_stop(guarded) {
        if Instant::now() >= until {
            return true;
        }
        std::thread::sleep(LOOK);
    }
    false
}

/// Stops and destroys a removed component, on its own thread; one whose threads still run is not destroyed
/// but kept. `alone`: no other component runs there.
fn end(guarded: &Guarded, alone: bool) {
    let instance = &guarded.instance;
    // A caller's thread, or one of its device, may be inside. Others on this thread must not wait for that
    // for ever.
    let until_ns = if alone { NEVER_NS } else { os::now_ns() + HUNG.as_nanos() as u64 };
    let Some(mut entered) = instance.object.enter_until(until_ns) else {
        retire(instance, "another thread has not come back out of it");
        return;
    };
    let manners = Manners::before(instance);
    instance.as_running(Entry::Destroy, || {
        if instance.is_active() {
            instance.stopped(StopReason::Requested);
            // The component is removed either way; the reason was logged.
            let _ = stop(instance, &mut entered);
        }
        instance.pay_safe(&mut entered);
        instance.close();
        if outlasts(guarded, alone) {
            retire(instance, STRAYS);
        } else if instance.destroy(&mut entered) {
            // A hanging cycle of another component may keep these slots for long; it must not keep frames of
            // others.
            instance.described.all_slots().iter().for_each(|slots| slots.let_go_of_inputs());
        }
    });
    manners.after(instance, Entry::Destroy);
    // Calls queued meanwhile are answered.
    instance.leave(entered);
}
