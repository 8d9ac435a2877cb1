//! Making, configuring, running and removing one component.
//!
//! Invariant: no lock is held while component code runs or is waited for; what half exists after a refusal is taken back.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use trocar_model::{ComponentId, Execution, ExecutionModel, Refusal, State, StopReason, Verb, allowed};
use trocar_plugin_api::abi::NOT_ACTIVE;
use trocar_rt::os;

use super::super::Report;
use super::super::executor::Executor;
use super::super::instance::{Entered, Instance};
use super::super::lifecycle::{
    Entry as Done, component_error, configure, make, reset, resume, start, stop, tell_ports, undo_configure,
    undo_start,
};
use super::super::supervise::{Entry, LEAVE_NS, Manners, Ward, give_up, left_behind};
use super::{LocalLcm, Slot};

fn wrong_state(id: &ComponentId, state: State, verb: Verb, why: String) -> Refusal {
    Refusal::WrongState { id: id.clone(), state, verb, allowed: allowed(state), why }
}

/// Longest wait for a component that is being removed, before its thread is left behind.
const HUNG: Duration = Duration::from_secs(1);
/// A moment on the monotonic clock that does not come, ns.
const NEVER_NS: u64 = u64::MAX / 4;

impl LocalLcm {
    pub(super) async fn create(
        &self,
        id: ComponentId,
        component: Box<trocar_model::Component>,
        deadline: Instant,
    ) -> Result<Report, Refusal> {
        if self.held().components.contains_key(&id) {
            return Err(Refusal::ComponentExists { id });
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
        let (info, process) = (component.class.clone(), self.hub.process.clone());
        let loading = tokio::task::spawn_blocking(move || classes.load(&info));
        let class = match tokio::time::timeout_at(deadline.into(), loading).await {
            Ok(Ok(loaded)) => loaded?,
            Ok(Err(e)) => return Err(Refusal::Internal { text: format!("loading panicked: {e}") }),
            Err(_) => {
                return Err(Refusal::LcmTimeout { process, what: format!("loading the class of {id}") });
            }
        };
        let execution = component.execution.clone();
        let executor = self.executor_for(&id, &execution)?;
        let number = self.next_number.fetch_add(1, Ordering::Relaxed);
        let class_info = component.class.clone();
        let made =
            Instance::new(number, id.clone(), class_info, class, self.hub.clone(), &execution, &executor.0);
        self.roster.add(Ward::new(made.clone(), executor.0.clone()));
        self.hub.logs.name(number, Some(&id));
        let slot = Slot { instance: made, executor: executor.0, execution, config: None };
        let done = self.inside(&slot, Entry::Create, deadline, make).await;
        match done {
            Ok(Ok(())) => {
                slot.instance.set_thread_warnings(slot.executor.settings.warnings());
                self.lock_pools(&slot.instance);
                let report = slot.instance.report(true);
                self.held().components.insert(id, slot.clone());
                self.reorder(&slot);
                Ok(report)
            }
            Ok(Err((entry, e))) => {
                self.abandon(&slot, executor.1);
                Err(component_error(&id, entry, e))
            }
            Err(refusal) => {
                self.abandon(&slot, executor.1);
                Err(refusal)
            }
        }
    }

    fn abandon(&self, slot: &Slot, own: bool) {
        self.hub.logs.name(slot.instance.number, None);
        self.roster.remove(slot.instance.number);
        let instance = slot.instance.clone();
        // A create that comes back after its caller gave up leaves nothing behind.
        slot.executor.submit(move |_| {
            if let Some(mut entered) = instance.object.try_enter() {
                instance.as_running(Entry::Destroy, || instance.destroy(&mut entered));
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
        Executor::spawn(id.component.as_str(), execution, &self.memory)
            .map(|e| (e, true))
            .map_err(|e| Refusal::Internal { text: format!("no thread for {id}: {e}") })
    }

    pub(super) async fn configure(
        &self,
        id: &ComponentId,
        to: &serde_json::Value,
        (from_state, to_state): (State, State),
        deadline: Instant,
    ) -> Result<Report, Refusal> {
        let slot = self.slot(id)?;
        if to_state == State::Created {
            // The undoing of a Create takes its configuration back; the instance goes next.
            slot.instance.set_state_from(State::Ready, State::Created, "");
            return Ok(slot.instance.report(true));
        }
        let json = to.to_string();
        let (given, before) = (json.clone(), slot.config.clone());
        let work = move |instance: &Instance, entered: &mut Entered<'_>| {
            // It may have failed, or have been stopped, while this waited for its turn.
            let stands = instance.state();
            let fits = stands == from_state && stands != State::Fault;
            (stands, fits.then(|| configure(instance, entered, &given, to_state)))
        };
        let undo =
            move |instance: &Instance, entered: &mut Entered<'_>, (from, done): (State, Option<Done>)| {
                if let Some(Ok(())) = done {
                    undo_configure(instance, entered, before.as_deref(), from);
                }
            };
        let (stands, done) = self.inside_or(&slot, Entry::Configure, deadline, work, undo).await?;
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
        deadline: Instant,
    ) -> Result<Report, Refusal> {
        let slot = self.slot(id)?;
        let config = slot.config.clone();
        let entry = match verb {
            Verb::Stop => return self.stop(&slot, deadline).await,
            Verb::Resume => Entry::Resume,
            Verb::Reset => Entry::Create,
            Verb::Start | Verb::Configure | Verb::Remove => Entry::Start,
        };
        let work = move |instance: &Instance, entered: &mut Entered<'_>| {
            let from = instance.state();
            let done = match verb {
                // It failed while this waited for its turn.
                Verb::Start | Verb::Resume if from == State::Fault => return (from, None),
                Verb::Start => start(instance, entered),
                Verb::Resume => resume(instance, entered),
                Verb::Reset => reset(instance, entered, config.as_deref()),
                Verb::Stop | Verb::Configure | Verb::Remove => Ok(()),
            };
            (from, Some(done))
        };
        let undo = move |instance: &Instance,
                         entered: &mut Entered<'_>,
                         (from, done): (State, Option<Done>)| match verb {
            _ if done.is_none() => {}
            Verb::Start | Verb::Resume => undo_start(instance, entered, from),
            // There is no way back to the instance that was; the new one stands still, and that was told.
            _ => tell_ports(instance),
        };
        let (stands, done) = self.inside_or(&slot, entry, deadline, work, undo).await?;
        let Some(done) = done else {
            return Err(wrong_state(id, stands, verb, "it failed before this came to its turn".into()));
        };
        match done {
            Ok(()) => {
                slot.executor.waker.notify();
                self.lock_pools(&slot.instance);
                let lost_connections = self.cut_lost(&slot.instance);
                Ok(Report { lost_connections, ..slot.instance.report(true) })
            }
            Err((entry, e)) => Err(component_error(id, entry, e)),
        }
    }

    /// Acts first: no further step begins once this returns or times out.
    async fn stop(&self, slot: &Slot, deadline: Instant) -> Result<Report, Refusal> {
        if slot.instance.is_active() {
            slot.instance.stopped(StopReason::Requested);
        }
        // At once: its thread may be inside somebody else, and nothing that waits will be run any more.
        slot.instance.refuse_queued(NOT_ACTIVE);
        let work = |instance: &Instance, entered: &mut Entered<'_>| match instance.state() {
            // Never started, or a start that came too late was taken back.
            State::Created | State::Ready => Ok(()),
            _ => stop(instance, entered),
        };
        let done = self.inside(slot, Entry::Stop, deadline, work).await;
        match done {
            Ok(Ok(())) => Ok(slot.instance.report(false)),
            Ok(Err((entry, e))) => Err(component_error(&slot.instance.id, entry, e)),
            Err(refusal) => {
                let holder = self.holder_of(slot);
                let whose = holder.map_or("its own code".to_owned(), |id| format!("the code of {id}"));
                let why = format!("stop: it did not come back; its thread is inside {whose}");
                slot.instance.set_state(State::Fault, &why);
                if slot.instance.is_actuator() {
                    give_up(&Ward::new(slot.instance.clone(), slot.executor.clone()));
                }
                Err(refusal)
            }
        }
    }

    /// Another component whose code has this one's thread now.
    fn holder_of(&self, slot: &Slot) -> Option<ComponentId> {
        let held = self.held();
        let mut others = held.components.values().filter(|s| s.executor.id == slot.executor.id);
        if slot.instance.watch.busy().is_some() {
            return None;
        }
        others.find(|s| s.instance.watch.busy().is_some()).map(|s| s.instance.id.clone())
    }

    /// What to say of threads that a removed component left running, after some time to end.
    async fn leftovers(&self, slot: &Slot) -> Option<String> {
        let ward = Ward::new(slot.instance.clone(), slot.executor.clone());
        let others = self.held().components.values().map(|s| s.executor.tid()).collect::<Vec<_>>();
        let executors = others.into_iter().chain([slot.executor.tid()]).collect();
        let until = Instant::now() + Duration::from_nanos(LEAVE_NS);
        loop {
            let left = left_behind(&ward, &executors);
            if left.is_empty() {
                return None;
            }
            if Instant::now() >= until {
                let (id, n, left) = (&slot.instance.id, left.len(), left.join(", "));
                let text = format!("{id} is removed, and {n} of its own threads still run: {left}");
                log::warn!("{text}");
                return Some(text);
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    pub(super) async fn destroy(&self, id: &ComponentId, deadline: Instant) -> Result<Report, Refusal> {
        let slot = self.slot(id)?;
        let mut report = slot.instance.report(false);
        let patience = deadline.min(Instant::now() + HUNG);
        let number = slot.instance.number;
        let (tell, told) = oneshot::channel();
        let ward = Ward::new(slot.instance.clone(), slot.executor.clone());
        // Done whenever its thread comes to it, also long after its remover has given up.
        slot.executor.submit(move |crew| {
            crew.members.retain(|m| m.instance.number != number);
            end(&ward.instance, crew.members.is_empty());
            // Else its remover looks for them, and gives them time to end.
            let late = tell.send(()).is_err();
            if late && !left_behind(&ward, &[ward.executor.tid()].into()).is_empty() {
                ward.instance.hub.bury(ward.instance.clone(), "threads of its own still run");
            }
        });
        let done = tokio::time::timeout_at(patience.into(), told).await.is_ok();
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
            // They may hold what the host gave it.
            self.hub.bury(slot.instance, "threads of its own still run");
            report.warnings.push(left);
        }
        Ok(report)
    }

    /// A component that is removed although its thread does not come back; what is to be said of that.
    fn leave_behind(&self, slot: &Slot) -> String {
        let (instance, id) = (&slot.instance, &slot.instance.id);
        let whose = self.holder_of(slot).map_or("its own code".to_owned(), |id| format!("the code of {id}"));
        let why = format!("its thread has not come back out of {whose}");
        if instance.is_actuator() && instance.set_state_from(State::Active, State::Fault, &why) {
            give_up(&Ward::new(instance.clone(), slot.executor.clone()));
        }
        instance.close();
        format!(
            "{id} is removed, but {why}: it is stopped and destroyed when that comes back, and kept until then"
        )
    }
}

/// Stops and destroys one that is removed, on its own thread. `alone`: nobody else runs there.
fn end(instance: &Arc<Instance>, alone: bool) {
    // A caller's thread, or one of its device, may be inside. Others on this thread are not to wait for that for ever.
    let until_ns = if alone { NEVER_NS } else { os::now_ns() + HUNG.as_nanos() as u64 };
    let Some(mut entered) = instance.object.enter_until(until_ns) else {
        instance.hub.bury(instance.clone(), "somebody has not come back out of it");
        return;
    };
    let manners = Manners::before(instance);
    instance.as_running(Entry::Destroy, || {
        if instance.is_active() {
            instance.stopped(StopReason::Requested);
            // It goes away either way; the reason was logged.
            let _ = stop(instance, &mut entered);
        }
        instance.pay_safe(&mut entered);
        instance.close();
        instance.destroy(&mut entered);
    });
    manners.after(instance, Entry::Destroy);
    // Whoever queued something meanwhile is answered.
    instance.leave(entered);
}
