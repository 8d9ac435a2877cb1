//! A store in memory that fails, breaks or hangs where a test says so.

use std::sync::Arc;

use parking_lot::Mutex;
use trocar_model::Wanted;

use super::super::past::Past;
use super::super::{Loaded, Record, Snapshot, Store, StoreError, Unusable};

/// A store whose content outlives the GCM.
#[derive(Clone, Default)]
pub(super) struct Kept(pub(super) Arc<Mutex<In>>);

#[derive(Default)]
pub(super) struct In {
    pub(super) snapshot: Snapshot,
    pub(super) records: Vec<Record>,
    /// All records ever.
    pub(super) all: Vec<Record>,
    pub(super) fails: Option<Unusable>,
    /// It panics at the next record.
    pub(super) breaks: bool,
    /// It holds the thread as long as somebody has the other end.
    pub(super) hangs: Option<std::sync::mpsc::Receiver<()>>,
}

impl Kept {
    pub(super) fn fail(&self, unusable: Option<Unusable>) {
        self.0.lock().fails = unusable;
    }

    fn state(&self) -> Result<(), StoreError> {
        let fails = self.0.lock().fails;
        let error = |unusable| StoreError { file: "here".into(), unusable, why: "the disk is full".into() };
        fails.map_or(Ok(()), |unusable| Err(error(unusable)))
    }

    /// All that it would tell the next GCM.
    pub(super) fn wanted(&self) -> Wanted {
        let held = self.0.lock();
        let loaded = Loaded { snapshot: held.snapshot.clone(), records: held.records.clone() };
        drop(held);
        Past::of(loaded).wanted
    }

    pub(super) fn texts(&self) -> Vec<String> {
        let held = self.0.lock();
        held.all.iter().filter_map(|record| Some(record.asked.as_ref()?.text.clone())).collect()
    }
}

impl Store for Kept {
    fn load(&mut self) -> Result<Loaded, StoreError> {
        self.state()?;
        let held = self.0.lock();
        Ok(Loaded { snapshot: held.snapshot.clone(), records: held.records.clone() })
    }

    fn append(&mut self, records: &[Record]) -> Result<(), StoreError> {
        let (breaks, hangs) = {
            let mut held = self.0.lock();
            (held.breaks, held.hangs.take())
        };
        if let Some(hangs) = hangs {
            let _ = hangs.recv();
        }
        assert!(!breaks, "a store that breaks");
        self.state()?;
        self.0.lock().records.extend_from_slice(records);
        self.0.lock().all.extend_from_slice(records);
        Ok(())
    }

    fn keep(&mut self, snapshot: &Snapshot) -> Result<(), StoreError> {
        self.state()?;
        let mut held = self.0.lock();
        held.snapshot = snapshot.clone();
        held.records.clear();
        Ok(())
    }
}
