//! Limits of a requested execution: each setting within its range and only where it means something.
//!
//! Invariant: a refusal names the field, the value and the limits; limits of the machine (processors,
//! priorities it grants) are not judged here, since only the machine knows them.

use super::super::host_of;
use super::able;
use crate::refusal::duration;
use crate::{
    ClassInfo, ComponentId, Execution, ExecutionLimits, ExecutionModel, Refusal, SystemGraph, Type, Wake,
    defaults, validate,
};

/// Limits of a period, ns.
const PERIOD_NS: (u64, u64) = (1_000, 3_600_000_000_000);
/// Limits of a SCHED_FIFO priority.
const PRIORITY: (u8, u8) = (1, 99);
/// Largest number of a processor.
const CPU: usize = 4095;
/// Most late periods that are made up for in one go.
const CATCH_UP: u32 = 1000;
/// Limits of the threads of a stream.
const THREADS: (u32, u32) = (1, 64);
/// Limits of the longest stay inside a component's own code, ns.
const MAX_STEP_NS: (u64, u64) = (100_000, 3_600_000_000_000);
/// Limits of the rows a state table keeps: with fewer than three the newest could be overwritten while it is
/// read.
const HISTORY: (u32, u32) = (3, 65_536);
/// Most bytes a state table may take.
const HISTORY_BYTES: usize = 256 << 20;

/// A setting and what is wrong with it.
type Fault = (&'static str, String);

/// Tells what no Create could accept of a class's own execution and defaults. A setting that a Create may
/// still add, a rate or a thread to run in, may be absent.
pub fn class_fault(class: &ClassInfo) -> Option<String> {
    let defaults = defaults(&class.config_schema);
    let mut wrong = validate(&class.config_schema, &defaults).into_iter();
    if let Some(wrong) = wrong.find(|v| defaults.pointer(&v.pointer).is_some()) {
        return Some(format!("its own defaults are not valid: {}", wrong.message));
    }
    let execution = &class.execution;
    let open = execution.model == Some(ExecutionModel::Periodic) && execution.period_ns.is_none();
    let checked = if open { Ok(()) } else { grid(execution) };
    let checked = checked
        .and_then(|()| scheduling(execution))
        .and_then(|()| stream(execution))
        .and_then(|()| step(execution))
        .and_then(|()| history(execution, row_bytes(class)))
        .and_then(|()| if open { Ok(()) } else { limits(class, execution, execution.period_ns) });
    checked.err().map(|(field, why)| format!("execution.{field}: {why}"))
}

/// Bytes of one row of its components' state tables.
fn row_bytes(class: &ClassInfo) -> usize {
    class.ports.state.as_ref().map_or(0, Type::size)
}

/// Checks everything that may be wrong with an execution but a cycle.
pub(crate) fn check(
    graph: &SystemGraph,
    verb: &str,
    id: &ComponentId,
    class: &ClassInfo,
    execution: &Execution,
) -> Result<(), Refusal> {
    let row_bytes = row_bytes(class);
    let checked = host(graph, id, execution)
        .and_then(|()| called_back(class, execution))
        .and_then(|()| grid(execution))
        .and_then(|()| scheduling(execution))
        .and_then(|()| stream(execution))
        .and_then(|()| step(execution))
        .and_then(|()| step_without_period(execution))
        .and_then(|()| wake(execution))
        .and_then(|()| history(execution, row_bytes))
        .and_then(|()| limits(class, execution, period_of(graph, execution)));
    checked.map_err(|(field, why)| {
        let field = format!("execution.{field}");
        Refusal::ArgumentInvalid { what: format!("{verb} {id}"), why: format!("{field}: {why}"), field }
    })
}

/// Checks the host of the thread, and that the model fits it.
fn host(graph: &SystemGraph, id: &ComponentId, execution: &Execution) -> Result<(), Fault> {
    let (field, host) = match (&execution.stream_of, &execution.inside) {
        (Some(_), Some(_)) => {
            let why = "it cannot be set together with stream_of; a component runs in one thread";
            return Err(("inside", why.to_owned()));
        }
        (Some(host), None) => ("stream_of", host),
        (None, Some(host)) => ("inside", host),
        (None, None) => {
            return match execution.model {
                None => Err(("model", "neither the class nor the request says how it runs".to_owned())),
                Some(m) if m.is_inside() => Err((
                    "inside",
                    format!("model {} needs the component in whose step it runs: inside", m.name()),
                )),
                Some(_) => Ok(()),
            };
        }
    };
    check_host(graph, id, field, host).map_err(|why| (field, why))?;
    let why = match execution.model {
        Some(ExecutionModel::Stream) | None if field == "stream_of" => None,
        Some(m) if field == "inside" && m.is_inside() => None,
        Some(ExecutionModel::None) => Some("a passive component (model none) has no step".to_owned()),
        _ if field == "stream_of" => Some("only model stream fits".to_owned()),
        Some(m) => Some(format!("model {} has a thread of its own; only exec_in or exec_out fit", m.name())),
        None => Some("only exec_in or exec_out fit".to_owned()),
    };
    if let Some(why) = why {
        return Err(("model", format!("{why}, since the component runs in the thread of `{host}`")));
    }
    match misplaced(execution) {
        Some((setting, why)) => {
            Err((setting, format!("{why}, since the component runs in the thread of `{host}`")))
        }
        None => Ok(()),
    }
}

/// Refuses on_callback for a class that is not made for it: such a class never gets its device's calls.
fn called_back(class: &ClassInfo, execution: &Execution) -> Result<(), Fault> {
    let [asked, offered] =
        [execution.model, class.execution.model].map(|m| m == Some(ExecutionModel::OnCallback));
    if !asked || offered {
        return Ok(());
    }
    let why = format!(
        "on_callback is for classes that a device calls back; `{}` is none and would never run",
        class.name
    );
    Err(("model", why))
}

/// Checks that a component can still be run by the thread that sets its pace.
pub(crate) fn check_limits(
    graph: &SystemGraph,
    class: &ClassInfo,
    execution: &Execution,
) -> Result<(), String> {
    limits(class, execution, period_of(graph, execution)).map_err(|(_, why)| why)
}

/// Checks that a class is run only as it is made for. `period_ns`: time between its steps, whichever thread
/// sets the pace.
fn limits(class: &ClassInfo, execution: &Execution, period_ns: Option<u64>) -> Result<(), Fault> {
    let ExecutionLimits { models, min_period_ns, max_period_ns } = &class.limits;
    let name = &class.name;
    let model = execution.model.map_or("nothing", ExecutionModel::name);
    if !models.is_empty() && !execution.model.is_some_and(|m| models.contains(&m)) {
        let models: Vec<_> = models.iter().map(|m| m.name()).collect();
        return Err((
            "model",
            format!("class `{name}` is made to run as {}, not as {model}", models.join(" or ")),
        ));
    }
    let (low, high) = (min_period_ns.unwrap_or(1), max_period_ns.unwrap_or(u64::MAX));
    let made_for = || match (min_period_ns, max_period_ns) {
        (Some(low), Some(high)) => format!("{} to {}", rate(*high), rate(*low)),
        (Some(low), None) => format!("at most {}", rate(*low)),
        (None, Some(high)) => format!("at least {}", rate(*high)),
        (None, None) => String::new(),
    };
    match period_ns {
        Some(period) if !(low..=high).contains(&period) => {
            let (field, thread) = match (&execution.stream_of, &execution.inside) {
                (Some(host), _) => ("stream_of", format!(" in the stream of `{host}`")),
                (_, Some(host)) => ("inside", format!(" in the step of `{host}`")),
                (None, None) => ("rate_hz", String::new()),
            };
            Err((field, format!("{}{thread}: class `{name}` is made for {}", rate(period), made_for())))
        }
        None if (min_period_ns.is_some() || max_period_ns.is_some())
            && !execution.model.is_some_and(|m| !m.has_grid() && !m.is_inside() && models.contains(&m)) =>
        {
            let why =
                format!("class `{name}` is made for steps on a grid, {}; {model} has none here", made_for());
            Err(("model", why))
        }
        _ => Ok(()),
    }
}

/// "1000 Hz", "33.333 Hz".
fn rate(period_ns: u64) -> String {
    format!("{} Hz", (1e12 / period_ns as f64).round() / 1e3)
}

/// Returns the time between the steps of a component with this execution, ns; `None` where no grid gives it.
fn period_of(graph: &SystemGraph, execution: &Execution) -> Option<u64> {
    let mut execution = execution;
    // The graph holds no circle, but a walk that trusts no input ends anyway.
    for _ in 0..=graph.components.len() {
        let Some(host) = host_of(execution) else {
            let grid = execution.model.is_some_and(ExecutionModel::has_grid);
            return execution.period_ns.filter(|_| grid);
        };
        execution = &graph.components.get(&host)?.execution;
    }
    None
}

/// Finds a setting that belongs to the thread, not to a component that only runs in it.
fn misplaced(execution: &Execution) -> Option<(&'static str, &'static str)> {
    if execution.period_ns.is_some() {
        Some(("rate_hz", "a rate cannot be set"))
    } else if execution.phase_ns.is_some_and(|p| p > 0) {
        Some(("phase", "a phase cannot be set"))
    } else if execution.priority.is_some() {
        Some(("priority", "a priority cannot be set"))
    } else if !execution.cpus.is_empty() {
        Some(("cpus", "processors cannot be chosen"))
    } else if execution.catch_up.is_some_and(|n| n > 0) {
        Some(("catch_up", "late periods cannot be made up for"))
    } else if execution.threads.is_some_and(|n| n != 1) {
        Some(("threads", "threads are set where the stream begins and cannot be set here"))
    } else if execution.wake.is_some() {
        Some(("wake", "how a thread is woken cannot be set"))
    } else {
        None
    }
}

/// Tells what is wrong with the length of a period, ns.
pub fn period_fault(period_ns: u64) -> Option<String> {
    let (low, high) = PERIOD_NS;
    let [asked, least, most] = [period_ns, low, high].map(duration);
    (!(low..=high).contains(&period_ns)).then(|| format!("a period of {asked} is outside {least} to {most}"))
}

fn grid(execution: &Execution) -> Result<(), Fault> {
    let model = execution.model.map_or("nothing", ExecutionModel::name);
    let has_grid = execution.model.is_some_and(ExecutionModel::has_grid);
    if let Some(why) = execution.period_ns.filter(|_| has_grid).and_then(period_fault) {
        return Err(("rate_hz", why));
    }
    match execution.period_ns {
        Some(_) if !has_grid => {
            return Err(("rate_hz", format!("a rate means nothing to model {model}")));
        }
        None if execution.model == Some(ExecutionModel::Periodic) => {
            return Err(("rate_hz", "model periodic needs a rate in Hz".to_owned()));
        }
        _ => {}
    }
    match (execution.phase_ns, execution.period_ns) {
        (Some(phase), Some(period)) if phase >= period => {
            let (phase, period) = (duration(phase), duration(period));
            return Err(("phase", format!("{phase} is not below the period, {period}")));
        }
        (Some(phase), None) if phase > 0 => {
            return Err(("phase", format!("{}: there is no grid to shift", duration(phase))));
        }
        _ => {}
    }
    match execution.catch_up {
        Some(n) if n > CATCH_UP => {
            Err(("catch_up", format!("{n} late periods are more than {CATCH_UP}, the most made up for")))
        }
        Some(n) if n > 0 && execution.period_ns.is_none() => {
            Err(("catch_up", format!("{n}: model {model} has no rate here, so no period is ever late")))
        }
        _ => Ok(()),
    }
}

fn scheduling(execution: &Execution) -> Result<(), Fault> {
    let passive = execution.model == Some(ExecutionModel::None);
    match execution.priority {
        Some(_) if passive => {
            return Err(("priority", "a passive component (model none) has no thread".to_owned()));
        }
        Some(p) if !(PRIORITY.0..=PRIORITY.1).contains(&p) => {
            return Err(("priority", format!("{p} is outside {} to {}", PRIORITY.0, PRIORITY.1)));
        }
        _ => {}
    }
    if passive && !execution.cpus.is_empty() {
        return Err(("cpus", "a passive component (model none) has no thread".to_owned()));
    }
    if let Some(cpu) = execution.cpus.iter().find(|cpu| **cpu > CPU) {
        return Err(("cpus", format!("{cpu} is no number of a processor, 0 to {CPU}")));
    }
    let twice = execution.cpus.iter().enumerate().find(|(at, cpu)| execution.cpus[..*at].contains(cpu));
    match twice {
        Some((_, cpu)) => Err(("cpus", format!("processor {cpu} is named twice"))),
        None => Ok(()),
    }
}

fn stream(execution: &Execution) -> Result<(), Fault> {
    let model = execution.model.map_or("nothing", ExecutionModel::name);
    let stream = execution.model == Some(ExecutionModel::Stream);
    match execution.threads {
        Some(n) if !(THREADS.0..=THREADS.1).contains(&n) => {
            return Err(("threads", format!("{n} is outside {} to {}", THREADS.0, THREADS.1)));
        }
        Some(n) if n > 1 && !stream => {
            return Err((
                "threads",
                format!("{n} threads share the work of a stream; this is model {model}"),
            ));
        }
        _ => {}
    }
    if execution.on_failure.is_some() && !stream {
        return Err(("on_failure", format!("it is for the filters of a stream; this is model {model}")));
    }
    Ok(())
}

fn step(execution: &Execution) -> Result<(), Fault> {
    match execution.max_step_ns {
        Some(ns) if !(MAX_STEP_NS.0..=MAX_STEP_NS.1).contains(&ns) => {
            let (low, high) = (duration(MAX_STEP_NS.0), duration(MAX_STEP_NS.1));
            Err(("max_step", format!("{} is outside {low} to {high}", duration(ns))))
        }
        _ => Ok(()),
    }
}

/// Refuses max_step beside a period: five periods or 50 ms are the longest stay then.
fn step_without_period(execution: &Execution) -> Result<(), Fault> {
    let grid = execution.stream_of.is_none() && execution.model.is_some_and(ExecutionModel::has_grid);
    match execution.max_step_ns {
        Some(_) if grid => Err((
            "max_step",
            "it is for a component without a period; one that has a period may stay inside for five of them, or 50 ms if \
             that is longer"
                .to_owned(),
        )),
        _ => Ok(()),
    }
}

/// Refuses polling without a period: the thread would never look.
fn wake(execution: &Execution) -> Result<(), Fault> {
    let model = execution.model.map_or("nothing", ExecutionModel::name);
    match execution.wake {
        Some(Wake::Poll) if execution.period_ns.is_none() => {
            let why =
                format!("poll: model {model} has no rate here, so it would never look; \"signal\" wakes it");
            Err(("wake", why))
        }
        Some(_) if execution.model == Some(ExecutionModel::None) => {
            Err(("wake", "a passive component (model none) has no thread to wake".to_owned()))
        }
        _ => Ok(()),
    }
}

fn history(execution: &Execution, row_bytes: usize) -> Result<(), Fault> {
    match execution.history {
        Some(rows) if !(HISTORY.0..=HISTORY.1).contains(&rows) => {
            Err(("history", format!("{rows} rows is outside {} to {}", HISTORY.0, HISTORY.1)))
        }
        Some(rows) if rows as usize * row_bytes > HISTORY_BYTES => Err((
            "history",
            format!(
                "{rows} rows of {row_bytes} bytes are more than {} MiB, the most a state table may take",
                HISTORY_BYTES >> 20
            ),
        )),
        _ => Ok(()),
    }
}

fn check_host(graph: &SystemGraph, id: &ComponentId, field: &str, text: &str) -> Result<(), String> {
    let host = ComponentId::parse(text).map_err(|e| e.to_string())?;
    if host.process != id.process {
        return Err(format!("`{host}` is in another process; one thread stays in one process"));
    }
    let component = graph.component(&host).map_err(|e| e.to_string())?;
    able(component, field).map_err(|why| format!("`{host}` {why}"))
}
