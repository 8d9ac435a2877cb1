//! Processes that an agent is to keep, and their statuses, as they travel.

use std::collections::BTreeMap;
use std::time::Duration;

use trocar_loader::Hash;
use trocar_model::{Name, Refusal};
use trocar_proto::v1::{self, kept_exit::How};

use crate::agent::{Listed, PluginFile, Wanted};
use crate::host::{MemoryBounds, PortRules, Viewer};
use crate::processes::{Exit, Limits, Phase, Policy, Status};
use crate::system_file::ProcessSpec;

pub(super) fn wanted_out(wanted: &Wanted) -> v1::AgentProcess {
    let Wanted { spec, plugins, hashes, gcm, rules } = wanted;
    let file = |plugin: &PluginFile| v1::PluginFile {
        name: plugin.name.clone(),
        sha256: plugin.hash.to_string(),
        directory: plugin.directory,
    };
    v1::AgentProcess {
        name: spec.name.to_string(),
        plugins: plugins.iter().map(file).collect(),
        hashes: hashes.clone(),
        listen: spec.listen.clone().unwrap_or_default(),
        state: spec.state.as_ref().map(|dir| dir.to_string_lossy().into_owned()).unwrap_or_default(),
        env: spec.env.iter().cloned().collect(),
        restart: Some(policy_out(spec.restart)),
        memory_warn_mib: spec.memory.warn_mib.unwrap_or_default(),
        memory_limit_mib: spec.memory.limit_mib.unwrap_or_default(),
        allow_exec: spec.allow_exec,
        gcm: gcm.clone(),
        viewer_read_only: rules.viewer == Viewer::ReadOnly,
        open_loopback: rules.open_loopback,
    }
}

/// # Errors
/// A name, a hash, a time or a bound is none.
pub(super) fn wanted_in(wanted: v1::AgentProcess) -> Result<Wanted, Refusal> {
    let name = Name::parse(&wanted.name)?;
    let invalid = |field: &str, why: String| Refusal::ArgumentInvalid {
        what: format!("process {name}"),
        why,
        field: field.into(),
    };
    let some = |text: String| (!text.is_empty()).then_some(text);
    let mib = |n: u32| (n > 0).then_some(n);
    let file = |plugin: v1::PluginFile| {
        let hash = hash_in(&plugin.sha256)?;
        Ok(PluginFile { name: plugin.name, hash, directory: plugin.directory })
    };
    let plugins = wanted.plugins.into_iter().map(file).collect::<Result<Vec<_>, Refusal>>()?;
    let memory = MemoryBounds::new(mib(wanted.memory_warn_mib), mib(wanted.memory_limit_mib))
        .map_err(|why| invalid("memory_warn_mib", why))?;
    let wrong = |(key, value): (&String, &String)| {
        key.is_empty() || key.contains(['=', '\0']) || value.contains('\0')
    };
    if let Some((key, _)) = wanted.env.iter().find(|variable| wrong(*variable)) {
        return Err(invalid("env", format!("{key:?} is no variable of an environment")));
    }
    let state = std::path::Path::new(&wanted.state);
    if !state.components().all(|part| matches!(part, std::path::Component::Normal(_))) {
        let why = format!("{:?} leads out of the folder of the system", wanted.state);
        return Err(invalid("state", why));
    }
    let restart = policy_in(wanted.restart.unwrap_or_default()).map_err(|why| invalid("restart", why))?;
    let spec = ProcessSpec {
        listen: some(wanted.listen),
        state: some(wanted.state).map(Into::into),
        env: wanted.env.into_iter().collect::<BTreeMap<_, _>>().into_iter().collect(),
        restart,
        memory,
        allow_exec: wanted.allow_exec,
        ..ProcessSpec::new(name.clone())
    };
    let viewer = if wanted.viewer_read_only { Viewer::ReadOnly } else { Viewer::Full };
    let rules = PortRules { viewer, open_loopback: wanted.open_loopback };
    Ok(Wanted { spec, plugins, hashes: wanted.hashes, gcm: wanted.gcm, rules })
}

/// # Errors
/// It is no hash.
pub(super) fn hash_in(text: &str) -> Result<Hash, Refusal> {
    Hash::parse(text).ok_or_else(|| Refusal::ArgumentInvalid {
        what: "the plugin file".into(),
        why: format!("{text:?} is no sha256 of 64 hexadecimal digits"),
        field: "sha256".into(),
    })
}

fn policy_out(policy: Policy) -> v1::RestartPolicy {
    let Policy::OnFailure(limits) = policy else {
        return v1::RestartPolicy { never: true, ..Default::default() };
    };
    // Whether a process is of use is judged where its system is known.
    let Limits { max, within, backoff, most_backoff, start_within, unheard: _ } = limits;
    let time = |time: Duration| prost_types::Duration::try_from(time).ok();
    v1::RestartPolicy {
        never: false,
        max,
        within: time(within),
        backoff: time(backoff),
        most_backoff: time(most_backoff),
        start_within: time(start_within),
    }
}

fn policy_in(policy: v1::RestartPolicy) -> Result<Policy, String> {
    if policy.never {
        return Ok(Policy::Never);
    }
    let time = |name: &str, time: Option<prost_types::Duration>, usual: Duration| match time {
        None => Ok(usual),
        Some(time) => Duration::try_from(time).map_err(|_| format!("{name} is below 0")),
    };
    let usual = Limits::DEFAULT;
    Ok(Policy::OnFailure(Limits {
        max: policy.max,
        within: time("within", policy.within, usual.within)?,
        backoff: time("backoff", policy.backoff, usual.backoff)?,
        most_backoff: time("most_backoff", policy.most_backoff, usual.most_backoff)?,
        start_within: time("start_within", policy.start_within, usual.start_within)?,
        unheard: usual.unheard,
    }))
}

pub(super) fn statuses_out(statuses: &BTreeMap<String, Status>) -> Vec<v1::KeptStatus> {
    statuses.iter().map(|(name, status)| status_out(name, status)).collect()
}

fn status_out(name: &str, status: &Status) -> v1::KeptStatus {
    let Status { phase, pid, address, restarts, last_exit, refused } = status;
    let phase = match phase {
        Phase::Starting => v1::KeptPhase::Starting,
        Phase::Running => v1::KeptPhase::Running,
        Phase::Restarting => v1::KeptPhase::Restarting,
        Phase::Failed => v1::KeptPhase::Failed,
        Phase::Ended => v1::KeptPhase::Ended,
    };
    v1::KeptStatus {
        process: name.to_owned(),
        phase: phase.into(),
        pid: *pid,
        address: address.clone().unwrap_or_default(),
        restarts: *restarts,
        last_exit: last_exit.as_ref().map(|exit| v1::KeptExit { how: Some(exit_out(exit)) }),
        refused: refused.as_ref().map(ToString::to_string).unwrap_or_default(),
    }
}

/// What cannot be read stands for a process that is being started.
pub(super) fn statuses_in(statuses: Vec<v1::KeptStatus>) -> BTreeMap<String, Status> {
    statuses.into_iter().map(|status| (status.process.clone(), status_in(status))).collect()
}

fn status_in(status: v1::KeptStatus) -> Status {
    let phase = match status.phase() {
        v1::KeptPhase::Unspecified | v1::KeptPhase::Starting => Phase::Starting,
        v1::KeptPhase::Running => Phase::Running,
        v1::KeptPhase::Restarting => Phase::Restarting,
        v1::KeptPhase::Failed => Phase::Failed,
        v1::KeptPhase::Ended => Phase::Ended,
    };
    Status {
        phase,
        pid: status.pid,
        address: (!status.address.is_empty()).then_some(status.address),
        restarts: status.restarts,
        last_exit: status.last_exit.and_then(|exit| exit.how).map(exit_in),
        refused: serde_json::from_str(&status.refused).ok(),
    }
}

fn exit_out(exit: &Exit) -> How {
    match exit.clone() {
        Exit::Code(code) => How::Code(code),
        Exit::Because { code, why } => How::Broken(v1::BrokenExit { code, why }),
        Exit::Signal { number, core } => How::Signal(v1::SignalExit { number, core }),
        Exit::NotStarted(why) => How::NotStarted(why),
        Exit::Killed(why) => How::Killed(why),
        Exit::Stuck(why) | Exit::Away(why) => How::Stuck(why),
    }
}

fn exit_in(how: How) -> Exit {
    match how {
        How::Code(code) => Exit::Code(code),
        How::Broken(v1::BrokenExit { code, why }) => Exit::Because { code, why },
        How::Signal(v1::SignalExit { number, core }) => Exit::Signal { number, core },
        How::NotStarted(why) => Exit::NotStarted(why),
        How::Killed(why) => Exit::Killed(why),
        How::Stuck(why) => Exit::Stuck(why),
    }
}

pub(super) fn listed_out(listed: Listed) -> v1::KeptSystem {
    let Listed { system, caller, is_heard, statuses } = listed;
    let (system, statuses) = (system.to_string(), statuses_out(&statuses));
    v1::KeptSystem { system, caller, heard: is_heard, statuses }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use serde_json::json;

    use super::*;

    #[test]
    fn a_process_that_is_wanted_arrives_as_it_was_sent() {
        let limits = Limits { max: 7, within: Duration::from_millis(2500), ..Limits::DEFAULT };
        for restart in [Policy::Never, Policy::OnFailure(limits), Policy::default()] {
            let spec = ProcessSpec {
                listen: Some("127.0.0.1:7".into()),
                state: Some("s".into()),
                env: vec![("A".into(), "1".into()), ("B".into(), "x=y".into())],
                restart,
                memory: MemoryBounds::new(Some(100), Some(200)).unwrap(),
                allow_exec: true,
                ..ProcessSpec::new("cart".parse().unwrap())
            };
            let plugins = vec![PluginFile { name: "liba.so".into(), hash: Hash::of(b"a"), directory: 1 }];
            let rules = PortRules { viewer: Viewer::ReadOnly, open_loopback: true };
            let wanted =
                Wanted { spec, plugins, hashes: "[]".into(), gcm: "https://10.0.0.1:1".into(), rules };
            assert_eq!(wanted_in(wanted_out(&wanted)).unwrap(), wanted);
        }
    }

    #[test]
    fn what_makes_no_process_is_refused_with_its_place() {
        let good = v1::AgentProcess { name: "cart".into(), ..Default::default() };
        assert!(wanted_in(good.clone()).is_ok());
        let time = Some(prost_types::Duration { seconds: -1, nanos: 0 });
        let restart = Some(v1::RestartPolicy { backoff: time, ..Default::default() });
        let plugins = vec![v1::PluginFile { sha256: "1f".into(), ..Default::default() }];
        for (wrong, named) in [
            (v1::AgentProcess { name: "a/b".into(), ..good.clone() }, "a/b"),
            (v1::AgentProcess { plugins, ..good.clone() }, "64 hexadecimal"),
            (v1::AgentProcess { memory_warn_mib: 9, memory_limit_mib: 8, ..good.clone() }, "8 MiB"),
            (v1::AgentProcess { env: [("A=B".into(), "1".into())].into(), ..good.clone() }, "A=B"),
            (v1::AgentProcess { env: [("A".into(), "\0".into())].into(), ..good.clone() }, "variable"),
            (v1::AgentProcess { restart, ..good.clone() }, "backoff"),
            (v1::AgentProcess { state: "/tmp".into(), ..good.clone() }, "leads out"),
            (v1::AgentProcess { state: "a/../../files".into(), ..good.clone() }, "leads out"),
        ] {
            let refusal = wanted_in(wrong).unwrap_err().to_string();
            assert!(refusal.contains(named), "{named}: {refusal}");
        }
    }

    #[test]
    fn a_status_arrives_as_it_was_sent() {
        let ends = [
            None,
            Some(Exit::Code(-1)),
            Some(Exit::Because { code: 3, why: "no disk".into() }),
            Some(Exit::Signal { number: 11, core: true }),
            Some(Exit::NotStarted("no file".into())),
            Some(Exit::Killed("did not end".into())),
            Some(Exit::Stuck("did not end".into())),
        ];
        let phases = [Phase::Starting, Phase::Running, Phase::Restarting, Phase::Failed, Phase::Ended];
        for (last_exit, phase) in ends.into_iter().zip(phases.into_iter().cycle()) {
            let refused = last_exit.as_ref().map(|_| json!({ "reason": "LISTEN" }));
            let address = last_exit.as_ref().map(|_| "127.0.0.1:7".to_owned());
            let status = Status { phase, pid: 7, address, restarts: 2, last_exit, refused };
            let all: BTreeMap<_, _> = [("a".to_owned(), status)].into();
            assert_eq!(statuses_in(statuses_out(&all)), all);
        }
    }
}
