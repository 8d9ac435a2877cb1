//! Starts a GCM: its settings, its new term, and the task that keeps the phases as long as it lives.
//!
//! Invariant: a GCM that could not make its term durable does not start.

use std::path::PathBuf;
use std::time::Duration;

use super::Gcm;
use super::ids::{Ids, IdsError};

/// Settings of a GCM.
#[derive(Clone, Debug)]
pub struct GcmConfig {
    /// Folder of term and epochs; `None` for a system that leaves nothing behind.
    pub state: Option<PathBuf>,
    /// Time for each change that gives a restarted process its components back. A change that hangs costs the
    /// others no more.
    pub each_change: Duration,
}

impl Default for GcmConfig {
    fn default() -> Self {
        GcmConfig { state: None, each_change: Duration::from_secs(20) }
    }
}

impl Gcm {
    /// A GCM without processes, in a new term.
    ///
    /// # Errors
    /// The state folder cannot be used.
    pub async fn start(config: GcmConfig) -> Result<Gcm, IdsError> {
        let gcm = Gcm::new(Ids::open(config.state.as_deref())?, config.each_change);
        gcm.keep_phases();
        Ok(gcm)
    }
}
