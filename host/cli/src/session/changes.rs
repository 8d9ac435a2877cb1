//! The questions that change the system: one method per verb.
//!
//! Invariant: every one passes on dry run, expected revision and timeout as they were typed.

use std::time::Duration;

use trocar_proto::v1;

use super::Session;
use crate::configure::ConfigureArgs;
use crate::connect::{ConnectArgs, Cut};
use crate::convert;
use crate::create::{CreateArgs, Isolation};
use crate::failure::Failure;
use crate::mutation::{Left, MutationArgs, Outcome, Standing};
use crate::states::Verb;

impl Session {
    pub(crate) async fn create(&self, args: &CreateArgs) -> Result<Outcome, Failure> {
        let ask = v1::CreateRequest {
            path: args.path.clone(),
            class: args.class.clone(),
            config: args.config.as_ref().map(convert::to_struct),
            execution: (!args.execution.is_empty()).then(|| convert::typed_execution(&args.execution)),
            isolation: args.isolation.map(|Isolation::Process| "process".to_owned()).unwrap_or_default(),
            validate_only: args.mutation.dry_run,
            expected_revision: args.mutation.expected_revision,
            ..v1::CreateRequest::default()
        };
        let ask = timed(ask, &args.mutation);
        let a = self.client().await?.gcm.create(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }

    pub(crate) async fn configure(&self, args: &ConfigureArgs) -> Result<Outcome, Failure> {
        let ask = v1::ConfigureRequest {
            path: args.path.clone(),
            config: args.config.as_ref().map(convert::to_struct),
            execution: (!args.execution.is_empty()).then(|| convert::typed_execution(&args.execution)),
            validate_only: args.mutation.dry_run,
            expected_revision: args.mutation.expected_revision,
            ..v1::ConfigureRequest::default()
        };
        let ask = timed(ask, &args.mutation);
        let a = self.client().await?.gcm.configure(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }

    pub(crate) async fn verb(
        &self,
        verb: Verb,
        paths: &[String],
        m: &MutationArgs,
    ) -> Result<Outcome, Failure> {
        macro_rules! ask {
            ($request:ident, $method:ident) => {{
                let ask = v1::$request {
                    paths: paths.to_vec(),
                    validate_only: m.dry_run,
                    expected_revision: m.expected_revision,
                    ..v1::$request::default()
                };
                let a = self.client().await?.gcm.$method(timed(ask, m)).await;
                let a = a.map_err(|s| self.failed(&s))?.into_inner();
                outcome(a.revision, a.plan, a.components, a.skipped, a.warnings)
            }};
        }
        Ok(match verb {
            Verb::Start => ask!(StartRequest, start),
            Verb::Stop => self.stop(paths, m).await?,
            Verb::Resume => ask!(ResumeRequest, resume),
            Verb::Reset => ask!(ResetRequest, reset),
        })
    }

    async fn stop(&self, paths: &[String], m: &MutationArgs) -> Result<Outcome, Failure> {
        let ask = || {
            let ask = v1::StopRequest {
                paths: paths.to_vec(),
                validate_only: m.dry_run,
                expected_revision: m.expected_revision,
                ..v1::StopRequest::default()
            };
            timed(ask, m)
        };
        let a = self.stopped(ask).await?.map_err(|s| self.failed(&s))?;
        Ok(with_failures(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings), a.failed))
    }

    /// Removes all of them, or none.
    pub(crate) async fn remove(
        &self,
        paths: &[String],
        force: bool,
        m: &MutationArgs,
    ) -> Result<Outcome, Failure> {
        let one = |path: &String| v1::Step {
            step: Some(v1::step::Step::Remove(v1::RemoveRequest {
                path: path.clone(),
                force,
                ..v1::RemoveRequest::default()
            })),
        };
        self.all_or_none(paths.iter().map(one).collect(), m).await
    }

    /// Takes all of these processes off the list, or none.
    pub(crate) async fn forget(&self, processes: &[String], m: &MutationArgs) -> Result<Outcome, Failure> {
        let one = |process: &String| v1::Step {
            step: Some(v1::step::Step::Forget(v1::ForgetRequest {
                process: process.clone(),
                ..v1::ForgetRequest::default()
            })),
        };
        self.all_or_none(processes.iter().map(one).collect(), m).await
    }

    async fn all_or_none(&self, steps: Vec<v1::Step>, m: &MutationArgs) -> Result<Outcome, Failure> {
        let ask = v1::ApplyRequest {
            steps,
            validate_only: m.dry_run,
            expected_revision: m.expected_revision,
            ..v1::ApplyRequest::default()
        };
        let a =
            self.client().await?.gcm.apply(timed(ask, m)).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }

    /// Waits until it is there again; answers the revision then, and its incarnation.
    pub(crate) async fn restart(&self, process: &str, within: Duration) -> Result<(u64, u64), Failure> {
        let mut ask = tonic::Request::new(v1::RestartRequest { process: process.to_owned() });
        ask.set_timeout(within);
        let a = self.client().await?.gcm.restart(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        Ok((a.revision, a.epoch))
    }

    pub(crate) async fn connect(&self, args: &ConnectArgs) -> Result<Outcome, Failure> {
        let queue = match (args.fifo, args.latest) {
            (Some(fifo), _) => Some(v1::Queue { fifo, drop_oldest: args.drop_oldest }),
            (None, true) => Some(v1::Queue { fifo: 0, drop_oldest: false }),
            (None, false) => None,
        };
        let options = v1::ConnectOptions {
            queue,
            max_age: args.max_age.map(convert::duration),
            deadline: args.deadline.map(convert::duration),
            mailbox: args.mailbox,
            adapt: args.adapt,
            delay: args.delay,
            replace: args.replace,
            carrier: args.carrier.clone().unwrap_or_default(),
        };
        let ask = v1::ConnectRequest {
            client: args.client.clone(),
            server: args.server.clone(),
            options: Some(options),
            validate_only: args.mutation.dry_run,
            expected_revision: args.mutation.expected_revision,
            ..v1::ConnectRequest::default()
        };
        let ask = timed(ask, &args.mutation);
        let a = self.client().await?.gcm.connect(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        let connection = a.id;
        Ok(Outcome { connection, ..outcome(a.revision, a.plan, a.components, a.skipped, a.warnings) })
    }

    pub(crate) async fn disconnect(&self, cut: &Cut, m: &MutationArgs) -> Result<Outcome, Failure> {
        let (id, client, server) = match cut {
            Cut::Id(id) => (*id, String::new(), String::new()),
            Cut::Pair { client, server } => (0, client.clone(), server.clone()),
        };
        let ask = v1::DisconnectRequest {
            id,
            client,
            server,
            validate_only: m.dry_run,
            expected_revision: m.expected_revision,
            ..v1::DisconnectRequest::default()
        };
        let a = self
            .client()
            .await?
            .gcm
            .disconnect(timed(ask, m))
            .await
            .map_err(|s| self.failed(&s))?
            .into_inner();
        Ok(outcome(a.revision, a.plan, a.components, a.skipped, a.warnings))
    }
}

/// A request with the caller's own deadline, if one was given.
pub(super) fn timed<T>(ask: T, m: &MutationArgs) -> tonic::Request<T> {
    let mut ask = tonic::Request::new(ask);
    if let Some(ns) = m.timeout {
        ask.set_timeout(std::time::Duration::from_nanos(ns));
    }
    ask
}

/// Adds what a Stop, which goes on over failures, could not stop. Programs that do not look there are told by
/// a warning, too.
fn with_failures(mut outcome: Outcome, failed: Vec<v1::SkippedComponent>) -> Outcome {
    outcome.failed = failed.into_iter().map(|f| Left { path: f.path, why: f.why }).collect();
    outcome.warnings.retain(|w| outcome.failed.iter().all(|f| *w != format!("{}: {}", f.path, f.why)));
    outcome
}

pub(super) fn outcome(
    revision: u64,
    plan: Vec<String>,
    components: Vec<v1::ComponentReport>,
    skipped: Vec<v1::SkippedComponent>,
    mut warnings: Vec<String>,
) -> Outcome {
    // A plan may touch a component several times; how it stands in the end counts.
    let last = |i: &usize| components[i + 1..].iter().all(|later| later.path != components[*i].path);
    let lasting: Vec<usize> = (0..components.len()).filter(last).collect();
    let standing = |c: &v1::ComponentReport| Standing {
        path: c.path.clone(),
        state: convert::state(c.state(), c.stop_reason()),
        health: convert::health(c.health()),
        fault: c.fault.clone(),
    };
    // These warnings are told with the component's path instead.
    warnings.retain(|w| components.iter().all(|c| !c.warnings.contains(w)));
    warnings.extend(components.iter().flat_map(|c| c.warnings.iter().map(|w| format!("{}: {w}", c.path))));
    Outcome {
        revision,
        plan,
        components: lasting.iter().map(|i| standing(&components[*i])).collect(),
        skipped: skipped.into_iter().map(|s| Left { path: s.path, why: s.why }).collect(),
        failed: Vec::new(),
        warnings,
        connection: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(path: &str, state: v1::ComponentState) -> v1::ComponentReport {
        v1::ComponentReport { path: path.to_owned(), state: state.into(), ..v1::ComponentReport::default() }
    }

    #[test]
    fn a_component_touched_twice_is_shown_once_as_it_ended() {
        let reports =
            vec![report("h/a", v1::ComponentState::Created), report("h/a", v1::ComponentState::Ready)];
        let shown = outcome(1, Vec::new(), reports, Vec::new(), Vec::new());
        let states: Vec<&str> = shown.components.iter().map(|c| c.state.as_str()).collect();
        assert_eq!(states, ["READY"]);
    }

    #[test]
    fn a_stop_that_left_one_running_is_partial() {
        let reports = vec![report("h/a", v1::ComponentState::Stopped)];
        let plan = vec!["- stop h/a (ACTIVE → STOPPED{requested})".to_owned()];
        let done = outcome(1, plan, reports, Vec::new(), vec!["h/b: it hangs".to_owned()]);
        let failed = v1::SkippedComponent { path: "h/b".into(), why: "it hangs".into() };
        let done = with_failures(done, vec![failed]);
        assert_eq!(done.failed, [Left { path: "h/b".into(), why: "it hangs".into() }]);
        assert!(done.warnings.is_empty(), "{:?}", done.warnings);
    }
}
