//! Positioned JSON → `SystemFile`: one function per part of the file.
//!
//! Invariant: every key of the format is read here and listed in `schema.rs`; a test compares the two.

use std::path::PathBuf;
use std::time::Duration;

use trocar_model::{
    ComponentId, ConnectOptions, Execution, ExecutionModel, Name, OnFailure, PortId, Queue, Wake,
};

use super::cursor::{Cursor, Document, did_you_mean};
use super::isolation::isolate;
use super::problem::Problem;
use super::{ComponentSpec, ConnectionSpec, ProcessSpec, SystemFile, TrustSpec};
use crate::host::MemoryBounds;
use crate::processes::{Limits, Policy, Unheard};

pub(super) const SYSTEM: &[&str] =
    &["$schema", "version", "processes", "components", "connections", "scenarios"];
pub(super) const PROCESS: &[&str] =
    &["plugins", "trust", "listen", "state", "env", "restart", "memory", "allow_exec"];
pub(super) const RESTART: &[&str] =
    &["max", "within_s", "backoff_ms", "most_backoff_ms", "start_within_s", "unheard_s"];
pub(super) const MEMORY: &[&str] = &["warn_mib", "limit_mib"];
pub(super) const COMPONENT: &[&str] = &["class", "config", "execution", "start", "isolation", "resume"];
pub(super) const EXECUTION: &[&str] = &[
    "model",
    "rate_hz",
    "period_us",
    "phase_us",
    "stream_of",
    "inside",
    "priority",
    "cpus",
    "catch_up",
    "threads",
    "max_step_ms",
    "history",
    "on_failure",
    "wake",
];
pub(super) const CONNECTION: &[&str] =
    &["client", "server", "queue", "max_age_ms", "deadline_ms", "mailbox", "adapt", "delay", "carrier"];
pub(super) const QUEUE: &[&str] = &["fifo", "drop_oldest"];

pub(super) const MODELS: &[(&str, ExecutionModel)] = &[
    ("periodic", ExecutionModel::Periodic),
    ("continuous", ExecutionModel::Continuous),
    ("on_signal", ExecutionModel::OnSignal),
    ("on_callback", ExecutionModel::OnCallback),
    ("exec_in", ExecutionModel::ExecIn),
    ("exec_out", ExecutionModel::ExecOut),
    ("stream", ExecutionModel::Stream),
    ("none", ExecutionModel::None),
];

pub(super) const ON_FAILURE: &[(&str, OnFailure)] =
    &[("stop_branch", OnFailure::StopBranch), ("bypass", OnFailure::Bypass)];

pub(super) const WAKES: &[(&str, Wake)] = &[("signal", Wake::Signal), ("poll", Wake::Poll)];

pub(super) const UNHEARD: &[(&str, Unheard)] = &[("never", Unheard::Never)];
pub(super) const POLICIES: &[(&str, Policy)] =
    &[("never", Policy::Never), ("on_failure", Policy::OnFailure(Limits::DEFAULT))];
/// True: without being asked.
pub(super) const RESUMES: &[(&str, bool)] = &[("manual", false), ("auto", true)];
/// True: a process of its own.
pub(super) const ISOLATIONS: &[(&str, bool)] = &[("none", false), ("process", true)];

const PATH_HELP: &str = "write process/component, e.g. \"host/robot\"";
const PORT_HELP: &str = "write process/component/port, e.g. \"host/robot/arm\"";

pub(super) fn system(document: Document) -> Result<SystemFile, Problem> {
    let root = document.cursor();
    let fields = root.fields("a system file", SYSTEM)?;
    if let Some(schema) = fields.get("$schema") {
        schema.text()?;
    }
    let version = fields.need("version")?;
    if version.node.to_value() != serde_json::json!(1) {
        return Err(version.problem(
            format!("version is {}, this program reads version 1", version.node.describe()),
            "write \"version\": 1, or use a newer trocar",
        ));
    }
    let listed = fields.get("processes").map(processes).transpose()?;
    let written = fields.get("components").map(|c| components(c, listed.as_deref())).transpose()?;
    let mut components = written.unwrap_or_default();
    let mut connections =
        fields.get("connections").map(|c| connections(c, &components)).transpose()?.unwrap_or_default();
    if let Some(scenarios) = fields.get("scenarios")
        && let Some((key, _)) = scenarios.entries("scenarios")?.first()
    {
        return Err(scenarios.key_problem(
            key,
            "scenarios are not part of this version",
            "leave \"scenarios\": {} empty for now",
        ));
    }
    let mut processes = listed.unwrap_or_else(|| implied_processes(&components));
    isolate(&document, &mut processes, &mut components, &mut connections)?;
    drop((fields, root));
    Ok(SystemFile { processes, components, connections, document })
}

/// Without a `processes` part, the processes are those the components are in.
fn implied_processes(components: &[ComponentSpec]) -> Vec<ProcessSpec> {
    let mut processes: Vec<ProcessSpec> = Vec::new();
    for c in components {
        if processes.iter().all(|p| p.name != c.id.process) {
            processes.push(ProcessSpec::new(c.id.process.clone()));
        }
    }
    processes
}

fn processes(part: &Cursor<'_>) -> Result<Vec<ProcessSpec>, Problem> {
    let mut processes = Vec::new();
    for (key, value) in part.entries("processes")? {
        let name: Name = key.text.parse().map_err(|e| {
            part.key_problem(
                key,
                format!("{e}"),
                "a process name is letters, digits, '_', '-', '.', up to 63 characters",
            )
        })?;
        let fields = value.fields("a process", PROCESS)?;
        let mut plugins = Vec::new();
        if let Some(list) = fields.get("plugins") {
            for item in list.list()? {
                plugins.push(PathBuf::from(item.text()?));
            }
        }
        let mut env: Vec<(String, String)> = Vec::new();
        if let Some(part) = fields.get("env") {
            for (key, value) in part.entries("env")? {
                if key.text.is_empty() || key.text.contains(['=', '\0']) {
                    let help = "write NAME: \"value\", without '=' in the name";
                    return Err(part.key_problem(
                        key,
                        format!("{:?} is not the name of a variable", key.text),
                        help,
                    ));
                }
                let text = value.text()?;
                if text.contains('\0') {
                    return Err(value.problem("a value has no NUL character", "leave it out"));
                }
                env.push((key.text.clone(), text.to_owned()));
            }
        }
        processes.push(ProcessSpec {
            name,
            plugins,
            trust: fields.get("trust").map(trust).transpose()?.unwrap_or_default(),
            listen: fields.get("listen").map(listen).transpose()?,
            state: fields.get("state").map(Cursor::text).transpose()?.map(PathBuf::from),
            env,
            restart: fields.get("restart").map(restart).transpose()?.unwrap_or_default(),
            memory: fields.get("memory").map(memory).transpose()?.unwrap_or_default(),
            allow_exec: fields.get("allow_exec").map(Cursor::flag).transpose()?.unwrap_or_default(),
        });
    }
    Ok(processes)
}

fn listen(value: &Cursor<'_>) -> Result<String, Problem> {
    let text = value.text()?;
    let port = text
        .rsplit_once(':')
        .and_then(|(host, port)| (!host.is_empty()).then(|| port.parse::<u16>().ok())?);
    match port {
        Some(_) => Ok(text.to_owned()),
        None => Err(value.problem(
            format!("{text:?} is not an address to listen on"),
            "write \"127.0.0.1:PORT\"; port 0 takes a free one",
        )),
    }
}

fn memory(value: &Cursor<'_>) -> Result<MemoryBounds, Problem> {
    let fields = value.fields("the bounds of a process's memory", MEMORY)?;
    let mib = |key: &str| {
        let number = fields.get(key).map(|n| n.whole(1, u64::from(u32::MAX), "an amount of memory, MiB"));
        Ok(number.transpose()?.map(|n| n as u32))
    };
    MemoryBounds::new(mib("warn_mib")?, mib("limit_mib")?)
        .map_err(|why| value.problem(why, "write a warn_mib below limit_mib"))
}

/// `"never"`, `"on_failure"`, or how often and how soon.
fn restart(value: &Cursor<'_>) -> Result<Policy, Problem> {
    if let super::scan::Kind::Text(_) = value.node.kind {
        return value.one_of(POLICIES);
    }
    let fields = value.fields("a restart policy (or \"never\", \"on_failure\")", RESTART)?;
    let time = |key: &str, unit: &str, ns: f64, default: Duration| -> Result<Duration, Problem> {
        let given = fields.get(key).map(|v| v.positive(unit)).transpose()?;
        Ok(given.map_or(default, |n| Duration::from_nanos((n * ns).min(1e17) as u64)))
    };
    let usual = Limits::DEFAULT;
    let max = fields.get("max").map(|n| n.whole(0, 1000, "a number of restarts")).transpose()?;
    Ok(Policy::OnFailure(Limits {
        max: max.map_or(usual.max, |n| n as u32),
        within: time("within_s", "s", 1e9, usual.within)?,
        backoff: time("backoff_ms", "ms", 1e6, usual.backoff)?,
        most_backoff: time("most_backoff_ms", "ms", 1e6, usual.most_backoff)?,
        start_within: time("start_within_s", "s", 1e9, usual.start_within)?,
        unheard: fields.get("unheard_s").map(unheard).transpose()?.unwrap_or(usual.unheard),
    }))
}

/// `"never"`, or a time, s.
fn unheard(value: &Cursor<'_>) -> Result<Unheard, Problem> {
    if let super::scan::Kind::Text(_) = value.node.kind {
        return value.one_of(UNHEARD);
    }
    let seconds = value.positive("s, or \"never\"")?;
    Ok(Unheard::After(Duration::from_nanos((seconds * 1e9).min(1e17) as u64)))
}

/// `"dev"` or `"allowlist:FILE"`, as on the command line.
fn trust(value: &Cursor<'_>) -> Result<TrustSpec, Problem> {
    let text = value.text()?;
    match text.split_once(':') {
        None if text == "dev" => Ok(TrustSpec::Dev),
        Some(("allowlist", file)) if !file.is_empty() => Ok(TrustSpec::AllowList(file.into())),
        _ if text == "allowlist" || text == "allowlist:" => Err(value.problem(
            "trust \"allowlist\" needs the file of hashes",
            "write \"trust\": \"allowlist:hashes.json\"",
        )),
        _ if text.starts_with("signed") => Err(value.problem(
            "signed plugins are not part of this version",
            "use \"trust\": \"allowlist:hashes.json\"",
        )),
        _ => Err(value.problem(
            format!("{text:?} is not a way to trust plugins"),
            "accepted: \"dev\", \"allowlist:FILE\"",
        )),
    }
}

fn components(part: &Cursor<'_>, processes: Option<&[ProcessSpec]>) -> Result<Vec<ComponentSpec>, Problem> {
    let mut components = Vec::new();
    for (key, value) in part.entries("components")? {
        let id =
            ComponentId::parse(&key.text).map_err(|e| part.key_problem(key, e.to_string(), PATH_HELP))?;
        if let Some(known) = processes
            && known.iter().all(|p| p.name != id.process)
        {
            return Err(part.key_problem(
                key,
                format!("process \"{}\" is not in \"processes\"", id.process),
                did_you_mean(id.process.as_str(), known.iter().map(|p| p.name.as_str())),
            ));
        }
        let fields = value.fields("a component", COMPONENT)?;
        let config = fields.get("config").map(config).transpose()?;
        components.push(ComponentSpec {
            written: id.clone(),
            id,
            resumes: fields.get("resume").map(|r| r.one_of(RESUMES)).transpose()?.unwrap_or(false),
            isolated: fields.get("isolation").map(|i| i.one_of(ISOLATIONS)).transpose()?.unwrap_or(false),
            class: fields.need("class")?.text()?.to_owned(),
            config,
            execution: fields.get("execution").map(execution).transpose()?.unwrap_or_default(),
            start: fields.get("start").map(Cursor::flag).transpose()?.unwrap_or(true),
        });
    }
    Ok(components)
}

/// Any object; duplicates are refused at every level because a hidden setting is a wrong setting.
fn config(value: &Cursor<'_>) -> Result<serde_json::Value, Problem> {
    value.entries("config")?;
    no_duplicates(value)?;
    Ok(value.node.to_value())
}

pub(super) fn no_duplicates(value: &Cursor<'_>) -> Result<(), Problem> {
    match &value.node.kind {
        super::scan::Kind::Object(_) => {
            for (_, inner) in value.entries("an object")? {
                no_duplicates(&inner)?;
            }
        }
        super::scan::Kind::List(_) => {
            for inner in value.list()? {
                no_duplicates(&inner)?;
            }
        }
        _ => {}
    }
    Ok(())
}

fn execution(value: &Cursor<'_>) -> Result<Execution, Problem> {
    let fields = value.fields("execution", EXECUTION)?;
    fields.not_both("rate_hz", "period_us")?;
    fields.not_both("stream_of", "inside")?;
    let owner = |key: &str| -> Result<Option<String>, Problem> {
        fields.get(key).map(|v| Ok(v.parsed(ComponentId::parse, PATH_HELP)?.to_string())).transpose()
    };
    let period_ns = match (fields.get("rate_hz"), fields.get("period_us")) {
        (Some(rate), _) => Some((1e9 / rate.positive("Hz")?).round() as u64),
        (_, Some(period)) => Some((period.positive("µs")? * 1e3).round() as u64),
        _ => None,
    };
    let number = |key: &str, low: u64, high: u64, what: &str| -> Result<Option<u32>, Problem> {
        Ok(fields.get(key).map(|n| n.whole(low, high, what)).transpose()?.map(|n| n as u32))
    };
    let mut cpus = Vec::new();
    if let Some(list) = fields.get("cpus") {
        for cpu in list.list()? {
            cpus.push(cpu.whole(0, 4095, "a CPU number")? as usize);
        }
    }
    Ok(Execution {
        model: fields.get("model").map(|m| m.one_of(MODELS)).transpose()?,
        period_ns,
        phase_ns: fields
            .get("phase_us")
            .map(|p| p.not_negative("µs"))
            .transpose()?
            .map(|us| (us * 1e3).round() as u64),
        stream_of: owner("stream_of")?,
        inside: owner("inside")?,
        priority: fields
            .get("priority")
            .map(|p| p.whole(1, 99, "a SCHED_FIFO priority"))
            .transpose()?
            .map(|p| p as u8),
        cpus,
        catch_up: number("catch_up", 0, 1000, "a number of late periods")?,
        threads: number("threads", 1, 64, "a number of threads")?,
        max_step_ns: fields
            .get("max_step_ms")
            .map(|t| t.positive("ms"))
            .transpose()?
            .map(|ms| (ms * 1e6).round() as u64),
        history: number("history", 3, 65_536, "a number of rows")?,
        on_failure: fields.get("on_failure").map(|f| f.one_of(ON_FAILURE)).transpose()?,
        wake: fields.get("wake").map(|w| w.one_of(WAKES)).transpose()?,
    })
}

fn connections(part: &Cursor<'_>, components: &[ComponentSpec]) -> Result<Vec<ConnectionSpec>, Problem> {
    let mut connections: Vec<ConnectionSpec> = Vec::new();
    for value in part.list()? {
        let fields = value.fields("a connection", CONNECTION)?;
        let end = |key: &str| -> Result<PortId, Problem> {
            let at = fields.need(key)?;
            let port = at.parsed(PortId::parse, PORT_HELP)?;
            if components.iter().any(|c| c.id == port.component) {
                return Ok(port);
            }
            let known: Vec<String> = components.iter().map(|c| c.id.to_string()).collect();
            Err(at.problem(
                format!("component {} is not in this file", port.component),
                did_you_mean(&port.component.to_string(), known.iter().map(String::as_str)),
            ))
        };
        let (client, server) = (end("client")?, end("server")?);
        if connections.iter().any(|c| c.client == client && c.server == server) {
            return Err(value.problem(format!("{client} → {server} is listed twice"), "keep one of the two"));
        }
        let ms = |key: &str| -> Result<Option<u64>, Problem> {
            Ok(fields.get(key).map(|v| v.positive("ms")).transpose()?.map(|ms| (ms * 1e6).round() as u64))
        };
        let options = ConnectOptions {
            queue: fields.get("queue").map(queue).transpose()?,
            max_age_ns: ms("max_age_ms")?,
            deadline_ns: ms("deadline_ms")?,
            mailbox: fields
                .get("mailbox")
                .map(|m| m.whole(1, 65_536, "a mailbox depth"))
                .transpose()?
                .map(|m| m as usize),
            adapt: fields.get("adapt").map(Cursor::flag).transpose()?.unwrap_or(false),
            delay: fields.get("delay").map(Cursor::flag).transpose()?.unwrap_or(false),
            replace: false,
            carrier: fields.get("carrier").map(Cursor::text).transpose()?.unwrap_or_default().to_owned(),
        };
        connections.push(ConnectionSpec { client, server, options });
    }
    Ok(connections)
}

/// `"latest"` or `{"fifo": N, "drop_oldest": false}`.
fn queue(value: &Cursor<'_>) -> Result<Queue, Problem> {
    if let super::scan::Kind::Text(_) = value.node.kind {
        return value.one_of(&[("latest", Queue::Latest)]);
    }
    let fields = value.fields("a queue (or the text \"latest\")", QUEUE)?;
    Ok(Queue::Fifo {
        depth: fields.need("fifo")?.whole(1, 65_536, "a queue depth in samples")? as usize,
        drop_oldest: fields.get("drop_oldest").map(Cursor::flag).transpose()?.unwrap_or(false),
    })
}
