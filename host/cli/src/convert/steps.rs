//! Requests of a system file → steps of an Apply.

use serde_json::Value;
use trocar_model::{ConnectOptions, Execution, Name, Queue, Refusal, Request, Target, Which};
use trocar_proto::v1;
use trocar_proto::v1::step::Step as S;

use super::{duration, to_struct};
use trocar::gcm::{Fate, Isolated, Orders, Supervisor, Told};

pub(crate) fn step(request: &Request) -> v1::Step {
    let step = match request {
        Request::Create { id, class, config, execution } => {
            S::Create(create(id.to_string(), class, config.as_ref(), execution))
        }
        Request::CreateIsolated { id, home, class, config, execution } => S::Create(v1::CreateRequest {
            isolation: "process".to_owned(),
            ..create(format!("{home}/{}", id.component), class, config.as_ref(), execution)
        }),
        Request::Remove { id, force } => S::Remove(v1::RemoveRequest {
            path: id.to_string(),
            force: *force,
            ..v1::RemoveRequest::default()
        }),
        Request::Forget { process } => {
            S::Forget(v1::ForgetRequest { process: process.to_string(), ..v1::ForgetRequest::default() })
        }
        Request::Configure { id, patch, execution } => S::Configure(v1::ConfigureRequest {
            path: id.to_string(),
            config: Some(to_struct(patch)),
            execution: execution.as_ref().map(self::execution),
            ..v1::ConfigureRequest::default()
        }),
        Request::Start { targets } => {
            S::Start(v1::StartRequest { paths: paths(targets), ..v1::StartRequest::default() })
        }
        Request::Stop { targets } => {
            S::Stop(v1::StopRequest { paths: paths(targets), ..v1::StopRequest::default() })
        }
        Request::Resume { targets } => {
            S::Resume(v1::ResumeRequest { paths: paths(targets), ..v1::ResumeRequest::default() })
        }
        Request::Reset { targets } => {
            S::Reset(v1::ResetRequest { paths: paths(targets), ..v1::ResetRequest::default() })
        }
        Request::Connect { client, server, options } => S::Connect(v1::ConnectRequest {
            client: client.to_string(),
            server: server.to_string(),
            options: Some(self::options(options)),
            ..v1::ConnectRequest::default()
        }),
        Request::Disconnect { which: Which::Id(id) } => {
            S::Disconnect(v1::DisconnectRequest { id: id.0, ..v1::DisconnectRequest::default() })
        }
        Request::Disconnect { which: Which::Pair { client, server } } => {
            S::Disconnect(v1::DisconnectRequest {
                client: client.to_string(),
                server: server.to_string(),
                ..v1::DisconnectRequest::default()
            })
        }
    };
    v1::Step { step: Some(step) }
}

fn create(path: String, class: &str, config: Option<&Value>, execution: &Execution) -> v1::CreateRequest {
    v1::CreateRequest {
        path,
        class: class.to_owned(),
        config: config.map(to_struct),
        execution: Some(self::execution(execution)),
        ..v1::CreateRequest::default()
    }
}

fn paths(targets: &[Target]) -> Vec<String> {
    let text = |target: &Target| match target {
        Target::One(id) => id.to_string(),
        Target::Glob(pattern) => pattern.to_string(),
    };
    targets.iter().map(text).collect()
}

fn execution(e: &Execution) -> v1::Execution {
    v1::Execution {
        model: e.model.map_or_else(String::new, |m| m.name().to_owned()),
        rate_hz: None,
        period: e.period_ns.map(duration),
        phase: e.phase_ns.map(duration),
        stream_of: e.stream_of.clone().unwrap_or_default(),
        inside: e.inside.clone().unwrap_or_default(),
        priority: e.priority.map(u32::from),
        cpus: e.cpus.iter().map(|cpu| u32::try_from(*cpu).unwrap_or(u32::MAX)).collect(),
        catch_up: e.catch_up,
        threads: e.threads,
        max_step: e.max_step_ns.map(duration),
        on_failure: e.on_failure.map_or_else(String::new, |f| f.name().to_owned()),
        history: e.history,
        wake: e.wake.map_or_else(String::new, |w| w.name().to_owned()),
    }
}

fn options(o: &ConnectOptions) -> v1::ConnectOptions {
    let number = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    v1::ConnectOptions {
        queue: o.queue.map(|queue| match queue {
            Queue::Latest => v1::Queue { fifo: 0, drop_oldest: false },
            Queue::Fifo { depth, drop_oldest } => v1::Queue { fifo: number(depth), drop_oldest },
        }),
        max_age: o.max_age_ns.map(duration),
        deadline: o.deadline_ns.map(duration),
        mailbox: o.mailbox.map(number),
        adapt: o.adapt,
        delay: o.delay,
        replace: o.replace,
        carrier: o.carrier.clone(),
    }
}

/// Converts the status of a process for the GCM.
pub(crate) fn fate(told: &Told) -> v1::ProcessFate {
    let fate = match told.fate {
        Fate::Running => v1::Fate::Running,
        Fate::Restarting => v1::Fate::Restarting,
        Fate::Failed => v1::Fate::Failed,
        Fate::Ended => v1::Fate::Ended,
        Fate::Dismissed => v1::Fate::Dismissed,
    };
    v1::ProcessFate {
        process: told.process.to_string(),
        fate: fate as i32,
        pid: told.pid,
        last_exit: told.last_exit.clone(),
        restarts: told.restarts,
    }
}

/// Converts what a supervisor reports about itself.
pub(crate) fn supervisor(who: &Supervisor) -> v1::SuperviseRequest {
    let isolated =
        |a: &Isolated| v1::ApartProcess { process: a.process.to_string(), home: a.home.to_string() };
    v1::SuperviseRequest {
        processes: who.processes.iter().map(ToString::to_string).collect(),
        apart: who.isolated.iter().map(isolated).collect(),
        term: who.term,
    }
}

/// Reads what a GCM wants of its supervisor, with the term of that GCM.
pub(crate) fn wanted(told: &v1::SuperviseResponse) -> Result<(u64, Orders), Refusal> {
    let one = |a: &v1::ApartProcess| {
        Ok::<_, Refusal>(Isolated { process: Name::parse(&a.process)?, home: Name::parse(&a.home)? })
    };
    let isolated = told.apart.iter().map(one).collect::<Result<_, _>>()?;
    let restart = told.restart.iter().map(|name| Name::parse(name)).collect::<Result<_, _>>()?;
    Ok((told.term, Orders { isolated, restart }))
}
