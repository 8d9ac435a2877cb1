//! The store of a GCM in etcd.
//!
//! Invariant: it writes only while its GCM leads and the head is as it has left it; one append counts as a
//! whole, with the head. After an error it looks what is there before it writes again, and takes back what a
//! call has written that said it had failed.

use std::io;
use std::path::PathBuf;
use std::time::Duration;

use tokio::runtime::{Builder, Runtime};

use super::campaign::Won;
use super::client::{Client, delete};
use super::keys::Keys;
use super::place::EtcdPlace;
use super::reading::{self, Parts, Roots};
use super::tenure::Tenure;
use super::writing::{self, Held, Operation, Puts, commit};
use crate::gcm::{Lead, Loaded, Record, Snapshot, Store, StoreError, Unusable};
use crate::journal::chain::Hash;
use crate::journal::codec;
use crate::journal::fault::{Bad, Res};
use crate::journal::frame::{Bounds, Head, Identity};

/// Bounds of the audit: 20 000 records, 32 MiB. By default etcd takes 2 GiB, with all that was there since it
/// was compacted last.
const KEPT: Bounds = Bounds { records: 20_000, bytes: 32 << 20, unfolded: 256 << 20 };

/// A journal in etcd, for the GCM that leads.
pub struct EtcdStore {
    place: EtcdPlace,
    /// A runtime of its own, since a store is used on a thread that may block. `None`: it is dropped.
    runtime: Option<Runtime>,
    within: Within,
    known: Option<Known>,
    /// The head to which a change was to lead of which nobody knows whether it was done.
    doubt: Option<Head>,
}

/// The part that calls.
struct Within {
    client: Client,
    keys: Keys,
    term: i64,
    lead: Lead,
    bounds: Bounds,
}

/// The journal as the last success left it.
#[derive(Clone, Copy)]
struct Known {
    identity: Identity,
    head: Head,
    /// Revision at which the head was written.
    head_at: i64,
    /// Number of the newest snapshot; 0: none.
    generation: u64,
}

impl Known {
    fn of(roots: &Roots) -> Known {
        let generation = roots.snapshot.map_or(0, |snapshot| snapshot.generation);
        Known { identity: roots.frame.identity, head: roots.frame.head, head_at: roots.head_at, generation }
    }
}

impl EtcdStore {
    /// The journal of the system at that place, for a GCM that has won the lead there.
    ///
    /// # Errors
    /// The machine gives nothing to wait for sockets with.
    pub fn new(place: &EtcdPlace, won: &Won, tenure: &Tenure) -> io::Result<EtcdStore> {
        let runtime = Builder::new_current_thread().enable_all().build()?;
        let within = Within {
            client: tenure.client(place),
            keys: Keys::new(place.prefix()),
            term: won.at,
            lead: tenure.lead().clone(),
            bounds: KEPT,
        };
        Ok(EtcdStore { place: place.clone(), runtime: Some(runtime), within, known: None, doubt: None })
    }

    #[cfg(test)]
    pub(in crate::journal) fn with(mut self, bounds: Bounds) -> EtcdStore {
        self.within.bounds = bounds;
        self
    }

    /// Uses the journal. A lead that is lost is told to all who decide by it.
    fn used<T>(&mut self, run: impl AsyncFnOnce(&mut Use<'_>) -> Res<T>) -> Result<T, StoreError> {
        let file = PathBuf::from(self.place.to_string());
        let EtcdStore { runtime, within, known, doubt, .. } = self;
        let mut using = Use { within, known, doubt };
        let done = match runtime {
            Some(runtime) => runtime.block_on(run(&mut using)),
            None => Err(Bad::now("it is closed")),
        };
        done.map_err(|bad| {
            if bad.unusable == Unusable::NotLeading {
                self.within.lead.lose(&bad.why);
            }
            bad.of(&file).error
        })
    }
}

impl Drop for EtcdStore {
    fn drop(&mut self) {
        // It may be dropped in a task, where none may wait for a runtime to end.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::ZERO);
        }
    }
}

/// One use.
struct Use<'s> {
    within: &'s Within,
    known: &'s mut Option<Known>,
    doubt: &'s mut Option<Head>,
}

impl Use<'_> {
    fn held(&self, head: i64) -> Held {
        Held { term: self.within.term, head }
    }

    async fn read(&mut self) -> Res<Loaded> {
        let Within { client, keys, .. } = self.within;
        (*self.known, *self.doubt) = (None, None);
        let roots = match reading::roots(client, keys).await? {
            Some(roots) => roots,
            None => {
                self.lay().await?;
                let laid = reading::roots(client, keys).await?;
                laid.ok_or_else(|| Bad::now("it was removed as soon as it was made"))?
            }
        };
        let loaded = reading::load(client, keys, &roots).await?;
        *self.known = Some(Known::of(&roots));
        Ok(loaded)
    }

    /// Makes a new journal.
    async fn lay(&mut self) -> Res<()> {
        let Within { client, keys, .. } = self.within;
        let identity = Identity::new()?.encoded();
        let mut puts = Puts::default();
        puts.put(keys.identity(), &identity);
        let head = Head::of_none(&identity).encoded();
        commit(client, keys, self.held(0), puts, Vec::new(), head).await?;
        Ok(())
    }

    /// Returns the journal to go on with; after an error, what is there is looked at first.
    async fn known(&mut self) -> Res<Known> {
        let unloaded = || Bad::now("what it has was not loaded: load it before anything is added");
        let known = self.known.ok_or_else(unloaded)?;
        let Some(doubt) = *self.doubt else { return Ok(known) };
        let Within { client, keys, .. } = self.within;
        let roots = reading::roots(client, keys).await?;
        let found = Known::of(&roots.ok_or_else(|| Bad::damaged("it was removed"))?);
        if found.identity != known.identity {
            return Err(Bad::damaged("another journal was put in its place"));
        }
        if found.head != known.head && found.head != doubt {
            return Err(Bad::damaged(format!(
                "another process wrote it: its newest record is {}, and not {} as it was",
                found.head.number, known.head.number
            )));
        }
        // A snapshot is not taken back. Records are: they are tried again. Either way the head is written
        // anew, so that a call that may still be under way comes too late.
        let head = if found.head.number == known.head.number { found.head } else { known.head };
        let cut = vec![delete(keys.records_from(head.number + 1))];
        let held = self.held(found.head_at);
        let head_at = commit(client, keys, held, Puts::default(), cut, head.encoded()).await?;
        let known = Known { head, head_at, ..found };
        (*self.known, *self.doubt) = (Some(known), None);
        Ok(known)
    }

    /// Commits what leads from one head to another.
    async fn commit(&mut self, known: Known, puts: Puts, then: Vec<Operation>, head: Head) -> Res<Known> {
        let Within { client, keys, .. } = self.within;
        *self.doubt = Some(head);
        let head_at = commit(client, keys, self.held(known.head_at), puts, then, head.encoded()).await?;
        let known = Known { head, head_at, ..known };
        (*self.known, *self.doubt) = (Some(known), None);
        Ok(known)
    }

    async fn add(&mut self, records: &[Record]) -> Res<()> {
        let known = self.known().await?;
        let keys = &self.within.keys;
        let (mut head, mut puts) = (known.head, Puts::default());
        for record in records {
            let bytes = codec::record(record, head.number + 1, &head.hash);
            head = head.with(&bytes, self.within.bounds.unfolded)?;
            puts.pieces(&bytes, |part| keys.record(head.number, part));
        }
        let beyond = vec![delete(keys.records_from(head.number + 1))];
        self.commit(known, puts, beyond, head).await?;
        Ok(())
    }

    async fn fold(&mut self, snapshot: &Snapshot) -> Res<()> {
        let known = self.known().await?;
        let keys = &self.within.keys;
        let bytes = codec::snapshot(snapshot, known.head.number, &known.head.hash);
        let generation = known.generation + 1;
        let mut puts = Puts::default();
        let count = puts.pieces(&bytes, |part| keys.part(generation, part));
        let parts = Parts { generation, parts: count as u32, hash: Hash::of(&bytes) };
        puts.put(keys.snapshot(), &parts.encoded());
        let (first, head) = self.outgrown(known.head).await?;
        let then = writing::outdated(keys, first, (generation, count));
        let known = self.commit(known, puts, then, head).await?;
        *self.known = Some(Known { generation, ..known });
        Ok(())
    }

    /// Returns the oldest record that the audit keeps, and the head when those before it are gone.
    async fn outgrown(&self, head: Head) -> Res<(u64, Head)> {
        let Within { client, keys, bounds, .. } = self.within;
        let (mut left, mut first) = (head, 0);
        reading::oldest(client, keys, |number, bytes| {
            // All parts of a record go with its first.
            let goes = number < first || {
                let count = (head.number + 1).saturating_sub(number);
                // The newest stays: it is what the next one follows.
                count > 1 && (count > bounds.records || left.bytes > bounds.bytes)
            };
            if goes {
                (left.bytes, first) = (left.bytes.saturating_sub(bytes), number + 1);
            }
            !goes
        })
        .await?;
        Ok((first, left))
    }
}

impl Store for EtcdStore {
    fn load(&mut self) -> Result<Loaded, StoreError> {
        self.used(async |using| using.read().await)
    }

    fn append(&mut self, records: &[Record]) -> Result<(), StoreError> {
        if records.is_empty() {
            return Ok(());
        }
        self.used(async |using| using.add(records).await)
    }

    fn keep(&mut self, snapshot: &Snapshot) -> Result<(), StoreError> {
        self.used(async |using| using.fold(snapshot).await)
    }
}
