//! Guests: places in the graph behind which there is no LCM, such as a shell's.
//!
//! Invariant: nothing is ever called at a guest; its place, and every connection of it, ends with the owner
//! of [`Joined`].

use std::sync::{Arc, LazyLock};

use serde_json::json;
use trocar_lcm_api::Inventory;
use trocar_model::{
    Change, ClassInfo, Component, ComponentId, ConnectOptions, ConnectionId, Execution, ExecutionLimits,
    ExecutionModel, Health, Name, PortId, Ports, Programs, Provided, Refusal, Request, Safety, State,
    SystemGraph,
};

use super::fate::dismiss;
use super::guest_lcm::{GuestLcm, invalid, numbered};
use super::sessions::{Registered, Registration, Slice};
use super::{ExecuteOptions, Gcm};

/// Most guests of a system; each costs little, but a script that joins in a loop should be told.
const MOST: usize = 64;

/// Guest that asks for a place.
#[derive(Clone, Debug)]
pub struct Guest {
    /// Wanted name of its process.
    pub process: Name,
    /// Name of its component.
    pub component: Name,
    /// Name of the program, for people; never empty.
    pub program: String,
    /// 0 = unknown.
    pub pid: u32,
}

/// A place in the graph; it ends when this is dropped.
pub struct Joined {
    gcm: Gcm,
    lcm: Arc<GuestLcm>,
    pub component: ComponentId,
    pub registered: Registered,
}

/// A connection of a guest that was made.
#[derive(Clone, Debug)]
pub struct Requirement {
    pub revision: u64,
    pub client: PortId,
    pub connection: ConnectionId,
    pub provided: Provided,
}

impl Joined {
    /// Ends when the place was ended from outside: the component was removed.
    pub async fn ended(&self) {
        let mut removed = self.lcm.removed();
        // The sender lives as long as this.
        let _ = removed.wait_for(|removed| *removed).await;
    }
}

impl Drop for Joined {
    fn drop(&mut self) {
        self.gcm.leave(&self.component.process, self.registered.session);
    }
}

impl Gcm {
    /// Gives a guest a place under the name it wants, or that name with the first number that is free.
    ///
    /// # Errors
    /// There are too many guests; the epoch cannot be made durable.
    pub async fn join(&self, guest: Guest) -> Result<Joined, Refusal> {
        let guests = self.graph().processes.values().filter(|p| !p.guest.is_empty()).count();
        if guests >= MOST {
            let why = format!("{guests} guests have joined this system, which is the most: end one of them");
            return Err(invalid("Join", why, "process"));
        }
        loop {
            let process = free_name(&self.graph(), &guest.process)?;
            let component = ComponentId::new(process.clone(), guest.component.clone());
            let lcm = Arc::new(GuestLcm::new(component.clone()));
            let mut who = Registration::new(process, String::new());
            (who.pid, who.guest) = (guest.pid, guest.program.clone());
            let of_it = Component {
                class: CLASS.clone(),
                config: json!({}),
                execution: CLASS.execution.clone(),
                ports: Arc::default(),
                state: State::Active,
                health: Health::Ok,
                fault: String::new(),
            };
            who.slice = Slice { components: vec![(component.clone(), of_it)], connections: Vec::new() };
            let inventory = Inventory { components: vec![lcm.report()], ..Inventory::default() };
            match self.register(who, lcm.clone(), inventory).await {
                Ok(registered) => {
                    self.inner.sessions.lock().guests.insert(component.process.clone(), lcm.clone());
                    return Ok(Joined { gcm: self.clone(), lcm, component, registered });
                }
                // Another one has taken the name since.
                Err(Refusal::ProcessExists { .. }) => {}
                Err(refusal) => return Err(refusal),
            }
        }
    }

    /// Adds a required interface with everything a provided one has, and connects them: both, or neither.
    ///
    /// # Errors
    /// The component is no guest's; the provided interface is not there; the name is taken; the Connect is
    /// refused.
    pub async fn require(
        &self,
        component: &ComponentId,
        name: Option<Name>,
        server: &PortId,
        options: ExecuteOptions,
    ) -> Result<Requirement, Refusal> {
        let graph = self.graph();
        graph.component(component)?;
        let Some(lcm) = self.inner.sessions.lock().guests.get(&component.process).cloned() else {
            let why = format!(
                "{component} has the required interfaces of its class: connect those; only guests (Join) add others"
            );
            return Err(invalid("Require", why, "component"));
        };
        let ports = &graph.component(&server.component)?.ports;
        let Some(provided) = ports.provided.iter().find(|p| server.port == p.name.as_str()).cloned() else {
            let known = ports.provided.iter().map(|p| p.name.clone()).collect();
            return Err(Refusal::InterfaceNotFound { port: server.clone(), known });
        };
        let name = lcm.add(name, &provided)?;
        let client = component.port(name.clone());
        // The plan is made from the graph, which has to know the new port.
        self.hear_out(&component.process).await;
        let connect = Request::Connect {
            client: client.clone(),
            server: server.clone(),
            options: ConnectOptions::default(),
        };
        let done = self.execute(vec![connect], options).await;
        let refused = match done {
            Ok(done) => {
                let made = done.plan.changes.iter().find_map(|change| match change {
                    Change::Connect { connection } => Some(connection.id),
                    _ => None,
                });
                match made {
                    Some(connection) => {
                        return Ok(Requirement { revision: done.revision, client, connection, provided });
                    }
                    None => Refusal::Internal { text: format!("connecting {client} made no connection") },
                }
            }
            Err(refusal) => refusal,
        };
        lcm.take(&name);
        Err(refused)
    }

    /// Ends the place of a guest, and all it had. No LCM has a half of its connections.
    fn leave(&self, process: &Name, session: u64) {
        let mut left = false;
        self.edit_if(|graph| {
            let mut sessions = self.inner.sessions.lock();
            left = sessions.holder(process) == Some(session);
            if left {
                sessions.dismiss(process, 0);
                sessions.guests.remove(process);
                dismiss(graph, process, &mut Vec::new());
            }
            left
        });
        if left {
            // It made no record, but a revision.
            self.left(process, 0);
            log::info!("guest {process} has left");
        }
    }
}

/// Returns the wanted name, or the first of it with a number that no process has.
fn free_name(graph: &SystemGraph, wanted: &Name) -> Result<Name, Refusal> {
    numbered(wanted, |name| graph.processes.contains_key(name))
}

/// Class of all guests.
static CLASS: LazyLock<Arc<ClassInfo>> = LazyLock::new(|| {
    Arc::new(ClassInfo {
        plugin: "trocar".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        hash: String::new(),
        name: "guest".into(),
        doc: "A shell, page or script that takes part from outside.".into(),
        safety: Safety::None,
        hardware: false,
        safe_from_any_thread: false,
        programs: Programs::None,
        execution: Execution { model: Some(ExecutionModel::None), ..Execution::default() },
        limits: ExecutionLimits::default(),
        config_schema: json!({ "type": "object", "additionalProperties": false }),
        ports: Ports::default(),
    })
});
