//! The questions of `up`, `apply`, `diff` and `save`: a whole system at once, and what became of its
//! processes.

use std::path::Path;
use std::time::Duration;

use trocar_model::{Refusal, Request};
use trocar_proto::v1;

use super::changes::{outcome, timed};
use super::{Follow, Session};
use crate::convert;
use crate::failure::Failure;
use crate::mutation::{MutationArgs, Outcome};
use crate::view::SystemView;
use trocar::gcm::{Orders, Supervisor, Told};

impl Session {
    /// Carries out all requests as one change.
    pub(crate) async fn apply(&self, requests: &[Request], within: Duration) -> Result<Outcome, Failure> {
        self.apply_at(requests, within, None).await
    }

    /// The same, refused with REVISION_CONFLICT when the system has changed since that revision.
    pub(crate) async fn apply_at(
        &self,
        requests: &[Request],
        within: Duration,
        expected_revision: Option<u64>,
    ) -> Result<Outcome, Failure> {
        if requests.is_empty() {
            return Ok(Outcome::default());
        }
        let steps = requests.iter().map(convert::step).collect();
        let ask = v1::ApplyRequest { steps, expected_revision, ..v1::ApplyRequest::default() };
        let mut ask = tonic::Request::new(ask);
        ask.set_timeout(within);
        let a = self.client().await?.gcm.apply(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }

    /// Makes the system what the text of a system file says.
    pub(crate) async fn apply_system(
        &self,
        system: &str,
        prune: bool,
        m: &MutationArgs,
    ) -> Result<Outcome, Failure> {
        let ask = v1::ApplyRequest {
            system: system.to_owned(),
            prune,
            validate_only: m.dry_run,
            expected_revision: m.expected_revision,
            ..v1::ApplyRequest::default()
        };
        let ask = timed(ask, m);
        let a = self.client().await?.gcm.apply(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }

    /// Compares the system with what the text of a system file says.
    pub(crate) async fn compare(&self, system: &str) -> Result<v1::CompareResponse, Failure> {
        let ask = v1::CompareRequest { system: system.to_owned() };
        let answer = self.client().await?.gcm.compare(ask).await.map_err(|s| self.failed(&s))?;
        Ok(answer.into_inner())
    }

    /// The system as the text of a file that lies in a directory.
    pub(crate) async fn save(&self, folder: &Path) -> Result<v1::SaveResponse, Failure> {
        let ask = v1::SaveRequest { folder: folder.to_string_lossy().into_owned() };
        let answer = self.client().await?.gcm.save(ask).await.map_err(|s| self.failed(&s))?;
        Ok(answer.into_inner())
    }

    /// Returns the state of the system from the GCM alone: soon answered, without live figures.
    pub(crate) async fn standing(&self) -> Result<SystemView, Failure> {
        self.looked(true, Duration::from_secs(5)).await
    }

    /// Returns the state of the system, with live figures of all processes that give some.
    pub(crate) async fn figures(&self) -> Result<SystemView, Failure> {
        self.looked(false, Duration::from_secs(10)).await
    }

    async fn looked(&self, brief: bool, within: Duration) -> Result<SystemView, Failure> {
        let mut ask = tonic::Request::new(v1::ListRequest { brief, ..v1::ListRequest::default() });
        ask.set_timeout(within);
        let answer = self.client().await?.gcm.list(ask).await.map_err(|s| self.failed(&s))?;
        Ok(convert::system(answer.get_ref()))
    }

    /// Stops what matches one of these, in order; where nothing does, nothing has to be stopped.
    pub(crate) async fn stop_all_of(&self, paths: Vec<String>, within: Duration) -> Result<(), Failure> {
        let ask = || {
            let mut ask = tonic::Request::new(v1::StopRequest { paths: paths.clone(), ..Default::default() });
            ask.set_timeout(within);
            ask
        };
        match self.stopped(ask).await? {
            Ok(_) => Ok(()),
            Err(status) if status.code() == tonic::Code::NotFound => Ok(()),
            Err(status) => Err(self.failed(&status)),
        }
    }

    /// Follows which processes are wanted for isolated components, now and later, with the
    /// incarnation of the GCM.
    pub(crate) async fn supervise(
        &self,
        who: &Supervisor,
    ) -> Result<Follow<'_, v1::SuperviseResponse, Result<(u64, Orders), Refusal>>, Failure> {
        let ask = convert::supervisor(who);
        let stream =
            self.client().await?.attach.supervise(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(Follow { session: self, stream, view: convert::wanted })
    }

    /// Tells the GCM how processes stand.
    pub(crate) async fn tell(&self, all: &[Told]) -> Result<(), Failure> {
        let processes = all.iter().map(convert::fate).collect();
        let mut ask = tonic::Request::new(v1::TellRequest { processes });
        ask.set_timeout(Duration::from_secs(2));
        self.client().await?.attach.tell(ask).await.map_err(|s| self.failed(&s))?;
        Ok(())
    }
}
