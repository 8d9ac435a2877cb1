//! A GCM among several: it campaigns for the lead, reigns while it has that, and follows otherwise.
//!
//! Invariant: at most one reign at a time; each begins with what is on record and a term of its own. Sessions
//! of a reign outlive a doubt, so that a Stop has a way, but never the loss of its lead.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::HostError;
use crate::control::{PortRules, Seat};
use crate::gcm::{Gcm, GcmConfig, StartError, StoreError, Unusable};
use crate::journal::{Campaign, Candidate, EtcdPlace, EtcdStore, Tenure, Won};
use crate::runtime_dir::RuntimeDir;

/// Interval at which a GCM that follows looks whether anybody leads.
const LOOK: Duration = Duration::from_millis(200);
/// Pause of a GCM that cannot read the journal, so that others may have the lead.
const UNFIT: Duration = Duration::from_secs(5);
/// Time for the last records and the lead, at the end.
const AT_THE_END: Duration = Duration::from_secs(3);

/// The place of a GCM among several.
#[derive(Clone, Debug)]
pub struct Among {
    /// Place of the journal that they share.
    pub place: EtcdPlace,
    /// Address at which others reach this one; `None`: where it listens.
    pub advertise: Option<String>,
    /// Time after which another one leads when the one that does is not heard.
    pub lease: Duration,
}

/// A candidate at work.
pub(super) struct Candidacy {
    end: watch::Sender<bool>,
    task: JoinHandle<()>,
}

struct Standing {
    candidate: Arc<Candidate>,
    seat: Seat,
    rules: PortRules,
    runtime: RuntimeDir,
    /// True: it is to end.
    end: watch::Receiver<bool>,
}

/// A reign that has begun.
struct Reign {
    gcm: Gcm,
    tenure: Tenure,
}

impl Candidacy {
    /// Campaigns once, and on in the background. `listens`: where the seat is served.
    ///
    /// # Errors
    /// The place has no journal that can be read. An etcd that does not answer is waited for.
    pub(super) async fn begin(
        seat: Seat,
        (among, listens): (&Among, String),
        (rules, runtime): (PortRules, RuntimeDir),
    ) -> Result<Candidacy, HostError> {
        let address = among.advertise.clone().unwrap_or(listens);
        let candidate = Candidate::new(&among.place, address, among.lease).map_err(HostError::Journal)?;
        let candidate = Arc::new(candidate);
        let (end, ending) = watch::channel(false);
        let standing = Standing { candidate, seat, rules, runtime, end: ending };
        let reign = match standing.campaign().await {
            Err(HostError::Journal(e)) if !may_pass(&e) => return Err(HostError::Journal(e)),
            Err(e) => {
                log::warn!("this GCM does not lead yet: {e}");
                None
            }
            Ok(reign) => reign,
        };
        let task = tokio::spawn(standing.stand(reign));
        Ok(Candidacy { end, task })
    }

    /// Lets go of the lead in order: what was decided is on record, and another GCM leads at once.
    pub(super) async fn end(mut self) {
        self.end.send_replace(true);
        if tokio::time::timeout(AT_THE_END, &mut self.task).await.is_err() {
            self.task.abort();
        }
    }

    pub(super) fn cut(self) {
        self.task.abort();
    }
}

/// Tells whether the journal may be read at the next attempt.
fn may_pass(error: &StoreError) -> bool {
    matches!(error.unusable, Unusable::Now | Unusable::NotLeading)
}

/// End of a reign.
enum Over {
    /// Another GCM may lead.
    Lost(String),
    /// Its records go nowhere: another GCM may do better.
    Unwritten,
    /// This GCM ends.
    Ends,
}

impl Standing {
    async fn stand(mut self, mut reign: Option<Reign>) {
        loop {
            if let Some(reign) = reign.take() {
                self.reign(reign).await;
            }
            if *self.end.borrow() {
                return;
            }
            let pause = match self.campaign().await {
                Ok(Some(begun)) => {
                    reign = Some(begun);
                    continue;
                }
                Ok(None) => LOOK,
                Err(HostError::Refused(_)) => LOOK,
                Err(HostError::Journal(e)) if may_pass(&e) => LOOK,
                Err(e) => {
                    log::error!("this GCM cannot lead: {e}");
                    UNFIT
                }
            };
            // Its sender lives as long as the host.
            let _ = tokio::time::timeout(pause, self.end.wait_for(|end| *end)).await;
        }
    }

    /// Begins a reign if nobody leads.
    async fn campaign(&self) -> Result<Option<Reign>, HostError> {
        let begun = match self.candidate.campaign().await {
            Ok(Campaign::Won(won)) => self.begin(&won).await.map(Some),
            Ok(Campaign::Follows { leader, beats }) => {
                match (leader.address == self.candidate.address(), beats) {
                    (false, _) => self.seat.follows(&leader.address),
                    (true, false) => {
                        self.seat.knows_no_leader("the GCM that was at its address before may still lead");
                    }
                    (true, true) => self.seat.knows_no_leader(&format!(
                        "another GCM with its address, {}, leads: give each one of its own with --listen, or \
                         with --advertise",
                        leader.address
                    )),
                }
                return Ok(None);
            }
            Err(e) => Err(HostError::Journal(e)),
        };
        begun.inspect_err(|e| self.seat.knows_no_leader(&e.to_string()))
    }

    async fn begin(&self, won: &Won) -> Result<Reign, HostError> {
        let tenure = Tenure::begin(&self.candidate, won);
        match self.resume(won, &tenure).await {
            Ok(gcm) => Ok(Reign { gcm, tenure }),
            Err(e) => {
                tenure.resign().await;
                Err(e)
            }
        }
    }

    async fn resume(&self, won: &Won, tenure: &Tenure) -> Result<Gcm, HostError> {
        let threads = |because: String| HostError::Threads { because };
        let lead = tenure.lead().clone();
        let store =
            EtcdStore::new(self.candidate.place(), won, tenure).map_err(|e| threads(e.to_string()))?;
        let config = GcmConfig { lead: Some(lead.clone()), ..GcmConfig::default() };
        let gcm = Gcm::resume(config, Box::new(store)).await.map_err(|e| match e {
            StartError::Store(e) => HostError::Journal(e),
            StartError::Threads(because) => threads(because),
            StartError::Refused(refusal) => HostError::Refused(refusal),
        })?;
        self.seat.reigns(gcm.clone(), lead, self.rules, Some(&self.runtime)).await?;
        log::info!("this GCM leads in term {}, from revision {}", gcm.term(), gcm.graph().revision);
        Ok(gcm)
    }

    /// Reigns until the lead is lost, or this GCM is to end.
    async fn reign(&mut self, Reign { gcm, tenure }: Reign) {
        let lead = tenure.lead().clone();
        let over = tokio::select! {
            why = lead.lost() => Over::Lost(why),
            () = gcm.journal_ended() => Over::Unwritten,
            _ = self.end.wait_for(|end| *end) => Over::Ends,
        };
        match over {
            Over::Lost(why) => {
                log::warn!("this GCM leads no more: {why}");
                self.seat.knows_no_leader(&why);
            }
            Over::Unwritten => {
                log::error!("this GCM leads no more: its journal is not written any more");
                self.seat.knows_no_leader("its journal is not written any more");
                tenure.resign().await;
            }
            Over::Ends => {
                self.seat.knows_no_leader("it ends");
                gcm.close_journal().await;
                tenure.resign().await;
            }
        }
    }
}
