//! Processes that are heard: their LCMs, the news of theirs that is waited for, and their loss.
//!
//! Invariant: the loss of a session that was replaced changes nothing.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::oneshot;
use trocar_lcm_api::Lcm;
use trocar_model::{Name, Refusal};

use super::Gcm;

/// Longest wait until the news of an LCM is entered: it lies here already, unless some was lost and is asked
/// for again.
const ENTERED: Duration = Duration::from_millis(500);

impl Gcm {
    /// Enters that a process is gone or silent; its components stay listed as LOST. Ignored for an older
    /// session.
    pub fn lost(&self, process: &Name, session: u64) {
        let mut epoch = None;
        self.edit(|graph| epoch = self.inner.sessions.lock().lose(graph, process, session));
        said_lost(process, epoch);
    }

    /// The LCM of a process that is heard.
    ///
    /// # Errors
    /// ProcessNotFound, ProcessLost.
    pub fn lcm_of(&self, process: &Name) -> Result<Arc<dyn Lcm>, Refusal> {
        if let Some(lcm) = self.inner.sessions.lock().lcm(process) {
            return Ok(lcm);
        }
        let graph = self.graph();
        Err(graph.process(process).map_or_else(|unknown| unknown, |known| known.lost(process)))
    }

    /// Waits until the graph has what the LCM of a process has told so far. An LCM tells its news before it
    /// answers. So a caller that passes on a refusal after this can be sure that the next look shows its
    /// result, a FAULT for one.
    pub async fn hear_out(&self, process: &Name) {
        let asks = self.inner.sessions.lock().asks(process);
        let Some(asks) = asks else { return };
        let entered = async {
            let (tell, told) = oneshot::channel();
            // A session that ends meanwhile has nothing more to be entered.
            if asks.send(tell).await.is_ok() {
                let _ = told.await;
            }
        };
        // News that takes longer is a gap, and is entered when it was asked for again.
        let _ = tokio::time::timeout(ENTERED, entered).await;
    }

    /// True while that session of the process is the one that counts.
    pub fn hears(&self, process: &Name, session: u64) -> bool {
        self.inner.sessions.lock().holder(process) == Some(session)
    }
}

pub(super) fn said_lost(process: &Name, epoch: Option<u64>) {
    if let Some(epoch) = epoch {
        log::warn!("process {process} is lost (epoch {epoch})");
    }
}
