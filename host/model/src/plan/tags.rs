//! Connections to simulated worlds: tags of ports, enforced at Connect and whenever ports change.
//!
//! Invariant: data tagged `truth` or `sim` never reaches an actuator but through ports tagged `sim`, in no
//! order of connecting: each new connection is judged together with all there are, and all there are when
//! ports change.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use crate::connect::directions;
use crate::{
    ComponentId, Connection, ConnectionId, Link, Port, Ports, Refusal, Safety, SystemGraph, Tag, bindings,
};

/// Refuses `new`, which takes the place of any other source of its client, when it joins a port for simulated
/// devices to one that is not, or when it opens a way from a tagged port to an actuator.
pub(super) fn check_tags(graph: &SystemGraph, new: &Connection, link: &Link) -> Result<(), Refusal> {
    let (takes, has) = tags(graph, new)?;
    if takes == Tag::Sim && has != Tag::Sim {
        return Err(Refusal::TagMismatch { client: new.client.clone(), server: new.server.clone(), has });
    }
    let others = || graph.connections.values().filter(|c| c.client != new.client);
    let tagged = Tagged::of(graph);
    let told = others().chain([new]).filter(|c| tagged.may_tell(c)).filter_map(|c| told(graph, c));
    let told: Vec<(Tag, &Connection)> = told.collect();
    if told.is_empty() {
        return Ok(());
    }
    let mut ways = Ways::default();
    for connection in others() {
        ways.add(graph, connection, None);
    }
    ways.add(graph, new, Some(link));
    told.into_iter().try_for_each(|(tag, connection)| ways.check(graph, tag, connection))
}

/// Returns the connections that tags forbid as the ports are now, each with the reason. On a way from the
/// truth to an actuator it is the connection that tells the truth.
pub(crate) fn forbidden(graph: &SystemGraph) -> Vec<(ConnectionId, Refusal)> {
    let (mut all, mut ways) = (Vec::new(), None);
    let tagged = Tagged::of(graph);
    for connection in graph.connections.values().filter(|c| tagged.may_tell(c) || tagged.is_taken_by(c)) {
        // A connection whose ports are gone is skipped.
        let Ok((takes, has)) = tags(graph, connection) else { continue };
        let (client, server) = (connection.client.clone(), connection.server.clone());
        let judged = match told(graph, connection) {
            _ if takes == Tag::Sim && has != Tag::Sim => Err(Refusal::TagMismatch { client, server, has }),
            Some((tag, _)) => ways.get_or_insert_with(|| Ways::of(graph)).check(graph, tag, connection),
            None => Ok(()),
        };
        all.extend(judged.err().map(|why| (connection.id, why)));
    }
    all
}

/// Tags of the client's and the server's port.
fn tags(graph: &SystemGraph, c: &Connection) -> Result<(Tag, Tag), Refusal> {
    let (a, b) = (graph.component(&c.client.component)?, graph.component(&c.server.component)?);
    Ok(match directions(&a.ports, &c.client, &b.ports, &c.server)? {
        (Port::Input(_, input), Port::Output(_, output)) => (input.tag, output.tag),
        (_, Port::Provided(_, provided)) => (Tag::None, provided.tag),
        _ => (Tag::None, Tag::None),
    })
}

/// Components with tagged ports. Most systems have few or none, and a large one comes here with each Connect
/// and each report of ports: what no tag concerns is not looked at.
struct Tagged<'g> {
    /// With an output or a provided interface that has a tag.
    gives: BTreeSet<&'g ComponentId>,
    /// With an input for simulated data.
    takes: BTreeSet<&'g ComponentId>,
}

impl<'g> Tagged<'g> {
    fn of(graph: &'g SystemGraph) -> Tagged<'g> {
        let with = |has: fn(&Ports) -> bool| {
            graph.components.iter().filter(|(_, c)| has(&c.ports)).map(|(id, _)| id).collect()
        };
        let gives = |ports: &Ports| {
            ports.outputs.iter().any(|output| output.tag != Tag::None)
                || ports.provided.iter().any(|provided| provided.tag != Tag::None)
        };
        Tagged { gives: with(gives), takes: with(|ports| ports.inputs.iter().any(|i| i.tag != Tag::None)) }
    }

    fn may_tell(&self, connection: &Connection) -> bool {
        !self.gives.is_empty() && self.gives.contains(&connection.server.component)
    }

    fn is_taken_by(&self, connection: &Connection) -> bool {
        !self.takes.is_empty() && self.takes.contains(&connection.client.component)
    }
}

/// Returns the tagged data this connection tells a client that is no simulated device.
fn told<'c>(graph: &SystemGraph, c: &'c Connection) -> Option<(Tag, &'c Connection)> {
    let (takes, has) = tags(graph, c).ok()?;
    (has != Tag::None && takes != Tag::Sim).then_some((has, c))
}

/// Ways of data between components: along each stream, and over each interface to the server what is sent or
/// called, to the client what is read, answered or raised. A read tells the server nothing.
#[derive(Default)]
struct Ways(BTreeMap<ComponentId, BTreeSet<ComponentId>>);

impl Ways {
    fn of(graph: &SystemGraph) -> Ways {
        let mut ways = Ways::default();
        graph.connections.values().for_each(|connection| ways.add(graph, connection, None));
        ways
    }

    fn add(&mut self, graph: &SystemGraph, c: &Connection, link: Option<&Link>) {
        let Some(a) = graph.components.get(&c.client.component) else { return };
        let Some(b) = graph.components.get(&c.server.component) else { return };
        let (to_client, to_server) = match link {
            Some(link) => directions_of(link, &a.ports, &b.ports),
            None => match bindings(&a.ports, &c.client, &b.ports, &c.server, &c.options) {
                Ok(link) => directions_of(&link, &a.ports, &b.ports),
                // Its ports are others now; until it is bound again it may tell both.
                Err(_) => (true, true),
            },
        };
        let (client, server) = (&c.client.component, &c.server.component);
        for (yes, from, to) in [(to_client, server, client), (to_server, client, server)] {
            if yes {
                self.0.entry(from.clone()).or_default().insert(to.clone());
            }
        }
    }

    /// Refuses a connection that tells tagged data to a client from which a way leads to an actuator.
    fn check(&self, graph: &SystemGraph, tag: Tag, telling: &Connection) -> Result<(), Refusal> {
        let (client, server) = (telling.client.clone(), telling.server.clone());
        match self.to_actuator(graph, &client.component) {
            Some(path) => Err(Refusal::TruthToActuator { client, server, tag, path }),
            None => Ok(()),
        }
    }

    /// The shortest way from `from` to an actuator, both ends included; `from` alone when it is one.
    fn to_actuator(&self, graph: &SystemGraph, from: &ComponentId) -> Option<Vec<ComponentId>> {
        let actuator = |id: &ComponentId| {
            graph.components.get(id).is_some_and(|found| found.class.safety == Safety::Actuator)
        };
        let mut came: BTreeMap<&ComponentId, Option<&ComponentId>> = BTreeMap::from([(from, None)]);
        let mut queue = VecDeque::from([from]);
        while let Some(at) = queue.pop_front() {
            if actuator(at) {
                let mut path: Vec<ComponentId> =
                    std::iter::successors(Some(at), |id| came.get(id).copied().flatten()).cloned().collect();
                path.reverse();
                return Some(path);
            }
            for next in self.0.get(at).into_iter().flatten() {
                if !came.contains_key(next) {
                    came.insert(next, Some(at));
                    queue.push_back(next);
                }
            }
        }
        None
    }
}

/// Returns whether this link tells its client something, and its server.
fn directions_of(link: &Link, client: &Ports, server: &Ports) -> (bool, bool) {
    let Link::Interface { required, provided, binding } = link else { return (true, false) };
    let (functions, commands) = (&client.required[*required].functions, &server.provided[*provided].commands);
    let first = (client.first_function(*required), server.first_command(*provided));
    let called = || binding.functions.iter().map(|(f, c)| (&functions[f - first.0], &commands[c - first.1]));
    let to_client = !binding.handlers.is_empty() || called().any(|(_, command)| command.ret.is_some());
    let to_server = called().any(|(_, command)| !command.kind.is_read());
    (to_client, to_server)
}
