//! Snapshots, both ways.
//!
//! Invariant: a snapshot names the record up to which it folds, by number and by hash.

use prost::Message;
use trocar_model::{Refusal, Wanted};
use trocar_proto::journal::v1 as wire;

use super::classes::{Classes, Known};
use super::{answer, check_schema, decoded, entry};
use crate::control::convert::{connection_in, connection_out};
use crate::gcm::{Remembered, Snapshot};
use crate::journal::SCHEMA;
use crate::journal::chain::{self, Hash};
use crate::journal::fault::{Bad, Res};

/// A snapshot as it lies in the file.
pub(in crate::journal) struct Folded {
    pub(in crate::journal) number: u64,
    pub(in crate::journal) hash: Hash,
    pub(in crate::journal) snapshot: Snapshot,
}

/// Encodes a snapshot of all records up to that one.
pub(in crate::journal) fn snapshot(snapshot: &Snapshot, number: u64, hash: &Hash) -> Vec<u8> {
    let mut classes = Classes::default();
    let Wanted { revision, term, next_connection, decision, components, connections, processes } =
        &snapshot.wanted;
    let components = components.iter().map(|(id, c)| classes.component(id, c)).collect();
    let answers = snapshot.answers.iter().map(|a| remembered(a, &mut classes)).collect();
    let message = wire::Snapshot {
        schema: SCHEMA,
        number,
        hash: hash.bytes().to_vec(),
        revision: *revision,
        next_connection: *next_connection,
        decision: *decision,
        term: *term,
        classes: classes.out(),
        components,
        connections: connections.values().map(connection_out).collect(),
        processes: processes.iter().map(|(name, it)| entry::came(name, *it)).collect(),
        answers,
    };
    message.encode_to_vec()
}

fn remembered(r: &Remembered, classes: &mut Classes) -> wire::Remembered {
    let changes = r.answer.as_ref().map_or(&[][..], |done| &done.plan.changes);
    wire::Remembered {
        wall_ns: r.wall_ns,
        asked: Some(answer::asked(&r.asked)),
        answer: Some(answer::answer(&r.answer)),
        changes: changes.iter().map(|change| classes.change(change)).collect(),
    }
}

/// Decodes a snapshot.
pub(in crate::journal) fn snapshot_in(bytes: &[u8]) -> Res<Folded> {
    check_schema(bytes, "the snapshot")?;
    let message: wire::Snapshot = decoded(bytes)?;
    let (number, hash) = (message.number, chain::read(&message.hash, "the hash of its last record")?);
    let snapshot = read_snapshot(message).map_err(|refusal| Bad::unreadable(&refusal))?;
    Ok(Folded { number, hash, snapshot })
}

fn read_snapshot(message: wire::Snapshot) -> Result<Snapshot, Refusal> {
    let known = Known::read(message.classes)?;
    let components = message.components.into_iter().map(|c| known.component(c));
    let connections = message.connections.into_iter().map(|c| connection_in(c).map(|c| (c.id, c)));
    let wanted = Wanted {
        revision: message.revision,
        term: message.term,
        next_connection: message.next_connection,
        decision: message.decision,
        components: components.collect::<Result<_, _>>()?,
        connections: connections.collect::<Result<_, _>>()?,
        processes: message.processes.into_iter().map(entry::came_in).collect::<Result<_, _>>()?,
    };
    let answers =
        message.answers.into_iter().map(|it| remembered_in(it, &known)).collect::<Result<_, _>>()?;
    Ok(Snapshot { wanted, answers })
}

fn remembered_in(r: wire::Remembered, known: &Known) -> Result<Remembered, Refusal> {
    let changes = r.changes.into_iter().map(|change| known.change(change)).collect::<Result<_, _>>()?;
    Ok(Remembered {
        wall_ns: r.wall_ns,
        asked: answer::asked_in(r.asked.unwrap_or_default())?,
        answer: answer::answer_in(r.answer.unwrap_or_default(), changes)?,
    })
}
