//! A host asked from inside its own program: the operations of the gRPC port as methods, without a port.
//!
//! Invariant: the same requests to the same GCM as from outside, with the same checks; nothing here decides.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde_json::Value;
use tokio::sync::mpsc;
use trocar_model::{
    Change, Component, ComponentId, ConnectOptions, ConnectionId, Execution, MemberId, Name, PortId, Refusal,
    Request, State, Target, Which,
};

use super::Host;
use crate::gcm::{ExecuteOptions, Executed, Gcm};
use crate::lcm::{Detail, Invoke, Item, Lcm, Payload, Reply, Sample, Selection, When};

/// Name of the caller in the audit line.
const IDENTITY: &str = "its own program";
/// Time a call or a read gets.
const WITHIN: Duration = Duration::from_secs(1);

impl Host {
    /// Carries out one request; 5 s at most.
    ///
    /// # Errors
    /// The refusal of the plan or of a component; nothing has changed then. ManagedElsewhere for a host that
    /// is attached to another process's GCM.
    pub async fn execute(&self, request: Request) -> Result<Executed, Refusal> {
        self.apply(vec![request]).await
    }

    /// Carries out several requests as one: all, or nothing.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn apply(&self, requests: Vec<Request>) -> Result<Executed, Refusal> {
        let gcm = self.manager()?.clone();
        let options = ExecuteOptions { identity: IDENTITY.into(), ..ExecuteOptions::default() };
        // A caller that goes away must not leave a change half made.
        let running = tokio::spawn(async move { gcm.execute(requests, options).await });
        running
            .await
            .unwrap_or_else(|e| Err(Refusal::Internal { text: format!("the request panicked: {e}") }))
    }

    /// Decides what [`Host::apply`] would do, and does not do it: [`Executed::plan`] has the changes.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn dry_run(&self, requests: Vec<Request>) -> Result<Executed, Refusal> {
        let options =
            ExecuteOptions { validate_only: true, identity: IDENTITY.into(), ..ExecuteOptions::default() };
        self.manager()?.execute(requests, options).await
    }

    /// Creates the component `process/name`; settings that `config` leaves out take their defaults.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn create(&self, path: &str, class: &str, config: Value) -> Result<Executed, Refusal> {
        self.create_with(path, class, config, Execution::default()).await
    }

    /// Creates a component with execution settings of its own.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn create_with(
        &self,
        path: &str,
        class: &str,
        config: Value,
        execution: Execution,
    ) -> Result<Executed, Refusal> {
        let id = ComponentId::parse(path)?;
        self.execute(Request::Create { id, class: class.into(), config: Some(config), execution }).await
    }

    /// Changes settings: `patch` is a JSON merge patch.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn configure(&self, path: &str, patch: Value) -> Result<Executed, Refusal> {
        self.execute(Request::Configure { id: ComponentId::parse(path)?, patch, execution: None }).await
    }

    /// Changes settings, and where the component's thread comes from; unset fields of `execution` keep their
    /// values. A change of `execution` makes the component anew.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn configure_with(
        &self,
        path: &str,
        patch: Value,
        execution: Execution,
    ) -> Result<Executed, Refusal> {
        let (id, execution) = (ComponentId::parse(path)?, Some(execution));
        self.execute(Request::Configure { id, patch, execution }).await
    }

    /// Starts a component, or all that match, such as `host/**`.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn start(&self, path: &str) -> Result<Executed, Refusal> {
        self.execute(Request::Start { targets: targets(path)? }).await
    }

    /// Stops a component, or all that match; what could not be stopped is in [`Executed::failed`].
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn stop(&self, path: &str) -> Result<Executed, Refusal> {
        self.execute(Request::Stop { targets: targets(path)? }).await
    }

    /// Goes on from a stop with the run-time state that is there.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn resume(&self, path: &str) -> Result<Executed, Refusal> {
        self.execute(Request::Resume { targets: targets(path)? }).await
    }

    /// Makes a component anew with the same configuration.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn reset(&self, path: &str) -> Result<Executed, Refusal> {
        self.execute(Request::Reset { targets: targets(path)? }).await
    }

    /// Removes a component that nothing is connected to.
    ///
    /// # Errors
    /// As [`Host::execute`]; with connections, these are named.
    pub async fn remove(&self, path: &str) -> Result<Executed, Refusal> {
        self.execute(Request::Remove { id: ComponentId::parse(path)?, force: false }).await
    }

    /// Removes a component, its connections first.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn remove_forced(&self, path: &str) -> Result<Executed, Refusal> {
        self.execute(Request::Remove { id: ComponentId::parse(path)?, force: true }).await
    }

    /// Connects an input or required interface (`client`) to an output or provided interface (`server`).
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn connect(&self, client: &str, server: &str) -> Result<ConnectionId, Refusal> {
        self.connect_with(client, server, ConnectOptions::default()).await
    }

    /// Connects with options: queue, deadline, age, …
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn connect_with(
        &self,
        client: &str,
        server: &str,
        options: ConnectOptions,
    ) -> Result<ConnectionId, Refusal> {
        let (client, server) = (PortId::parse(client)?, PortId::parse(server)?);
        let done = self.execute(Request::Connect { client, server, options }).await?;
        let made = done.plan.changes.iter().find_map(|change| match change {
            Change::Connect { connection } => Some(connection.id),
            _ => None,
        });
        made.ok_or_else(|| Refusal::Internal { text: "an accepted Connect made no connection".into() })
    }

    /// Cuts a connection.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn disconnect(&self, id: ConnectionId) -> Result<Executed, Refusal> {
        self.execute(Request::Disconnect { which: Which::Id(id) }).await
    }

    /// Cuts the connection of two ports.
    ///
    /// # Errors
    /// As [`Host::execute`].
    pub async fn disconnect_pair(&self, client: &str, server: &str) -> Result<Executed, Refusal> {
        let (client, server) = (PortId::parse(client)?, PortId::parse(server)?);
        self.execute(Request::Disconnect { which: Which::Pair { client, server } }).await
    }

    /// Calls a command, `process/component/interface/command`, and waits for its answer, 1 s at most.
    /// `Value::Null`: no argument.
    ///
    /// # Errors
    /// The outcome, when it is none of executed and queued.
    pub async fn invoke(&self, path: &str, arg: Value) -> Result<Reply, Refusal> {
        self.call(path, arg, false, WITHIN).await
    }

    /// Calls a command and comes back as soon as it is queued.
    ///
    /// # Errors
    /// As [`Host::invoke`].
    pub async fn send(&self, path: &str, arg: Value) -> Result<Reply, Refusal> {
        self.call(path, arg, true, WITHIN).await
    }

    /// [`Host::invoke`] with a deadline of its own; more than an hour counts as an hour.
    ///
    /// # Errors
    /// As [`Host::invoke`].
    pub async fn invoke_within(&self, path: &str, arg: Value, within: Duration) -> Result<Reply, Refusal> {
        self.call(path, arg, false, within).await
    }

    async fn call(&self, path: &str, arg: Value, send: bool, within: Duration) -> Result<Reply, Refusal> {
        let member = MemberId::parse(path)?;
        let process = member.port.component.process.clone();
        let lcm = self.lcm_of(&process)?;
        let arg = if arg.is_null() { Payload::None } else { Payload::Json(arg) };
        let deadline_ns = u64::try_from(within.as_nanos()).unwrap_or(u64::MAX).max(1);
        let reply = lcm.invoke(Invoke { member, arg, send, deadline_ns }).await;
        if let (Err(_), Some(gcm)) = (&reply, self.gcm()) {
            // A caller that is told that a command panicked finds the component in FAULT.
            gcm.hear_out(&process).await;
        }
        reply
    }

    /// Reads without a command: the state row of a component, or the newest sample of an output.
    ///
    /// # Errors
    /// The refusal names what is not there, and what is.
    pub async fn read(&self, path: &str) -> Result<Sample, Refusal> {
        self.read_at(path, When::Newest).await
    }

    /// [`Host::read`] of an earlier row: at a tick, at a time, or so many rows ago.
    ///
    /// # Errors
    /// As [`Host::read`]; a row that is kept no more, or is not there yet, is refused with those that are.
    pub async fn read_at(&self, path: &str, when: When) -> Result<Sample, Refusal> {
        self.lcm_of(&process_of(path)?)?.read(path.to_owned(), when, false, Instant::now() + WITHIN).await
    }

    /// Follows an event, an output or a component's state until the receiver is dropped. It gives each event
    /// and each change of state, but of an output the newest sample, 30 times a second at most.
    ///
    /// # Errors
    /// As [`Host::read`].
    pub async fn subscribe(&self, path: &str) -> Result<mpsc::Receiver<Item>, Refusal> {
        self.subscribe_at(path, 0.0).await
    }

    /// [`Host::subscribe`] with another limit for an output, samples per second: 0.01 to 1000 Hz; 0 is the
    /// usual one. Samples that are written faster are left out; a component that must have each sample takes
    /// them by a queued input.
    ///
    /// # Errors
    /// As [`Host::read`]; a limit that is negative or no number.
    pub async fn subscribe_at(&self, path: &str, max_rate_hz: f64) -> Result<mpsc::Receiver<Item>, Refusal> {
        if !max_rate_hz.is_finite() || max_rate_hz < 0.0 {
            return Err(Refusal::ArgumentInvalid {
                what: format!("following {path}"),
                why: format!("max_rate_hz is {max_rate_hz}; it is 0 or a number of samples per second"),
                field: "max_rate_hz".into(),
            });
        }
        let selection = Selection { path: path.to_owned(), max_rate_hz, ..Selection::default() };
        self.lcm_of(&process_of(path)?)?.subscribe(vec![selection]).await
    }

    /// Live figures of a component.
    ///
    /// # Errors
    /// ComponentNotFound.
    pub async fn detail(&self, path: &str) -> Result<Detail, Refusal> {
        let id = ComponentId::parse(path)?;
        let mut details = self.lcm_of(&id.process)?.details(vec![id.clone()]).await?;
        let known = || self.gcm().map(|gcm| gcm.graph().components.keys().cloned().collect());
        let missing = || Refusal::ComponentNotFound { id, known: known().unwrap_or_default() };
        details.pop().map(|(_, detail)| detail).ok_or_else(missing)
    }

    /// A component's state as the GCM knows it.
    ///
    /// # Errors
    /// ComponentNotFound, with the names there are.
    pub async fn state(&self, path: &str) -> Result<State, Refusal> {
        self.describe(path).await.map(|c| c.state)
    }

    /// A component as the GCM knows it: class, configuration, ports, state.
    ///
    /// # Errors
    /// ComponentNotFound, with the names there are.
    pub async fn describe(&self, path: &str) -> Result<Component, Refusal> {
        let id = ComponentId::parse(path)?;
        let graph = self.manager()?.graph();
        graph.components.get(&id).cloned().ok_or_else(|| Refusal::ComponentNotFound {
            id,
            known: graph.components.keys().cloned().collect(),
        })
    }

    /// The components that match, such as `host/**`, also when there are none; or the one of this name.
    ///
    /// # Errors
    /// ComponentNotFound for a name, with the names there are.
    pub async fn list(&self, path: &str) -> Result<Vec<ComponentId>, Refusal> {
        let graph = self.manager()?.graph();
        match Target::parse(path)? {
            Target::Glob(pattern) => {
                Ok(graph.components.keys().filter(|id| pattern.matches(id)).cloned().collect())
            }
            Target::One(id) if graph.components.contains_key(&id) => Ok(vec![id]),
            Target::One(id) => {
                Err(Refusal::ComponentNotFound { id, known: graph.components.keys().cloned().collect() })
            }
        }
    }

    /// Waits until a component is in `state`.
    ///
    /// # Errors
    /// NotReached at the end of `within`; ComponentFault at once when it goes into FAULT instead;
    /// ComponentNotFound.
    pub async fn wait_for(&self, path: &str, state: State, within: Duration) -> Result<(), Refusal> {
        let id = ComponentId::parse(path)?;
        self.manager()?.wait_for(&id, &[state], Instant::now() + within).await.map(drop)
    }

    /// Waits until a component sends an event, `process/component/interface/event`, after this is called.
    ///
    /// # Errors
    /// EventNotSeen at the end of `within`; ComponentFault and ComponentNotFound at once, when
    /// it cannot come.
    pub async fn wait_for_event(&self, path: &str, within: Duration) -> Result<Item, Refusal> {
        let member = MemberId::parse(path)?;
        self.manager()?.listen(&member, Instant::now() + within).await?.event().await
    }

    /// Calls a command and waits for the event it leads to, which is listened for before the call.
    ///
    /// # Errors
    /// As [`Host::invoke`] and [`Host::wait_for_event`].
    pub async fn invoke_and_wait(
        &self,
        path: &str,
        arg: Value,
        event: &str,
        within: Duration,
    ) -> Result<Item, Refusal> {
        let member = MemberId::parse(event)?;
        let listening = self.manager()?.listen(&member, Instant::now() + within).await?;
        self.call(path, arg, false, within).await?;
        listening.event().await
    }

    fn manager(&self) -> Result<&Gcm, Refusal> {
        self.still_here()?;
        self.gcm()
            .ok_or_else(|| Refusal::ManagedElsewhere { at: self.managed_by().unwrap_or_default().to_owned() })
    }

    /// # Errors
    /// ProcessLost once it was shut down.
    fn still_here(&self) -> Result<(), Refusal> {
        match self.lcm() {
            Some(lcm) if self.has_ended() => Err(Refusal::lost(lcm.process().clone())),
            _ => Ok(()),
        }
    }

    /// The LCM of a process: any process for a host with a GCM, its own otherwise.
    fn lcm_of(&self, process: &Name) -> Result<Arc<dyn Lcm>, Refusal> {
        self.still_here()?;
        match (self.gcm(), self.lcm()) {
            (Some(gcm), _) => gcm.lcm_of(process),
            (None, Some(lcm)) if lcm.process() == process => Ok(lcm.clone()),
            (None, lcm) => Err(Refusal::ProcessNotFound {
                process: process.clone(),
                known: lcm.iter().map(|lcm| lcm.process().clone()).collect(),
            }),
        }
    }
}

fn targets(path: &str) -> Result<Vec<Target>, Refusal> {
    Ok(vec![Target::parse(path)?])
}

fn process_of(path: &str) -> Result<Name, Refusal> {
    Name::parse(path.split('/').next().unwrap_or_default())
        .map_err(|_| Refusal::BadPath { text: path.into(), why: "it begins with no process name".into() })
}
