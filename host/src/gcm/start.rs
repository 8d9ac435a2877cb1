//! Starts a GCM: its settings, its new term, and the task that keeps the phases as long as it lives.
//!
//! Invariant: a GCM that could not make its term durable does not start.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use trocar_model::{Entry, Refusal};

use super::Gcm;
use super::ids::Ids;
use super::journal::{Store, StoreError, Unusable};
use super::lead::Lead;
use super::past::Past;
use super::recording::{Recording, bell, keep_writing};

/// Times a store that cannot be read now is tried before the GCM begins without it.
const LOADS: u32 = 4;
/// Pause between them.
const BETWEEN: Duration = Duration::from_millis(300);

/// Why a GCM does not start.
#[derive(Debug)]
pub enum StartError {
    Store(StoreError),
    Threads(String),
    /// It leads no more, or cannot put its term on record.
    Refused(Refusal),
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            StartError::Store(e) => e.fmt(f),
            StartError::Refused(refusal) => refusal.fmt(f),
            StartError::Threads(why) => write!(f, "the journal gets no thread: {why}"),
        }
    }
}

impl std::error::Error for StartError {}

impl From<StoreError> for StartError {
    fn from(e: StoreError) -> Self {
        StartError::Store(e)
    }
}

/// Settings of a GCM.
#[derive(Clone, Debug)]
pub struct GcmConfig {
    /// Folder of term and epochs; `None` for a system that leaves nothing behind.
    pub state: Option<PathBuf>,
    /// Time for each change that gives a restarted process its components back. A change that hangs costs the
    /// others no more.
    pub each_change: Duration,
    /// The lead of this GCM where several stand for one system: its term and epochs are of that, and only
    /// what is on record counts.
    pub lead: Option<Lead>,
}

impl Default for GcmConfig {
    fn default() -> Self {
        GcmConfig { state: None, each_change: Duration::from_secs(20), lead: None }
    }
}

impl Gcm {
    /// A GCM without processes, in a new term.
    ///
    /// # Errors
    /// The state folder cannot be used.
    pub async fn start(config: GcmConfig) -> Result<Gcm, StartError> {
        let ids = Ids::open(config.state.as_deref());
        let gcm = Gcm::new(ids, (config.each_change, None), &Past::default(), None);
        gcm.keep_phases();
        Ok(gcm)
    }

    /// A GCM that goes on where the one before it ended: what was wanted then is wanted now, and its
    /// processes are LOST until they are here.
    ///
    /// # Errors
    /// The state folder cannot be used; the store is damaged, of a later release, or in use. One that cannot
    /// be read now is tried again, and the GCM begins without it, but for one among several.
    pub async fn resume(config: GcmConfig, store: Box<dyn Store>) -> Result<Gcm, StartError> {
        Gcm::resume_with(config, store, Recording::Thread).await
    }

    /// Does the same as [`Gcm::resume`]; its records go to the store as `recording` says.
    ///
    /// # Errors
    /// As [`Gcm::resume`].
    pub async fn resume_with(
        config: GcmConfig,
        mut store: Box<dyn Store>,
        recording: Recording,
    ) -> Result<Gcm, StartError> {
        let ids = match &config.lead {
            Some(lead) => Ids::of_term(lead.term()),
            None => Ids::open(config.state.as_deref()),
        };
        let never_blocks = matches!(recording, Recording::Task(_));
        let load = move || {
            let mut loaded = store.load();
            for _ in 1..LOADS {
                if !matches!(&loaded, Err(e) if e.unusable == Unusable::Now) {
                    break;
                }
                if !never_blocks {
                    std::thread::sleep(BETWEEN);
                }
                loaded = store.load();
            }
            (store, loaded)
        };
        let (store, loaded) = match never_blocks {
            true => load(),
            false => {
                tokio::task::spawn_blocking(load).await.map_err(|e| StartError::Threads(e.to_string()))?
            }
        };
        let past = match loaded {
            Ok(loaded) => Past::of(loaded),
            Err(e) if e.unusable == Unusable::Now && config.lead.is_none() => {
                log::error!("{e}; this GCM begins without what was decided before");
                Past::default()
            }
            Err(e) => return Err(e.into()),
        };
        // Counters that were lost go on from what is on record.
        let epochs = past.wanted.processes.values().map(|process| process.epoch);
        if let Some(lead) = config.lead.as_ref().filter(|lead| past.wanted.term >= lead.term()) {
            let (term, won) = (past.wanted.term, lead.term());
            let why = format!(
                "it has records of term {term}, and this GCM was given term {won}: the count of terms was changed"
            );
            lead.lose(&why);
            return Err(StoreError { file: "the journal".into(), unusable: Unusable::Damaged, why }.into());
        }
        ids.goes_on_from(past.wanted.term, epochs.max().unwrap_or_default());
        let (bell, rung) = bell(recording);
        let gcm = Gcm::new(ids, (config.each_change, config.lead), &past, Some(bell));
        keep_writing(&gcm.inner, store, rung, past).map_err(|e| StartError::Threads(e.to_string()))?;
        // On record before anything is decided by it.
        let begun = gcm.enter(Entry::Noted);
        gcm.inner.ledger.durable(begun).await.map_err(StartError::Refused)?;
        gcm.keep_phases();
        Ok(gcm)
    }
}
