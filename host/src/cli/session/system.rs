//! The questions of `up`: a whole system at once, and what became of its processes.

use std::time::Duration;

use trocar_model::Request;
use trocar_proto::v1;

use super::Session;
use super::changes::outcome;
use crate::cli::convert;
use crate::cli::failure::Failure;
use crate::cli::mutation::Outcome;
use crate::gcm::Told;

impl Session {
    /// All of the requests as one change.
    pub(in crate::cli) async fn apply(
        &self,
        requests: &[Request],
        within: Duration,
    ) -> Result<Outcome, Failure> {
        if requests.is_empty() {
            return Ok(Outcome::default());
        }
        let steps = requests.iter().map(convert::step).collect();
        let mut ask = tonic::Request::new(v1::ApplyRequest { steps, ..v1::ApplyRequest::default() });
        ask.set_timeout(within);
        let a = self.client().await?.gcm.apply(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }

    /// Stops what matches, in order; where nothing does, nothing has to be stopped.
    pub(in crate::cli) async fn stop_all_of(
        &self,
        paths: &[String],
        within: Duration,
    ) -> Result<(), Failure> {
        for path in paths {
            let mut ask =
                tonic::Request::new(v1::StopRequest { path: path.clone(), ..v1::StopRequest::default() });
            ask.set_timeout(within);
            match self.client().await?.gcm.stop(ask).await {
                Ok(_) => {}
                Err(status) if status.code() == tonic::Code::NotFound => {}
                Err(status) => return Err(self.failed(&status)),
            }
        }
        Ok(())
    }

    /// Tells the GCM how processes stand.
    pub(in crate::cli) async fn tell(&self, all: &[Told]) -> Result<(), Failure> {
        let processes = all.iter().map(convert::fate).collect();
        let mut ask = tonic::Request::new(v1::TellRequest { processes });
        ask.set_timeout(Duration::from_secs(2));
        self.client().await?.attach.tell(ask).await.map_err(|s| self.failed(&s))?;
        Ok(())
    }
}
