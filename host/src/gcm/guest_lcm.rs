//! Stands in for the LCM of a guest: its one component, with required interfaces that come and go.
//!
//! Invariant: nothing is ever called at a guest; a required interface goes with its connection.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use async_trait::async_trait;
use parking_lot::Mutex;
use tokio::sync::{broadcast, mpsc, watch};
use trocar_lcm_api::{
    Decision, Detail, Halted, Inventory, Invoke, Item, Lcm, LinkDetail, News, Order, PluginInfo, RemoteEnd,
    Reply, Report, Sample, Selection, Stop, When,
};
use trocar_model::{
    Change, ComponentId, Event, Function, Handler, Health, Name, Ports, Provided, Refusal, Required, State,
    StopReason, allowed,
};

/// Most required interfaces of a guest.
const MOST_REQUIRED: usize = 256;
/// News that may wait to be entered.
const NEWS: usize = 64;

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
    /// The last Stop: nothing decided before it sets the guest in motion.
    stopped: Decision,
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
    pub(super) fn new(id: ComponentId) -> GuestLcm {
        let (ports, parted) = (Arc::default(), VecDeque::new());
        let stopped = Decision::NONE;
        let stands = Stands { id, state: State::Active, ports, parted, number: 0, stopped };
        GuestLcm {
            stands: Mutex::new(stands),
            news: broadcast::Sender::new(NEWS),
            removed: watch::Sender::new(false),
        }
    }

    pub(super) fn report(&self) -> Report {
        self.stands.lock().report()
    }

    /// Becomes true when the component was removed from outside.
    pub(super) fn removed(&self) -> watch::Receiver<bool> {
        self.removed.subscribe()
    }

    /// Adds a required interface with everything of a provided one. Without a wanted name it takes the
    /// provided one's name, or that name with the first free number.
    pub(super) fn add(&self, name: Option<Name>, provided: &Provided) -> Result<Name, Refusal> {
        let mut stands = self.stands.lock();
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

    pub(super) fn take(&self, name: &Name) {
        let mut stands = self.stands.lock();
        Arc::make_mut(&mut stands.ports).required.retain(|r| *name != r.name.as_str());
        self.tell(&mut stands);
    }

    fn tell(&self, stands: &mut Stands) {
        // Nobody follows it before it is registered.
        let _ = self.news.send(News::State(stands.report()));
    }

    fn nothing_there<T>(&self) -> Result<T, Refusal> {
        let id = self.stands.lock().id.clone();
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
    async fn apply(&self, change: Change, order: Order) -> Result<Report, Refusal> {
        let mut stands = self.stands.lock();
        match change {
            Change::Create { .. } | Change::Configure { .. } => {
                return Err(Refusal::ComponentRefused {
                    id: stands.id.clone(),
                    entry: "create",
                    text: "a guest's process has one component and no other".into(),
                });
            }
            Change::Run { verb, to: State::Active, .. } if order.decision < stands.stopped => {
                return Err(Refusal::WrongState {
                    id: stands.id.clone(),
                    state: stands.state,
                    verb,
                    allowed: allowed(stands.state),
                    why: "it was stopped while this was being carried out".into(),
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

    async fn stop(&self, stop: Stop, order: Order) -> Result<Vec<Halted>, Refusal> {
        let mut stands = self.stands.lock();
        if !stop.targets.iter().any(|target| target.names(&stands.id)) {
            return Ok(Vec::new());
        }
        stands.stopped = stands.stopped.max(order.decision);
        let was = stands.state;
        if was == State::Active {
            stands.state = State::Stopped(StopReason::Requested);
        }
        Ok(vec![Halted { id: stands.id.clone(), was, done: Ok(stands.report()) }])
    }

    async fn link(&self, _: RemoteEnd, _: Instant) -> Result<Report, Refusal> {
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

    async fn details(&self, ids: Vec<ComponentId>) -> Result<Vec<(ComponentId, Detail)>, Refusal> {
        let detail = Detail { thread: "outside of the system".into(), ..Detail::default() };
        Ok(ids.into_iter().map(|id| (id, detail.clone())).collect())
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

pub(super) fn invalid(what: &str, why: String, field: &str) -> Refusal {
    Refusal::ArgumentInvalid { what: what.into(), why, field: field.into() }
}

/// Returns the wanted name, or that name with the first number that is not taken.
pub(super) fn numbered(wanted: &Name, taken: impl Fn(&Name) -> bool) -> Result<Name, Refusal> {
    let mut name = wanted.clone();
    for n in 2.. {
        if !taken(&name) {
            break;
        }
        name = Name::parse(&format!("{wanted}{n}"))?;
    }
    Ok(name)
}
