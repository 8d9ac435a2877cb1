//! Records and snapshots ↔ messages of `trocar.journal.v1`.
//!
//! Invariant: decoding gives a value equal to the encoded one, but for the ports of reports, which are not
//! written; a message that says a greater schema is not read any further.

mod answer;
mod classes;
mod entry;
mod snapshot;

use prost::Message;
use trocar_model::{Entry, Plan, Refusal};
use trocar_proto::journal::v1 as wire;

use super::SCHEMA;
use super::chain::{self, Hash};
use super::fault::{Bad, Res};
use crate::gcm::Record;
use classes::{Classes, Known};

pub(super) use snapshot::{Folded, snapshot, snapshot_in};

/// A record as it lies in the file.
pub(super) struct Linked {
    pub(super) number: u64,
    pub(super) before: Hash,
    pub(super) record: Record,
}

/// Encodes a record.
pub(super) fn record(record: &Record, number: u64, before: &Hash) -> Vec<u8> {
    let mut classes = Classes::default();
    let changes = match (&record.entry, &record.answer) {
        (Entry::Changed { changes, .. }, _) => changes.as_slice(),
        (_, Some(Ok(done))) => done.plan.changes.as_slice(),
        _ => &[],
    };
    let changes = changes.iter().map(|change| classes.change(change)).collect();
    let entry = entry::entry(&record.entry, &mut classes);
    let message = wire::Record {
        schema: SCHEMA,
        number,
        before: before.bytes().to_vec(),
        wall_ns: record.wall_ns,
        monotonic_ns: record.monotonic_ns,
        term: record.term,
        asked: record.asked.as_ref().map(answer::asked),
        answer: record.answer.as_ref().map(answer::answer),
        classes: classes.out(),
        changes,
        entry: Some(entry),
    };
    message.encode_to_vec()
}

/// Decodes a record.
pub(super) fn record_in(bytes: &[u8]) -> Res<Linked> {
    check_schema(bytes, "records")?;
    let message: wire::Record = decoded(bytes)?;
    let before = chain::read(&message.before, "the hash of the record before it")?;
    let number = message.number;
    let record = read_record(message).map_err(|refusal| Bad::unreadable(&refusal))?;
    Ok(Linked { number, before, record })
}

fn read_record(message: wire::Record) -> Result<Record, Refusal> {
    let known = Known::read(message.classes)?;
    let changes = message.changes.into_iter().map(|change| known.change(change));
    let changes = changes.collect::<Result<Vec<_>, _>>()?;
    let answer = message.answer.map(|it| answer::answer_in(it, changes.clone())).transpose()?;
    Ok(Record {
        wall_ns: message.wall_ns,
        monotonic_ns: message.monotonic_ns,
        term: message.term,
        entry: entry::entry_in(message.entry, changes, &known)?,
        asked: message.asked.map(answer::asked_in).transpose()?,
        answer,
    })
}

/// Decodes a message of which every part is known.
pub(super) fn decoded<M: Message + Default>(bytes: &[u8]) -> Res<M> {
    M::decode(bytes).map_err(|e| Bad::damaged(format!("it cannot be decoded: {e}")))
}

/// Refuses what a later release wrote, before any other part of it is looked at.
pub(super) fn check_schema(bytes: &[u8], what: &str) -> Res<()> {
    let message: wire::Schema = decoded(bytes)?;
    match message.schema {
        0 => Err(Bad::damaged("it names no schema")),
        schema if schema > SCHEMA => Err(Bad::newer(what, schema)),
        _ => Ok(()),
    }
}

fn plan(changes: Vec<trocar_model::Change>, skipped: Vec<trocar_model::Skipped>) -> Plan {
    Plan { changes, skipped }
}
