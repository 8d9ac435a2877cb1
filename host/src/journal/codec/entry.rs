//! Entries, both ways.
//!
//! Invariant: an entry of a kind that is not known is refused; nothing is left out of the fold.

use trocar_model::{Change, ComponentId, ConnectionId, Entry, Incarnation, Name, Refusal, Target};
use trocar_proto::journal::v1 as wire;
use wire::record::Entry as E;

use super::classes::{Classes, Known};
use crate::control::convert::{connection_in, connection_out, unreadable};

pub(super) fn entry(entry: &Entry, classes: &mut Classes) -> E {
    match entry {
        Entry::Changed { revision, decision, .. } => {
            E::Changed(wire::Changed { revision: *revision, decision: *decision })
        }
        Entry::Stopped { revision, decision, targets } => E::Stopped(wire::Stopped {
            revision: *revision,
            decision: *decision,
            targets: targets.iter().map(ToString::to_string).collect(),
        }),
        Entry::Cut { revision, connections } => {
            let connections = connections.iter().map(|id| id.0).collect();
            E::Cut(wire::Cut { revision: *revision, connections })
        }
        Entry::Came { process, incarnation } => E::Came(came(process, *incarnation)),
        Entry::Brought { revision, process, components, connections } => E::Brought(wire::Brought {
            revision: *revision,
            process: process.to_string(),
            components: components.iter().map(|(id, c)| classes.component(id, c)).collect(),
            connections: connections.iter().map(connection_out).collect(),
        }),
        Entry::Gone { revision, process, epoch } => {
            E::Gone(wire::Gone { revision: *revision, process: process.to_string(), epoch: *epoch })
        }
        Entry::Failed { component } => E::Failed(wire::Failed { component: component.to_string() }),
        Entry::Noted => E::Noted(wire::Noted {}),
    }
}

pub(super) fn entry_in(entry: Option<E>, changes: Vec<Change>, known: &Known) -> Result<Entry, Refusal> {
    Ok(match entry.ok_or_else(|| unreadable("entry"))? {
        E::Changed(e) => Entry::Changed { revision: e.revision, decision: e.decision, changes },
        E::Stopped(e) => Entry::Stopped {
            revision: e.revision,
            decision: e.decision,
            targets: e.targets.iter().map(|text| Target::parse(text)).collect::<Result<_, _>>()?,
        },
        E::Cut(e) => {
            let connections = e.connections.into_iter().map(ConnectionId).collect();
            Entry::Cut { revision: e.revision, connections }
        }
        E::Came(e) => {
            let (process, incarnation) = came_in(e)?;
            Entry::Came { process, incarnation }
        }
        E::Brought(e) => Entry::Brought {
            revision: e.revision,
            process: Name::parse(&e.process)?,
            components: e.components.into_iter().map(|c| known.component(c)).collect::<Result<_, _>>()?,
            connections: e.connections.into_iter().map(connection_in).collect::<Result<_, _>>()?,
        },
        E::Gone(e) => Entry::Gone { revision: e.revision, process: Name::parse(&e.process)?, epoch: e.epoch },
        E::Failed(e) => Entry::Failed { component: ComponentId::parse(&e.component)? },
        E::Noted(_) => Entry::Noted,
    })
}

pub(super) fn came(process: &Name, incarnation: Incarnation) -> wire::Came {
    let Incarnation { instance, epoch } = incarnation;
    wire::Came { process: process.to_string(), instance: instance.to_be_bytes().to_vec(), epoch }
}

pub(super) fn came_in(c: wire::Came) -> Result<(Name, Incarnation), Refusal> {
    let instance = c.instance.as_slice().try_into().map_err(|_| unreadable("instance"))?;
    let incarnation = Incarnation { instance: u128::from_be_bytes(instance), epoch: c.epoch };
    Ok((Name::parse(&c.process)?, incarnation))
}
