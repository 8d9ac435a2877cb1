//! Requests: wire → model.

use prost_types::Duration;
use trocar_model::{
    ComponentId, ConnectOptions, ConnectionId, Execution, ExecutionModel, Name, OnFailure, PortId, Queue,
    Refusal, Request, Target, Wake, Which, brief, nearest, period_fault,
};
use trocar_proto::v1;

use super::json::{duration_ns, from_struct};

/// Fields of every mutating request.
pub(crate) struct Common {
    pub(crate) validate_only: bool,
    pub(crate) request_id: String,
    pub(crate) expected_revision: Option<u64>,
}

fn invalid(what: &str, why: impl Into<String>, field: &str) -> Refusal {
    Refusal::ArgumentInvalid { what: what.into(), why: why.into(), field: field.into() }
}

pub(crate) fn create(r: v1::CreateRequest) -> Result<Request, Refusal> {
    let both = !r.process.is_empty() || !r.name.is_empty();
    if both && !r.path.is_empty() && r.path != format!("{}/{}", r.process, r.name) {
        let why = format!(
            "path \"{}\" says something else than process \"{}\" and name \"{}\": give path, or process and name",
            brief(&r.path),
            brief(&r.process),
            brief(&r.name)
        );
        return Err(invalid("Create", why, "path"));
    }
    let id = if r.path.is_empty() {
        if r.process.is_empty() || r.name.is_empty() {
            let why = "name the component: process and name, or path \"process/name\"";
            return Err(invalid("Create", why, if r.process.is_empty() { "process" } else { "name" }));
        }
        ComponentId::new(Name::parse(&r.process)?, Name::parse(&r.name)?)
    } else {
        ComponentId::parse(&r.path)?
    };
    if r.class.is_empty() {
        return Err(invalid("Create", "class is missing: name one of the process's classes", "class"));
    }
    let execution = r.execution.map(execution).transpose()?.unwrap_or_default();
    let (class, config) = (r.class, r.config.map(from_struct));
    match r.isolation.as_str() {
        "" => Ok(Request::Create { id, class, config, execution }),
        "process" => {
            Ok(Request::CreateIsolated { id: id.isolated()?, home: id.process, class, config, execution })
        }
        other => {
            let why = format!(
                "isolation \"{}\" is unknown: leave it out, or give \"process\" for a process of its own",
                brief(other)
            );
            Err(invalid(&format!("Create {id}"), why, "isolation"))
        }
    }
}

pub(crate) fn remove(r: v1::RemoveRequest) -> Result<Request, Refusal> {
    Ok(Request::Remove { id: ComponentId::parse(&r.path)?, force: r.force })
}

pub(crate) fn configure(r: v1::ConfigureRequest) -> Result<Request, Refusal> {
    if r.config.is_none() && r.execution.is_none() {
        let why = "nothing is to change: give config, execution or both";
        return Err(invalid(&format!("Configure {}", brief(&r.path)), why, "config"));
    }
    let patch = r.config.map(from_struct).unwrap_or_else(|| serde_json::json!({}));
    let execution = r.execution.map(execution).transpose()?;
    Ok(Request::Configure { id: ComponentId::parse(&r.path)?, patch, execution })
}

/// The components Start, Resume and Reset name.
pub(crate) fn targets(verb: &str, paths: Vec<String>, path: String) -> Result<Vec<Target>, Refusal> {
    texts(verb, paths, path)?.iter().map(|p| Target::parse(p)).collect()
}

/// Components of a Stop, and the texts that name none, which keep no other from being stopped.
pub(crate) struct ToStop {
    pub(crate) targets: Vec<Target>,
    pub(crate) unread: Vec<(String, Refusal)>,
}

/// # Errors
/// No text names anything.
pub(crate) fn to_stop(paths: Vec<String>, path: String) -> Result<ToStop, Refusal> {
    let mut stop = ToStop { targets: Vec::new(), unread: Vec::new() };
    for text in texts("Stop", paths, path)? {
        match Target::parse(&text) {
            Ok(target) => stop.targets.push(target),
            Err(refusal) => stop.unread.push((text, refusal)),
        }
    }
    match stop.unread.first() {
        Some((_, refusal)) if stop.targets.is_empty() => Err(refusal.clone()),
        _ => Ok(stop),
    }
}

fn texts(verb: &str, paths: Vec<String>, path: String) -> Result<Vec<String>, Refusal> {
    let all: Vec<String> = paths.into_iter().chain((!path.is_empty()).then_some(path)).collect();
    if all.is_empty() {
        return Err(invalid(
            verb,
            "no path is named: give paths such as [\"host/robot\"] or [\"host/**\"]",
            "paths",
        ));
    }
    Ok(all)
}

pub(crate) fn connect(r: v1::ConnectRequest) -> Result<Request, Refusal> {
    Ok(Request::Connect {
        client: PortId::parse(&r.client)?,
        server: PortId::parse(&r.server)?,
        options: r.options.map(options).transpose()?.unwrap_or_default(),
    })
}

pub(crate) fn disconnect(r: v1::DisconnectRequest) -> Result<Request, Refusal> {
    let which = if r.id != 0 {
        Which::Id(ConnectionId(r.id))
    } else if r.client.is_empty() && r.server.is_empty() {
        return Err(invalid("Disconnect", "name the connection: id, or client and server", "id"));
    } else {
        Which::Pair { client: PortId::parse(&r.client)?, server: PortId::parse(&r.server)? }
    };
    Ok(Request::Disconnect { which })
}

pub(crate) fn forget(r: v1::ForgetRequest) -> Result<Request, Refusal> {
    Ok(Request::Forget { process: Name::parse(&r.process)? })
}

/// The steps of an Apply; an empty list is a mistake of its author.
pub(crate) fn steps(steps: Vec<v1::Step>) -> Result<Vec<Request>, Refusal> {
    if steps.is_empty() {
        let why = "it has no step: give at least one of create, connect, start, …";
        return Err(invalid("Apply", why, "steps"));
    }
    steps.into_iter().map(step).collect()
}

fn step(step: v1::Step) -> Result<Request, Refusal> {
    use v1::step::Step as S;
    match step.step {
        Some(S::Create(r)) => create(r),
        Some(S::Remove(r)) => remove(r),
        Some(S::Configure(r)) => configure(r),
        Some(S::Start(r)) => Ok(Request::Start { targets: targets("Start", r.paths, r.path)? }),
        Some(S::Stop(r)) => Ok(Request::Stop { targets: targets("Stop", r.paths, r.path)? }),
        Some(S::Resume(r)) => Ok(Request::Resume { targets: targets("Resume", r.paths, r.path)? }),
        Some(S::Reset(r)) => Ok(Request::Reset { targets: targets("Reset", r.paths, r.path)? }),
        Some(S::Connect(r)) => connect(r),
        Some(S::Disconnect(r)) => disconnect(r),
        Some(S::Forget(r)) => forget(r),
        None => Err(invalid("Apply", "a step is empty: give it one of create, connect, start, …", "steps")),
    }
}

pub(super) fn ns(duration: &Duration, field: &str) -> Result<u64, Refusal> {
    duration_ns(duration).ok_or_else(|| {
        let shown = duration.seconds as f64 + f64::from(duration.nanos) / 1e9;
        invalid(
            field,
            format!("{shown} s is not a duration here: give 0 s or more, and less than 584 years"),
            field,
        )
    })
}

pub(crate) fn execution(e: v1::Execution) -> Result<Execution, Refusal> {
    let model = named(&e.model, "execution.model", ExecutionModel::ALL, ExecutionModel::name)?;
    let on_failure = named(&e.on_failure, "execution.on_failure", OnFailure::ALL, OnFailure::name)?;
    let wake = named(&e.wake, "execution.wake", Wake::ALL, Wake::name)?;
    let from_rate = e.rate_hz.map(period_of).transpose()?;
    let period = e.period.as_ref().map(|d| ns(d, "execution.period")).transpose()?;
    // The planner knows periods only, and would name the rate.
    if let Some(why) = period.and_then(period_fault) {
        return Err(invalid("execution.period", why, "execution.period"));
    }
    let priority = |p: u32| {
        let why = || format!("{p} is outside 1 to 99");
        u8::try_from(p).map_err(|_| invalid("execution.priority", why(), "execution.priority"))
    };
    Ok(Execution {
        model,
        period_ns: period.or(from_rate),
        phase_ns: e.phase.as_ref().map(|d| ns(d, "execution.phase")).transpose()?,
        stream_of: (!e.stream_of.is_empty()).then_some(e.stream_of),
        inside: (!e.inside.is_empty()).then_some(e.inside),
        priority: e.priority.map(priority).transpose()?,
        cpus: e.cpus.into_iter().map(|c| c as usize).collect(),
        catch_up: e.catch_up,
        threads: e.threads,
        max_step_ns: e.max_step.as_ref().map(|d| ns(d, "execution.max_step")).transpose()?,
        history: e.history,
        on_failure,
        wake,
    })
}

/// The period of a rate, ns; a refusal names the rate as it was given.
fn period_of(rate_hz: f64) -> Result<u64, Refusal> {
    let wrong = |why: &str| {
        let readable = rate_hz == 0.0 || !rate_hz.is_finite() || (1e-6..1e15).contains(&rate_hz.abs());
        let rate = if readable { rate_hz.to_string() } else { format!("{rate_hz:e}") };
        let why = format!("{rate} Hz {why}");
        invalid("execution.rate_hz", why, "execution.rate_hz")
    };
    if !(rate_hz.is_finite() && rate_hz > 0.0) {
        return Err(wrong("is not a rate: give a positive number"));
    }
    let period_ns = (1e9 / rate_hz).round() as u64;
    match period_fault(period_ns) {
        Some(_) => Err(wrong("is outside one step an hour to 1000000 Hz")),
        None => Ok(period_ns),
    }
}

/// One of several names; "" = not given.
fn named<T: Copy, const N: usize>(
    text: &str,
    field: &str,
    all: [T; N],
    name: fn(T) -> &'static str,
) -> Result<Option<T>, Refusal> {
    if text.is_empty() {
        return Ok(None);
    }
    let known = || all.iter().map(|t| name(*t));
    all.iter().find(|t| name(**t) == text).map(|t| Some(*t)).ok_or_else(|| {
        let hint = nearest(text, known()).map(|n| format!("; did you mean \"{n}\"?")).unwrap_or_default();
        let why = format!("\"{text}\" is not one of {}{hint}", known().collect::<Vec<_>>().join(", "));
        invalid(field, why, field)
    })
}

/// Longest queue of a connection, samples or commands.
const MAX_DEPTH: u32 = 65_536;

pub(crate) fn options(o: v1::ConnectOptions) -> Result<ConnectOptions, Refusal> {
    let depth = |n: u32, field: &str| {
        if (1..=MAX_DEPTH).contains(&n) {
            Ok(n as usize)
        } else {
            Err(invalid(field, format!("room for {n} is outside 1 to {MAX_DEPTH}"), field))
        }
    };
    let queue = match &o.queue {
        None => None,
        Some(v1::Queue { fifo: 0, .. }) => Some(Queue::Latest),
        Some(q) => {
            Some(Queue::Fifo { depth: depth(q.fifo, "options.queue.fifo")?, drop_oldest: q.drop_oldest })
        }
    };
    Ok(ConnectOptions {
        queue,
        max_age_ns: o.max_age.as_ref().map(|d| ns(d, "options.max_age")).transpose()?,
        deadline_ns: o.deadline.as_ref().map(|d| ns(d, "options.deadline")).transpose()?,
        mailbox: o.mailbox.map(|n| depth(n, "options.mailbox")).transpose()?,
        adapt: o.adapt,
        delay: o.delay,
        replace: o.replace,
        carrier: o.carrier,
    })
}
