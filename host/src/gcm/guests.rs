//! Guests: places in the graph behind which there is no LCM, such as a shell's.
//!
//! Invariant: nothing is ever called at a guest; its place, and every connection of it, ends with the owner
//! of [`Joined`].

use std::collections::VecDeque;
use std::sync::{Arc, LazyLock, Mutex};
use std::time::Instant;

use async_trait::async_trait;
use serde_json::json;
use tokio::sync::{broadcast, mpsc, watch};
use trocar_lcm_api::{
    Detail, FarEnd, Inventory, Invoke, Item, Lcm, LinkDetail, News, PluginInfo, Reply, Report, Sample,
    Selection, When,
};
use trocar_model::{
    Change, ClassInfo, Component, ComponentId, ConnectOptions, ConnectionId, Event, Execution,
    ExecutionLimits, ExecutionModel, Function, Handler, Health, Name, PortId, Ports, Programs, Provided,
    Refusal, Request, Required, Safety, State, SystemGraph,
};

use super::manager::lock;
use super::sessions::{Registered, Registration, Slice};
use super::{ExecuteOptions, Gcm};

/// Most guests of a system; each costs little, but a script that joins in a loop should be told.
const MOST: usize = 64;
/// Most required interfaces of a guest.
const MOST_REQUIRED: usize = 256;
/// News that may wait to be entered.
const NEWS: usize = 64;

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
        let mut removed = self.lcm.removed.subscribe();
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
                    lock(&self.inner.sessions).guests.insert(component.process.clone(), lcm.clone());
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
        let Some(lcm) = lock(&self.inner.sessions).guests.get(&component.process).cloned() else {
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
            let mut sessions = lock(&self.inner.sessions);
            left = sessions.holder(process) == Some(session);
            if left {
                sessions.dismiss(process, 0);
                sessions.guests.remove(process);
                super::fate::dismiss(graph, process, &mut Vec::new());
            }
            left
        });
        if left {
            log::info!("guest {process} has left");
        }
    }
}

fn invalid(what: &str, why: String, field: &str) -> Refusal {
    Refusal::ArgumentInvalid { what: what.into(), why, field: field.into() }
}

/// Returns the wanted name, or the first of it with a number that no process has.
fn free_name(graph: &SystemGraph, wanted: &Name) -> Result<Name, Refusal> {
    numbered(wanted, |name| graph.processes.contains_key(name))
}

fn numbered(wanted: &Name, taken: impl Fn(&Name) -> bool) -> Result<Name, Refusal> {
    let mut name = wanted.clone();
    for n in 2.. {
        if !taken(&name) {
            break;
        }
        name = Name::parse(&format!("{wanted}{n}"))?;
    }
    Ok(name)
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

/// Stands in for the LCM of a guest.
pub(super) struct GuestLcm {
    stands: Mutex<Stands>,
    news: broadcast::Sender<News>,
    /// True when its component was removed from outside.
    removed: watch::Sender<bool>,
}

struct Stands {
    id: ComponentId,
    state: State,
    ports: Arc<Ports>,
    /// Required interfaces that went with their connections, the last ones. A change that fails after that,
    /// or that makes the other end anew, connects one again.
    parted: VecDeque<Required>,
    /// Number of the last report.
    number: u64,
}

impl Stands {
    fn goes(&mut self, port: &Name) {
        let required = &mut Arc::make_mut(&mut self.ports).required;
        let Some(at) = required.iter().position(|r| *port == r.name.as_str()) else { return };
        self.parted.push_back(required.remove(at));
        if self.parted.len() > MOST_REQUIRED {
            self.parted.pop_front();
        }
    }

    fn comes_back(&mut self, port: &Name) {
        let is_it = |r: &Required| *port == r.name.as_str();
        if self.ports.required.iter().any(is_it) {
            return;
        }
        if let Some(at) = self.parted.iter().rposition(is_it) {
            let back = self.parted.remove(at);
            Arc::make_mut(&mut self.ports).required.extend(back);
        }
    }

    fn report(&mut self) -> Report {
        self.number += 1;
        Report {
            id: self.id.clone(),
            number: self.number,
            state: self.state,
            health: Health::Ok,
            fault: String::new(),
            ports: Some(self.ports.clone()),
            lost_connections: Vec::new(),
            warnings: Vec::new(),
        }
    }
}

impl GuestLcm {
    fn new(id: ComponentId) -> GuestLcm {
        let (ports, parted) = (Arc::default(), VecDeque::new());
        let stands = Stands { id, state: State::Active, ports, parted, number: 0 };
        GuestLcm {
            stands: Mutex::new(stands),
            news: broadcast::Sender::new(NEWS),
            removed: watch::Sender::new(false),
        }
    }

    fn report(&self) -> Report {
        lock(&self.stands).report()
    }

    /// Adds a required interface with everything of a provided one. Without a wanted name it takes the
    /// provided one's name, or that name with the first free number.
    fn add(&self, name: Option<Name>, provided: &Provided) -> Result<Name, Refusal> {
        let mut stands = lock(&self.stands);
        let taken = |name: &Name| stands.ports.required.iter().any(|r| *name == r.name.as_str());
        if stands.ports.required.len() >= MOST_REQUIRED {
            let why = format!(
                "{} has {MOST_REQUIRED} required interfaces, which is the most: disconnect one",
                stands.id
            );
            return Err(invalid("Require", why, "component"));
        }
        let name = match name {
            Some(name) if taken(&name) => {
                let why = format!("{} has a required interface {name}: choose another name", stands.id);
                return Err(invalid("Require", why, "name"));
            }
            Some(name) => name,
            None => numbered(&Name::parse(&provided.name)?, taken)?,
        };
        Arc::make_mut(&mut stands.ports).required.push(mirror(&name, provided));
        self.tell(&mut stands);
        Ok(name)
    }

    fn take(&self, name: &Name) {
        let mut stands = lock(&self.stands);
        Arc::make_mut(&mut stands.ports).required.retain(|r| *name != r.name.as_str());
        self.tell(&mut stands);
    }

    fn tell(&self, stands: &mut Stands) {
        // Nobody follows it before it is registered.
        let _ = self.news.send(News::State(stands.report()));
    }

    fn nothing_there<T>(&self) -> Result<T, Refusal> {
        let id = lock(&self.stands).id.clone();
        Err(Refusal::ComponentRefused {
            entry: "call",
            text: "it is a guest: it uses others and offers nothing itself".into(),
            id,
        })
    }
}

/// The required interface that fits a provided one.
fn mirror(name: &Name, provided: &Provided) -> Required {
    Required {
        name: name.to_string(),
        doc: provided.doc.clone(),
        optional: true,
        functions: provided
            .commands
            .iter()
            .map(|c| Function {
                name: c.name.clone(),
                doc: c.doc.clone(),
                arg: c.arg.as_ref().map(|a| a.ty.clone()),
                ret: c.ret.clone(),
                unit: c.arg.as_ref().map(|a| a.unit.clone()).unwrap_or_default(),
                optional: true,
                any: false,
            })
            .collect(),
        handlers: provided
            .events
            .iter()
            .map(|Event { name, doc, payload, .. }| Handler {
                name: name.clone(),
                doc: doc.clone(),
                payload: payload.clone(),
                optional: true,
                direct: false,
            })
            .collect(),
    }
}

#[async_trait]
impl Lcm for GuestLcm {
    async fn apply(&self, change: Change, _: Instant) -> Result<Report, Refusal> {
        let mut stands = lock(&self.stands);
        match change {
            Change::Create { .. } | Change::Configure { .. } => {
                return Err(Refusal::ComponentRefused {
                    id: stands.id.clone(),
                    entry: "create",
                    text: "a guest's process has one component and no other".into(),
                });
            }
            Change::Run { to, .. } => stands.state = to,
            Change::Connect { connection } => stands.comes_back(&connection.client.port),
            // A required interface that was added for the connection goes with it, unless another connection
            // takes its place.
            Change::Disconnect { connection, replaced } if !replaced => stands.goes(&connection.client.port),
            Change::Disconnect { .. } => {}
            Change::Destroy { .. } => _ = self.removed.send_replace(true),
        }
        Ok(stands.report())
    }

    async fn link(&self, _: FarEnd, _: Instant) -> Result<Report, Refusal> {
        self.nothing_there()
    }

    async fn invoke(&self, _: Invoke) -> Result<Reply, Refusal> {
        self.nothing_there()
    }

    async fn read(&self, _: String, _: When, _: bool, _: Instant) -> Result<Sample, Refusal> {
        self.nothing_there()
    }

    async fn subscribe(&self, _: Vec<Selection>) -> Result<mpsc::Receiver<Item>, Refusal> {
        self.nothing_there()
    }

    async fn detail(&self, _: ComponentId) -> Result<Detail, Refusal> {
        let program = "outside of the system".to_owned();
        Ok(Detail { thread: program, ..Detail::default() })
    }

    async fn links(&self) -> Result<Vec<LinkDetail>, Refusal> {
        Ok(Vec::new())
    }

    async fn plugins(&self) -> Result<Vec<PluginInfo>, Refusal> {
        Ok(Vec::new())
    }

    async fn inventory(&self) -> Result<Inventory, Refusal> {
        Ok(Inventory { components: vec![self.report()], ..Inventory::default() })
    }

    fn news(&self) -> broadcast::Receiver<News> {
        self.news.subscribe()
    }
}
