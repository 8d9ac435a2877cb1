//! Positioned JSON → `SystemFile`: one function per part of the file.
//!
//! Invariant: every key of the format is read here and listed in `schema.rs`; a test compares the two.
//! Everything wrong is noted, and the rest is read all the same; parts that may say something else than was
//! meant are doubted.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

use trocar_model::{
    ComponentId, ConnectOptions, Execution, ExecutionModel, Name, OnFailure, PortId, Queue, Refusal, Wake,
};

use super::cursor::{Cursor, Document, Found, did_you_mean};
use super::draft::{Doubts, Draft};
use super::isolation::isolate;
use super::problem::Problem;
use super::{ComponentSpec, ConnectionSpec, MachineSpec, ProcessSpec, SystemFile, TrustSpec};
use crate::host::MemoryBounds;
use crate::processes::{Limits, Policy, Unheard};

pub(super) const SYSTEM: &[&str] =
    &["$schema", "version", "machines", "processes", "components", "connections", "scenarios"];
pub(super) const MACHINE: &[&str] = &["agent"];
pub(super) const PROCESS: &[&str] =
    &["machine", "plugins", "trust", "listen", "state", "env", "restart", "memory", "allow_exec"];
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

impl Draft {
    /// Reads a file.
    ///
    /// # Errors
    /// It cannot be read at all: no file, not UTF-8, not JSON, another version.
    pub fn read(path: &Path) -> Result<Draft, Vec<Problem>> {
        let text = super::text_of(path).map_err(|problem| vec![problem])?;
        Draft::of(&path.display().to_string(), text)
    }

    /// Reads a text; `file` is its name in problems.
    pub(super) fn of(file: &str, text: String) -> Result<Draft, Vec<Problem>> {
        let document = Document::parse(file, text).map_err(|problem| vec![problem])?;
        let (found, mut doubts) = (Found::default(), Doubts::default());
        match parts(&document, &found, &mut doubts) {
            Some((machines, processes, components, connections)) => {
                let file =
                    SystemFile { machines, processes, components, connections, document, is_changed: false };
                Ok(Draft { file, problems: found.all(), doubts })
            }
            None => Err(found.all()),
        }
    }
}

type Parts = (Vec<MachineSpec>, Vec<ProcessSpec>, Vec<ComponentSpec>, Vec<ConnectionSpec>);

fn parts(document: &Document, found: &Found, doubts: &mut Doubts) -> Option<Parts> {
    let root = document.cursor();
    let fields = root.fields("a system file", SYSTEM, found);
    if let Some(schema) = fields.get("$schema") {
        found.take(schema.text());
    }
    let version = fields.need("version", found)?;
    if version.node.to_value() != serde_json::json!(1) {
        // Another version means something else by the rest.
        found.note(version.problem(
            format!("version is {}, this program reads version 1", version.node.describe()),
            "write \"version\": 1, or use a newer trocar",
        ));
        return None;
    }
    let machines = fields.get("machines").map_or_else(Vec::new, |part| machines(part, found));
    let listed = fields.get("processes").map(|part| processes(part, &machines, found, doubts));
    let mut components =
        fields.get("components").map_or_else(Vec::new, |c| components(c, listed.as_deref(), found, doubts));
    let mut connections =
        fields.get("connections").map_or_else(Vec::new, |c| connections(c, &components, found, doubts));
    if let Some(scenarios) = fields.get("scenarios")
        && let Some((key, _)) = scenarios.entries("scenarios", found).first()
    {
        found.note(scenarios.key_problem(
            key,
            "scenarios are not part of this version",
            "leave \"scenarios\": {} empty for now",
        ));
    }
    let mut processes = listed.unwrap_or_else(|| implied_processes(&components));
    isolate(document, &mut processes, &mut components, &mut connections, found);
    Some((machines, processes, components, connections))
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

fn machines(part: &Cursor<'_>, found: &Found) -> Vec<MachineSpec> {
    let mut machines = Vec::new();
    for (key, value) in part.entries("machines", found) {
        let name = key.text.parse::<Name>().map_err(|e: Refusal| {
            part.key_problem(
                key,
                e.to_string(),
                "a machine's name is letters, digits, '_', '-', '.', up to 63 characters",
            )
        });
        let fields = value.fields("a machine", MACHINE, found);
        let agent = fields.need("agent", found).and_then(|agent| found.take(address(agent)));
        // One whose agent cannot be read is there all the same: a process on it is no mistake.
        let agent = agent.unwrap_or_default();
        machines.extend(found.take(name).map(|name| MachineSpec { name, agent }));
    }
    machines
}

/// Address of an agent.
fn address(value: &Cursor<'_>) -> Result<String, Problem> {
    let text = value.text()?;
    let bare = text.strip_prefix("https://").unwrap_or(text);
    let port = bare.rsplit_once(':').and_then(|(host, port)| {
        (!host.is_empty() && !host.contains('/')).then(|| port.parse::<u16>().ok())?
    });
    match port {
        Some(1..) => Ok(text.to_owned()),
        _ => Err(value.problem(
            format!("{text:?} is not the address of an agent"),
            "write \"https://HOST:PORT\", as `trocar agent --listen-tls` prints it; or \"127.0.0.1:PORT\" of this machine",
        )),
    }
}

/// The machine of a process.
fn machine(value: &Cursor<'_>, machines: &[MachineSpec]) -> Result<Name, Problem> {
    let text = value.text()?;
    let there = machines.iter().find(|machine| machine.name.as_str() == text);
    there.map(|machine| machine.name.clone()).ok_or_else(|| {
        value.problem(
            format!("machine {text:?} is not in \"machines\""),
            did_you_mean(text, machines.iter().map(|machine| machine.name.as_str())),
        )
    })
}

fn processes(
    part: &Cursor<'_>,
    machines: &[MachineSpec],
    found: &Found,
    doubts: &mut Doubts,
) -> Vec<ProcessSpec> {
    let mut processes = Vec::new();
    for (key, value) in part.entries("processes", found) {
        let name = key.text.parse::<Name>().map_err(|e: Refusal| {
            part.key_problem(
                key,
                e.to_string(),
                "a process name is letters, digits, '_', '-', '.', up to 63 characters",
            )
        });
        let fields = value.fields("a process", PROCESS, found);
        let before = found.count();
        let plugins = fields.get("plugins").map_or_else(Vec::new, |list| texts(list, found));
        let trust = found.may(fields.get("trust").map(trust)).unwrap_or_default();
        let allow_exec = found.may(fields.get("allow_exec").map(Cursor::flag)).unwrap_or_default();
        // Without plugin directories of its own it has those of its machine.
        let knows_classes =
            found.count() == before && !(fields.get("machine").is_some() && plugins.is_empty());
        let spec = |name| ProcessSpec {
            name,
            machine: found.may(fields.get("machine").map(|part| machine(part, machines))),
            plugins: plugins.into_iter().map(PathBuf::from).collect(),
            trust,
            listen: found.may(fields.get("listen").map(listen)),
            state: found.may(fields.get("state").map(Cursor::text)).map(PathBuf::from),
            env: fields.get("env").map_or_else(Vec::new, |part| variables(part, found)),
            restart: fields.get("restart").map_or_else(Policy::default, |part| restart(part, found)),
            memory: found.may(fields.get("memory").map(|part| memory(part, found))).unwrap_or_default(),
            allow_exec,
        };
        let Some(name) = found.take(name) else { continue };
        if !knows_classes {
            doubts.processes.insert(name.clone());
        }
        processes.push(spec(name));
    }
    processes
}

fn texts<'a>(list: &Cursor<'a>, found: &Found) -> Vec<&'a str> {
    let items = found.take(list.list()).unwrap_or_default();
    items.iter().filter_map(|item| found.take(item.text())).collect()
}

fn variables(part: &Cursor<'_>, found: &Found) -> Vec<(String, String)> {
    let mut env = Vec::new();
    for (key, value) in part.entries("env", found) {
        if key.text.is_empty() || key.text.contains(['=', '\0']) {
            let help = "write NAME: \"value\", without '=' in the name";
            let what = format!("{:?} is not the name of a variable", key.text);
            found.note(part.key_problem(key, what, help));
        }
        match found.take(value.text()) {
            Some(text) if text.contains('\0') => {
                found.note(value.problem("a value has no NUL character", "leave it out"));
            }
            Some(text) => env.push((key.text.clone(), text.to_owned())),
            None => {}
        }
    }
    env
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

fn memory(value: &Cursor<'_>, found: &Found) -> Result<MemoryBounds, Problem> {
    let fields = value.fields("the bounds of a process's memory", MEMORY, found);
    let mib = |key: &str| {
        let number = fields.get(key).map(|n| n.whole(1, u64::from(u32::MAX), "an amount of memory, MiB"));
        found.may(number).map(|n| n as u32)
    };
    MemoryBounds::new(mib("warn_mib"), mib("limit_mib"))
        .map_err(|why| value.problem(why, "write a warn_mib below limit_mib"))
}

/// `"never"`, `"on_failure"`, or how often and how soon.
fn restart(value: &Cursor<'_>, found: &Found) -> Policy {
    if let super::scan::Kind::Text(_) = value.node.kind {
        return found.take(value.one_of(POLICIES)).unwrap_or_default();
    }
    let fields = value.fields("a restart policy (or \"never\", \"on_failure\")", RESTART, found);
    let time = |key: &str, unit: &str, ns: f64, default: Duration| -> Duration {
        let given = found.may(fields.get(key).map(|v| v.positive(unit)));
        given.map_or(default, |n| Duration::from_nanos((n * ns).min(1e17) as u64))
    };
    let usual = Limits::DEFAULT;
    let max = found.may(fields.get("max").map(|n| n.whole(0, 1000, "a number of restarts")));
    Policy::OnFailure(Limits {
        max: max.map_or(usual.max, |n| n as u32),
        within: time("within_s", "s", 1e9, usual.within),
        backoff: time("backoff_ms", "ms", 1e6, usual.backoff),
        most_backoff: time("most_backoff_ms", "ms", 1e6, usual.most_backoff),
        start_within: time("start_within_s", "s", 1e9, usual.start_within),
        unheard: found.may(fields.get("unheard_s").map(unheard)).unwrap_or(usual.unheard),
    })
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

/// Reads the components. One that cannot be made has its name all the same: a connection to it is no mistake.
fn components(
    part: &Cursor<'_>,
    processes: Option<&[ProcessSpec]>,
    found: &Found,
    doubts: &mut Doubts,
) -> Vec<ComponentSpec> {
    let mut components = Vec::new();
    for (key, value) in part.entries("components", found) {
        if found.is_full() {
            break;
        }
        let id = ComponentId::parse(&key.text).map_err(|e| part.key_problem(key, e.to_string(), PATH_HELP));
        let id = found.take(id);
        let mut is_doubted = false;
        if let (Some(known), Some(id)) = (processes, &id)
            && known.iter().all(|p| p.name != id.process)
        {
            is_doubted = true;
            found.note(part.key_problem(
                key,
                format!("process \"{}\" is not in \"processes\"", id.process),
                did_you_mean(id.process.as_str(), known.iter().map(|p| p.name.as_str())),
            ));
        }
        let fields = value.fields("a component", COMPONENT, found);
        let class = fields.need("class", found).and_then(|class| found.take(class.text()));
        let config = fields.get("config").map(|part| config(part, found));
        let before = found.count();
        let execution = fields.get("execution").map(|part| execution(part, found));
        let is_clear = found.count() == before;
        if let Some(id) = &id {
            doubts.components.extend((is_doubted || class.is_none()).then(|| id.clone()));
            doubts.executions.extend((!is_clear).then(|| id.clone()));
        }
        let spec = |id: ComponentId| ComponentSpec {
            written: id.clone(),
            id,
            resumes: found.may(fields.get("resume").map(|r| r.one_of(RESUMES))).unwrap_or(false),
            isolated: found.may(fields.get("isolation").map(|i| i.one_of(ISOLATIONS))).unwrap_or(false),
            class: class.unwrap_or_default().to_owned(),
            config,
            execution: execution.filter(|_| is_clear).unwrap_or_default(),
            start: found.may(fields.get("start").map(Cursor::flag)).unwrap_or(true),
        };
        components.extend(id.map(spec));
    }
    components
}

/// Any object; duplicates are noted at every level because a hidden setting is a wrong setting.
fn config(value: &Cursor<'_>, found: &Found) -> serde_json::Value {
    if !matches!(value.node.kind, super::scan::Kind::Object(_)) {
        value.entries("config", found);
    }
    no_duplicates(value, found);
    value.node.to_value()
}

pub(super) fn no_duplicates(value: &Cursor<'_>, found: &Found) {
    match &value.node.kind {
        super::scan::Kind::Object(_) => {
            value.entries("an object", found).iter().for_each(|(_, inner)| no_duplicates(inner, found));
        }
        super::scan::Kind::List(_) => {
            found.take(value.list()).iter().flatten().for_each(|inner| no_duplicates(inner, found));
        }
        _ => {}
    }
}

fn execution(value: &Cursor<'_>, found: &Found) -> Execution {
    let fields = value.fields("execution", EXECUTION, found);
    fields.not_both("rate_hz", "period_us", found);
    fields.not_both("stream_of", "inside", found);
    let owner = |key: &str| {
        found.may(fields.get(key).map(|v| v.parsed(ComponentId::parse, PATH_HELP))).map(|id| id.to_string())
    };
    let rate = found.may(fields.get("rate_hz").map(|rate| rate.positive("Hz")));
    let period = found.may(fields.get("period_us").map(|period| period.positive("µs")));
    let number = |key: &str, low: u64, high: u64, what: &str| {
        found.may(fields.get(key).map(|n| n.whole(low, high, what))).map(|n| n as u32)
    };
    let cpus = fields.get("cpus").and_then(|list| found.take(list.list())).unwrap_or_default();
    let cpus = cpus.iter().filter_map(|cpu| found.take(cpu.whole(0, 4095, "a CPU number")));
    Execution {
        model: found.may(fields.get("model").map(|m| m.one_of(MODELS))),
        period_ns: rate.map(|hz| 1e9 / hz).or(period.map(|us| us * 1e3)).map(|ns| ns.round() as u64),
        phase_ns: found
            .may(fields.get("phase_us").map(|p| p.not_negative("µs")))
            .map(|us| (us * 1e3).round() as u64),
        stream_of: owner("stream_of"),
        inside: owner("inside"),
        priority: number("priority", 1, 99, "a SCHED_FIFO priority").map(|p| p as u8),
        cpus: cpus.map(|cpu| cpu as usize).collect(),
        catch_up: number("catch_up", 0, 1000, "a number of late periods"),
        threads: number("threads", 1, 64, "a number of threads"),
        max_step_ns: found
            .may(fields.get("max_step_ms").map(|t| t.positive("ms")))
            .map(|ms| (ms * 1e6).round() as u64),
        history: number("history", 3, 65_536, "a number of rows"),
        on_failure: found.may(fields.get("on_failure").map(|f| f.one_of(ON_FAILURE))),
        wake: found.may(fields.get("wake").map(|w| w.one_of(WAKES))),
    }
}

fn connections(
    part: &Cursor<'_>,
    components: &[ComponentSpec],
    found: &Found,
    doubts: &mut Doubts,
) -> Vec<ConnectionSpec> {
    let known: BTreeSet<String> = components.iter().map(|c| c.id.to_string()).collect();
    let mut pairs = BTreeSet::new();
    let mut connections: Vec<ConnectionSpec> = Vec::new();
    for value in found.take(part.list()).unwrap_or_default() {
        if found.is_full() {
            break;
        }
        let before = found.count();
        let fields = value.fields("a connection", CONNECTION, found);
        let end = |key: &str| -> Option<PortId> {
            let at = fields.need(key, found)?;
            let port = found.take(at.parsed(PortId::parse, PORT_HELP))?;
            let component = port.component.to_string();
            if !known.contains(&component) {
                found.note(at.problem(
                    format!("component {component} is not in this file"),
                    did_you_mean(&component, known.iter().map(String::as_str)),
                ));
            }
            Some(port)
        };
        let (client, server) = (end("client"), end("server"));
        let ms = |key: &str| -> Option<u64> {
            found.may(fields.get(key).map(|v| v.positive("ms"))).map(|ms| (ms * 1e6).round() as u64)
        };
        let options = ConnectOptions {
            queue: fields.get("queue").and_then(|part| queue(part, found)),
            max_age_ns: ms("max_age_ms"),
            deadline_ns: ms("deadline_ms"),
            mailbox: found
                .may(fields.get("mailbox").map(|m| m.whole(1, 65_536, "a mailbox depth")))
                .map(|m| m as usize),
            adapt: found.may(fields.get("adapt").map(Cursor::flag)).unwrap_or(false),
            delay: found.may(fields.get("delay").map(Cursor::flag)).unwrap_or(false),
            replace: false,
            carrier: found.may(fields.get("carrier").map(Cursor::text)).unwrap_or_default().to_owned(),
        };
        let (Some(client), Some(server)) = (client, server) else {
            doubts.is_one_lost = true;
            continue;
        };
        if !pairs.insert((client.to_string(), server.to_string())) {
            found.note(value.problem(format!("{client} → {server} is listed twice"), "keep one of the two"));
        }
        if found.count() > before {
            doubts.connections.insert(connections.len());
        }
        connections.push(ConnectionSpec { client, server, options });
    }
    connections
}

/// `"latest"` or `{"fifo": N, "drop_oldest": false}`.
fn queue(value: &Cursor<'_>, found: &Found) -> Option<Queue> {
    if let super::scan::Kind::Text(_) = value.node.kind {
        return found.take(value.one_of(&[("latest", Queue::Latest)]));
    }
    let fields = value.fields("a queue (or the text \"latest\")", QUEUE, found);
    let depth = fields.need("fifo", found);
    let depth = depth.and_then(|fifo| found.take(fifo.whole(1, 65_536, "a queue depth in samples")));
    let drop_oldest = found.may(fields.get("drop_oldest").map(Cursor::flag)).unwrap_or(false);
    Some(Queue::Fifo { depth: depth? as usize, drop_oldest })
}
