//! The fold of all records that a store has, from which the next GCM goes on.
//!
//! Invariant: a snapshot is the fold of exactly the records that the store has.

use trocar_model::{Entry, Wanted};

use super::journal::{Loaded, Record, Remembered, Snapshot, Store, StoreError};
use super::ledger::Batch;
use super::requests::Answers;
use super::weight::weight;

/// Records after which the fold of all is kept, and bytes: a load reads hardly more than these.
const KEEP: (usize, usize) = (1024, 16 << 20);
/// The fold of all records that a store has.
#[derive(Default)]
pub(super) struct Past {
    pub(super) wanted: Wanted,
    pub(super) answers: Answers,
    /// Records beside the snapshot of the store, and their bytes.
    beside: (usize, usize),
    /// False: what the store has is not known.
    pub(super) is_loaded: bool,
}

impl Past {
    /// Folds what a store has.
    pub(super) fn of(Loaded { snapshot, records }: Loaded) -> Past {
        let Snapshot { wanted, answers } = snapshot;
        let mut past = Past { wanted, is_loaded: true, ..Past::default() };
        answers.into_iter().for_each(|answer| past.answers.put(answer));
        past.on(&records);
        past
    }

    fn on(&mut self, records: &[Record]) {
        for record in records {
            self.wanted.on(&record.entry);
            self.wanted.term = self.wanted.term.max(record.term);
            self.beside.0 += 1;
            self.beside.1 += weight(record);
            let (Some(asked), Some(answer)) = (&record.asked, &record.answer) else { continue };
            // A Stop is never answered from memory.
            if !asked.request_id.is_empty() && !matches!(record.entry, Entry::Stopped { .. }) {
                let (wall_ns, asked, answer) = (record.wall_ns, asked.clone(), answer.clone());
                self.answers.put(Remembered { wall_ns, asked, answer });
            }
        }
    }

    fn is_long(&self) -> bool {
        self.beside.0 >= KEEP.0 || self.beside.1 >= KEEP.1
    }

    fn snapshot(&self) -> Snapshot {
        Snapshot { wanted: self.wanted.clone(), answers: self.answers.remembered() }
    }

    /// Brings records to the store.
    pub(super) fn put(&mut self, store: &mut dyn Store, batch: &Batch) -> Result<(), StoreError> {
        let Some((_, wanted)) = &batch.anew else {
            store.append(&batch.records)?;
            self.on(&batch.records);
            if self.is_long() {
                // The records are there all the same.
                match store.keep(&self.snapshot()) {
                    Ok(()) => self.beside = (0, 0),
                    Err(e) => log::warn!("the journal is not folded yet: {e}"),
                }
            }
            return Ok(());
        };
        // The wanted part is known then, although not how it came to be. The records behind that lead to the
        // same once more.
        let whole = Snapshot { wanted: wanted.clone(), answers: self.answers.remembered() };
        store.keep(&whole)?;
        self.beside = (0, 0);
        store.append(&batch.records)?;
        self.on(&batch.records);
        self.wanted.clone_from(wanted);
        // To this, whatever the records would lead to.
        store.keep(&self.snapshot())?;
        self.beside = (0, 0);
        Ok(())
    }
}
