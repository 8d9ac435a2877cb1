//! Holds components for the program that made them: a recorder whose `trocar record` was killed is removed.
//!
//! Invariant: a component is removed only while its hold counts; a removal that fails is tried again.

use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;
use trocar_model::{ComponentId, Refusal, Request};

use super::{ExecuteOptions, Gcm};

/// Pause before a removal that failed is tried again, for one because the process is lost.
const AGAIN: Duration = Duration::from_secs(1);
/// Time in which a caller whose connection broke may hold again: the component is not removed before.
const GRACE: Duration = Duration::from_secs(1);
/// Time for which a process that is not known is waited for: a GCM that was started again hears of its
/// processes one by one.
const UNKNOWN: Duration = Duration::from_secs(60);

/// A component that is held, until it is removed or another call holds it; ended by [`Held::end`] or
/// [`Held::let_go`].
pub struct Held {
    gcm: Gcm,
    pub component: ComponentId,
    identity: String,
    over: watch::Receiver<()>,
}

impl Gcm {
    /// Holds a component, which need not be there yet. `identity`: the caller, for the audit line of its
    /// removal.
    ///
    /// # Errors
    /// There are too many holds.
    pub fn hold(&self, component: ComponentId, identity: String) -> Result<Held, Refusal> {
        let over = self.inner.holds.lock().hold(&component)?;
        Ok(Held { gcm: self.clone(), component, identity, over })
    }
}

impl Held {
    /// Returns when there is nothing to be held any more: the component was removed, or another call holds
    /// it.
    pub async fn over(&mut self) {
        // Nothing is ever sent.
        let _ = self.over.changed().await;
    }

    /// The holder goes and the component stays.
    pub fn let_go(self) {
        let mut holds = self.gcm.inner.holds.lock();
        // Under the lock: no other call holds it now.
        if !self.is_over() {
            holds.removed(&self.component);
        }
    }

    /// The holder has gone: the component is stopped and removed, unless another call holds it in a moment,
    /// or as soon as its process lets it.
    pub async fn end(mut self) {
        let _ = tokio::time::timeout(GRACE, self.over()).await;
        let (mut said, since) = (false, Instant::now());
        while !self.is_over() {
            let remove = Request::Remove { id: self.component.clone(), force: true };
            let identity = format!("{}, whose hold has ended,", self.identity);
            let options = ExecuteOptions { identity, ..ExecuteOptions::default() };
            match self.gcm.execute(vec![remove], options).await {
                Ok(_) => log::info!("{} is removed: its holder has gone", self.component),
                Err(Refusal::ComponentNotFound { .. }) => {}
                Err(Refusal::ProcessNotFound { .. }) if since.elapsed() >= UNKNOWN => {}
                Err(Refusal::ProcessNotFound { .. }) => {
                    let _ = tokio::time::timeout(AGAIN, self.over()).await;
                    continue;
                }
                Err(refusal) => {
                    if !std::mem::replace(&mut said, true) {
                        log::warn!(
                            "{}: its holder has gone, and it cannot be removed yet: {refusal}",
                            self.component
                        );
                    }
                    let _ = tokio::time::timeout(AGAIN, self.over()).await;
                    continue;
                }
            }
            return self.let_go();
        }
    }

    fn is_over(&self) -> bool {
        self.over.has_changed().is_err()
    }
}
