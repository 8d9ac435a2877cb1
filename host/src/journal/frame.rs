//! Parts that every journal has, wherever it lies: identity, head, and the chain of its records.
//!
//! Invariant: a record counts only when it follows the one before it, by number and by hash, and the newest
//! is the one that the head names. No store judges this by itself.

use std::time::{SystemTime, UNIX_EPOCH};

use prost::Message;
use trocar_proto::journal::v1 as wire;

use super::SCHEMA;
use super::chain::{self, Hash};
use super::codec;
use super::fault::{Bad, Res};
use crate::gcm::Record;

/// The journal itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Random.
    pub id: u128,
    /// Time of day at which it was made, ns since 1970 (UTC).
    pub created_ns: u64,
}

impl Identity {
    pub(super) fn new() -> Res<Identity> {
        let created = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(Identity { id: random()?, created_ns: created.as_nanos() as u64 })
    }

    pub(super) fn encoded(&self) -> Vec<u8> {
        let Identity { id, created_ns } = *self;
        wire::Identity { schema: SCHEMA, id: id.to_be_bytes().to_vec(), created_ns }.encode_to_vec()
    }
}

/// A number that nobody else has.
pub(super) fn random() -> Res<u128> {
    let mut id = [0; 16];
    rustix::rand::getrandom(&mut id, rustix::rand::GetRandomFlags::empty())
        .map_err(|e| Bad::now(format!("no random numbers for its id: {e}")))?;
    Ok(u128::from_be_bytes(id))
}

/// A record that is kept.
#[derive(Clone, Debug)]
pub struct Kept {
    /// The first is 1.
    pub number: u64,
    /// Hash of the record as it is encoded.
    pub hash: Hash,
    pub record: Record,
}

/// The newest record, and all that is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Head {
    /// 0: no record.
    pub(super) number: u64,
    pub(super) hash: Hash,
    /// All records, bytes.
    pub(super) bytes: u64,
}

impl Head {
    /// The head of a journal without records, whose identity is encoded so.
    pub(super) fn of_none(identity: &[u8]) -> Head {
        Head { number: 0, hash: Hash::of(identity), bytes: 0 }
    }

    /// Returns the head with one more record, if all then have no more than `most` bytes.
    pub(super) fn with(&self, record: &[u8], most: u64) -> Res<Head> {
        let bytes = self.bytes + record.len() as u64;
        if bytes > most {
            let why =
                format!("its records would have more than {most} bytes: a snapshot has to be kept first");
            return Err(Bad::now(why));
        }
        Ok(Head { number: self.number + 1, hash: Hash::of(record), bytes })
    }

    pub(super) fn encoded(&self) -> Vec<u8> {
        let Head { number, hash, bytes } = self;
        wire::Head { number: *number, hash: hash.bytes().to_vec(), bytes: *bytes }.encode_to_vec()
    }
}

/// Records that the audit keeps of those a snapshot folds, and how many there may be before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) records: u64,
    pub(super) bytes: u64,
    /// Bytes of all records up to which more are added.
    pub(super) unfolded: u64,
}

/// Identity and head.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) identity: Identity,
    pub(super) head: Head,
    /// Stands in the first record for the hash of the one before it.
    pub(super) origin: Hash,
}

impl Frame {
    pub(super) fn read(identity: &[u8], head: &[u8]) -> Res<Frame> {
        codec::check_schema(identity, "the journal")?;
        let origin = Hash::of(identity);
        let identity: wire::Identity = codec::decoded(identity)?;
        let id = identity.id.as_slice().try_into().map_err(|_| Bad::damaged("its id has not 16 bytes"))?;
        let identity = Identity { id: u128::from_be_bytes(id), created_ns: identity.created_ns };
        let head: wire::Head = codec::decoded(head)?;
        let hash = chain::read(&head.hash, "the hash of the newest record")?;
        let head = Head { number: head.number, hash, bytes: head.bytes };
        Ok(Frame { identity, head, origin })
    }
}

/// A walk along the chain, from an older record to the head.
pub(super) struct Walk<'f> {
    frame: &'f Frame,
    /// The record that the next one follows, where it is known.
    last: Option<(u64, Hash)>,
}

impl<'f> Walk<'f> {
    pub(super) fn new(frame: &'f Frame, after: Option<(u64, Hash)>) -> Walk<'f> {
        Walk { frame, last: after }
    }

    /// Checks the record that lies under that number, and returns it.
    pub(super) fn next(&mut self, number: u64, bytes: &[u8]) -> Res<Kept> {
        let head = &self.frame.head;
        let wrong = |why: String| Bad::damaged(why).in_record(number);
        let follows = self.last.map(|(last, _)| last + 1);
        if let Some(missing) = follows.filter(|follows| *follows != number) {
            return Err(Bad::damaged("it is missing").in_record(missing));
        }
        let linked = codec::record_in(bytes).map_err(|bad| bad.in_record(number))?;
        if linked.number != number {
            return Err(wrong(format!("it says that it is record {}", linked.number)));
        }
        let before = if number == 1 { Some(self.frame.origin) } else { self.last.map(|(_, hash)| hash) };
        if before.is_some_and(|before| before != linked.before) {
            return Err(wrong("it does not follow the record before it: one of the two was changed".into()));
        }
        let hash = Hash::of(bytes);
        if number == head.number && hash != head.hash {
            return Err(wrong("it was changed: it has another hash than the journal's head says".into()));
        }
        if number > head.number {
            return Err(wrong(format!("the journal's head is record {}", head.number)));
        }
        self.last = Some((number, hash));
        Ok(Kept { number, hash, record: linked.record })
    }

    /// Checks that the walk has come to the head.
    pub(super) fn end(self) -> Res<()> {
        let Frame { head, origin, .. } = self.frame;
        let (number, hash) = self.last.unwrap_or((0, *origin));
        if number != head.number {
            return Err(Bad::damaged("it is missing").in_record(number + 1));
        }
        if hash != head.hash {
            let why = format!("the snapshot of record {number} and the journal's head name different hashes");
            return Err(Bad::damaged(why));
        }
        Ok(())
    }
}
