//! Changes, slices and inventories, both ways: everything about components and connections that crosses an
//! Attach stream.
//!
//! Invariant: decoding gives a value equal to the encoded one; configurations cross as exact JSON text.

use std::sync::Arc;

use serde_json::Value;
use trocar_links::Card;
use trocar_model::{
    Change, ClassInfo, Component, ComponentId, Connection, ConnectionId, Phase, PortId, Refusal, State,
    StepTimes, Verb, Warnings,
};
use trocar_proto::v1;

use super::answers::{half, half_in};
use super::back::{self, unreadable};
use super::requests::{execution, options};
use super::stopping::{decision_in, stopped_here_in, stopped_here_out};
use super::types::{class, execution_out, health, options_out, ports, state};
use crate::gcm::Slice;
use crate::lcm::{ClassOf, Inventory, RemoteEnd, Report};

pub(crate) fn state_out(s: State) -> v1::State {
    let (state, stop_reason) = state(s);
    v1::State { state: state as i32, stop_reason: stop_reason as i32 }
}

pub(crate) fn state_in(s: Option<v1::State>) -> Result<State, Refusal> {
    let s = s.ok_or_else(|| unreadable("state"))?;
    back::state(s.state, s.stop_reason)
}

fn json(text: &str, what: &str) -> Result<Value, Refusal> {
    serde_json::from_str(text).map_err(|_| unreadable(what))
}

fn component_out(id: &ComponentId, c: &Component) -> v1::DesiredComponent {
    v1::DesiredComponent { class: Some(class(&c.class)), ..unclassed_out(id, c) }
}

/// A component without its class, which is large and may be said once for many.
pub(crate) fn unclassed_out(id: &ComponentId, c: &Component) -> v1::DesiredComponent {
    v1::DesiredComponent {
        path: id.to_string(),
        class: None,
        config_json: c.config.to_string(),
        execution: Some(execution_out(&c.execution)),
        ports: (*c.ports != c.class.ports).then(|| ports(&c.ports)),
        state: Some(state_out(c.state)),
        health: health(c.health) as i32,
        fault: c.fault.clone(),
    }
}

fn component_in(mut c: v1::DesiredComponent) -> Result<(ComponentId, Component), Refusal> {
    let class = back::class(c.class.take().ok_or_else(|| unreadable("class"))?)?;
    unclassed_in(c, Arc::new(class))
}

pub(crate) fn unclassed_in(
    c: v1::DesiredComponent,
    class: Arc<ClassInfo>,
) -> Result<(ComponentId, Component), Refusal> {
    let ports = match c.ports {
        Some(ports) => back::ports(ports)?,
        None => class.ports.clone(),
    };
    let component = Component {
        class,
        config: json(&c.config_json, "config_json")?,
        execution: execution(c.execution.ok_or_else(|| unreadable("execution"))?)?,
        ports: Arc::new(ports),
        state: state_in(c.state)?,
        health: back::health(c.health)?,
        fault: c.fault,
    };
    Ok((ComponentId::parse(&c.path)?, component))
}

pub(crate) fn connection_out(c: &Connection) -> v1::DesiredConnection {
    v1::DesiredConnection {
        id: c.id.0,
        client: c.client.to_string(),
        server: c.server.to_string(),
        options: Some(options_out(&c.options)),
    }
}

pub(crate) fn connection_in(c: v1::DesiredConnection) -> Result<Connection, Refusal> {
    Ok(Connection {
        id: ConnectionId(c.id),
        client: PortId::parse(&c.client)?,
        server: PortId::parse(&c.server)?,
        options: options(c.options.unwrap_or_default())?,
    })
}

const VERBS: [(Verb, v1::Verb); 6] = [
    (Verb::Configure, v1::Verb::Configure),
    (Verb::Start, v1::Verb::Start),
    (Verb::Stop, v1::Verb::Stop),
    (Verb::Resume, v1::Verb::Resume),
    (Verb::Reset, v1::Verb::Reset),
    (Verb::Remove, v1::Verb::Remove),
];

pub(crate) fn verb_out(verb: Verb) -> i32 {
    VERBS.iter().find(|(v, _)| *v == verb).map_or(0, |(_, w)| *w as i32)
}

pub(crate) fn verb_in(verb: i32) -> Result<Verb, Refusal> {
    VERBS.iter().find(|(_, w)| *w as i32 == verb).map(|(v, _)| *v).ok_or_else(|| unreadable("verb"))
}

pub(crate) fn change_out(change: &Change) -> v1::Change {
    change_out_with(change, component_out)
}

/// A change whose component, where it has one, is said by `component`.
pub(crate) fn change_out_with(
    change: &Change,
    mut component: impl FnMut(&ComponentId, &Component) -> v1::DesiredComponent,
) -> v1::Change {
    use v1::change::Change as C;
    let replaced = matches!(change, Change::Disconnect { replaced: true, .. });
    let change = match change {
        Change::Create { id, component: made } => C::Create(component(id, made)),
        Change::Destroy { id, component: was } => C::Destroy(component(id, was)),
        Change::Configure { id, from, to, from_state, to_state } => C::Configure(v1::ConfigureChange {
            path: id.to_string(),
            from_json: from.to_string(),
            to_json: to.to_string(),
            from: Some(state_out(*from_state)),
            to: Some(state_out(*to_state)),
        }),
        Change::Run { id, verb, from, to } => C::Run(v1::RunChange {
            path: id.to_string(),
            verb: verb_out(*verb),
            from: Some(state_out(*from)),
            to: Some(state_out(*to)),
        }),
        Change::Connect { connection } => C::Connect(connection_out(connection)),
        Change::Disconnect { connection, .. } => C::Disconnect(connection_out(connection)),
    };
    v1::Change { change: Some(change), replaced }
}

pub(crate) fn change_in(change: v1::Change) -> Result<Change, Refusal> {
    change_in_with(change, component_in)
}

/// Undoes [`change_out_with`].
pub(crate) fn change_in_with(
    change: v1::Change,
    component: impl FnOnce(v1::DesiredComponent) -> Result<(ComponentId, Component), Refusal>,
) -> Result<Change, Refusal> {
    use v1::change::Change as C;
    let replaced = change.replaced;
    Ok(match change.change.ok_or_else(|| unreadable("change"))? {
        C::Create(c) => component(c).map(|(id, c)| Change::Create { id, component: Box::new(c) })?,
        C::Destroy(c) => component(c).map(|(id, c)| Change::Destroy { id, component: Box::new(c) })?,
        C::Configure(c) => Change::Configure {
            id: ComponentId::parse(&c.path)?,
            from: json(&c.from_json, "from_json")?,
            to: json(&c.to_json, "to_json")?,
            from_state: state_in(c.from)?,
            to_state: state_in(c.to)?,
        },
        C::Run(r) => Change::Run {
            id: ComponentId::parse(&r.path)?,
            verb: verb_in(r.verb)?,
            from: state_in(r.from)?,
            to: state_in(r.to)?,
        },
        C::Connect(c) => Change::Connect { connection: connection_in(c)? },
        C::Disconnect(c) => Change::Disconnect { connection: connection_in(c)?, replaced },
    })
}

pub(crate) fn slice_out(slice: &Slice) -> v1::Slice {
    v1::Slice {
        components: slice.components.iter().map(|(id, c)| component_out(id, c)).collect(),
        connections: slice.connections.iter().map(connection_out).collect(),
    }
}

pub(crate) fn slice_in(slice: v1::Slice) -> Result<Slice, Refusal> {
    Ok(Slice {
        components: slice.components.into_iter().map(component_in).collect::<Result<_, _>>()?,
        connections: slice.connections.into_iter().map(connection_in).collect::<Result<_, _>>()?,
    })
}

pub(crate) fn report_in(r: v1::ComponentReport) -> Result<Report, Refusal> {
    Ok(Report {
        id: ComponentId::parse(&r.path)?,
        number: r.number,
        state: back::state(r.state, r.stop_reason)?,
        health: back::health(r.health)?,
        fault: r.fault,
        ports: r.ports.map(back::ports).transpose()?.map(Arc::new),
        lost_connections: r.lost_connections,
        warnings: r.warnings,
    })
}

fn card_out(card: &Card) -> v1::Card {
    v1::Card {
        process: card.process.clone(),
        instance: card.instance.clone(),
        boot: card.boot.clone(),
        uid: card.uid,
        socket: card.socket.to_string_lossy().into_owned(),
        layout: card.layout,
        net: card.net.clone(),
    }
}

fn card_in(card: v1::Card) -> Card {
    Card {
        process: card.process,
        instance: card.instance,
        boot: card.boot,
        uid: card.uid,
        socket: card.socket.into(),
        layout: card.layout,
        net: card.net,
    }
}

pub(crate) fn remote_out(end: &RemoteEnd) -> v1::LinkOrder {
    v1::LinkOrder {
        connection: Some(connection_out(&end.connection)),
        ports: Some(super::ports(&end.ports)),
        class: end.class.name.clone(),
        class_hash: end.class.hash.clone(),
        card: Some(card_out(&end.card)),
    }
}

pub(crate) fn remote_in(end: v1::LinkOrder) -> Result<RemoteEnd, Refusal> {
    Ok(RemoteEnd {
        connection: connection_in(end.connection.ok_or_else(|| unreadable("connection"))?)?,
        ports: Arc::new(back::ports(end.ports.ok_or_else(|| unreadable("ports"))?)?),
        class: ClassOf { name: end.class, hash: end.class_hash },
        card: card_in(end.card.ok_or_else(|| unreadable("card"))?),
    })
}

pub(crate) fn phases_out(given: Option<Vec<(ComponentId, Phase)>>) -> v1::PhasesOrder {
    let ask_only = given.is_none();
    let given = given.into_iter().flatten().map(|(id, Phase { phase_ns, note })| v1::GivenPhase {
        path: id.to_string(),
        phase_ns,
        note,
    });
    v1::PhasesOrder { given: given.collect(), ask_only }
}

pub(crate) fn phases_in(order: v1::PhasesOrder) -> Result<Option<Vec<(ComponentId, Phase)>>, Refusal> {
    let phase = |given: v1::GivenPhase| {
        Ok((ComponentId::parse(&given.path)?, Phase { phase_ns: given.phase_ns, note: given.note }))
    };
    let given = order.given.into_iter().map(phase).collect::<Result<_, Refusal>>()?;
    Ok((!order.ask_only).then_some(given))
}

pub(crate) fn steps_out(steps: StepTimes) -> v1::Steps {
    let one = |(id, step_ns): (ComponentId, u64)| v1::StepTime { path: id.to_string(), step_ns };
    v1::Steps { steps: steps.into_iter().map(one).collect() }
}

pub(crate) fn steps_in(steps: v1::Steps) -> Result<StepTimes, Refusal> {
    let one = |step: v1::StepTime| Ok((ComponentId::parse(&step.path)?, step.step_ns));
    steps.steps.into_iter().map(one).collect()
}

pub(crate) fn inventory_out(inventory: &Inventory) -> v1::Inventory {
    v1::Inventory {
        card: inventory.card.as_ref().map(card_out),
        components: inventory.components.iter().map(super::report).collect(),
        classes: inventory.classes.iter().map(|c| class(c)).collect(),
        proxies: inventory.halves.iter().map(half).collect(),
        warnings: inventory.warnings.sentences.clone(),
        unfit: inventory.warnings.unfit,
        decision: inventory.decision.0,
        stopped_here: (inventory.stopped_here.number > 0).then(|| stopped_here_out(&inventory.stopped_here)),
    }
}

pub(crate) fn inventory_in(inventory: v1::Inventory) -> Result<Inventory, Refusal> {
    Ok(Inventory {
        card: inventory.card.map(card_in),
        components: inventory.components.into_iter().map(report_in).collect::<Result<_, _>>()?,
        classes: classes_in(inventory.classes)?,
        halves: inventory.proxies.into_iter().map(half_in).collect::<Result<_, _>>()?,
        warnings: Warnings { sentences: inventory.warnings, unfit: inventory.unfit },
        decision: decision_in(inventory.decision)?,
        stopped_here: stopped_here_in(inventory.stopped_here.unwrap_or_default())?,
    })
}

pub(crate) fn classes_in(classes: Vec<v1::ClassInfo>) -> Result<Vec<Arc<trocar_model::ClassInfo>>, Refusal> {
    classes.into_iter().map(|c| back::class(c).map(Arc::new)).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn a_disconnect_says_on_the_wire_whether_another_source_follows() {
        let port = |path: &str| PortId::parse(path).unwrap();
        let connection = Connection {
            id: ConnectionId(7),
            client: port("host/arm/in"),
            server: port("host/source/out"),
            options: trocar_model::ConnectOptions::default(),
        };
        for replaced in [true, false] {
            let change = Change::Disconnect { connection: connection.clone(), replaced };
            assert_eq!(change_in(change_out(&change)).unwrap(), change);
        }
        let change = Change::Connect { connection };
        assert_eq!(change_in(change_out(&change)).unwrap(), change);
    }
}
