//! Where a component's thread comes from: the class's default overlaid with what Create asks, and what may be asked.
//!
//! Invariant: a setting that was asked for is used or refused, never ignored; a class's default that does not fit the
//! model that was asked for falls away.

use crate::refusal::duration;
use crate::{Component, ComponentId, Execution, ExecutionModel, Refusal, SystemGraph};

/// Limits of a period, ns.
const PERIOD_NS: (u64, u64) = (1_000, 3_600_000_000_000);
/// Limits of a SCHED_FIFO priority.
const PRIORITY: (u8, u8) = (1, 99);

impl ExecutionModel {
    pub fn name(self) -> &'static str {
        match self {
            ExecutionModel::Periodic => "periodic",
            ExecutionModel::Continuous => "continuous",
            ExecutionModel::OnSignal => "on_signal",
            ExecutionModel::OnCallback => "on_callback",
            ExecutionModel::ExecIn => "exec_in",
            ExecutionModel::ExecOut => "exec_out",
            ExecutionModel::Stream => "stream",
            ExecutionModel::None => "none",
        }
    }

    /// Steps on a grid, so a period means something.
    fn has_grid(self) -> bool {
        matches!(self, ExecutionModel::Periodic | ExecutionModel::Stream)
    }
}

/// The class's execution with everything `asked` sets in its place; a thread of another component brings its own rate,
/// priority and processors.
pub(super) fn overlay(class: &Execution, asked: &Execution) -> Execution {
    let named = |text: &Option<String>| text.clone().filter(|t| !t.is_empty());
    let (stream_of, inside) = (named(&asked.stream_of), named(&asked.inside));
    if stream_of.is_some() || inside.is_some() {
        let implied = if stream_of.is_some() { Some(ExecutionModel::Stream) } else { class.model };
        return Execution {
            model: asked.model.or(implied),
            period_ns: asked.period_ns,
            phase_ns: asked.phase_ns,
            stream_of,
            inside,
            priority: asked.priority,
            cpus: asked.cpus.clone(),
            catch_up: asked.catch_up,
            threads: asked.threads,
            max_step_ns: asked.max_step_ns.or(class.max_step_ns),
            on_failure: asked.on_failure.or(class.on_failure),
        };
    }
    let model = asked.model.or(class.model);
    let grid = model.is_some_and(ExecutionModel::has_grid);
    let own_thread = asked.model.is_some();
    Execution {
        model,
        period_ns: asked.period_ns.or(class.period_ns.filter(|_| grid)),
        phase_ns: asked.phase_ns.or(class.phase_ns.filter(|_| grid)),
        stream_of: named(&class.stream_of).filter(|_| !own_thread),
        inside: named(&class.inside).filter(|_| !own_thread),
        priority: asked.priority.or(class.priority),
        cpus: if asked.cpus.is_empty() { class.cpus.clone() } else { asked.cpus.clone() },
        catch_up: asked.catch_up.or(class.catch_up),
        threads: asked.threads.or(class.threads),
        max_step_ns: asked.max_step_ns.or(class.max_step_ns),
        on_failure: asked.on_failure.or(class.on_failure),
    }
}

/// A component that would run in its own thread of thought: A in A.
pub(super) fn check_cycle(
    graph: &SystemGraph,
    id: &ComponentId,
    execution: &Execution,
) -> Result<(), Refusal> {
    let mut path = vec![id.clone()];
    let mut next = super::host_of(execution);
    while let Some(host) = next {
        path.push(host.clone());
        if host == *id {
            return Err(Refusal::SyncCycle { path });
        }
        // The graph itself holds no cycle, but a walk that trusts nobody ends anyway.
        if path.len() > graph.components.len() + 1 {
            break;
        }
        next = graph.components.get(&host).and_then(|c| super::host_of(&c.execution));
    }
    Ok(())
}

/// Everything else that may be wrong with an execution.
pub(super) fn check(graph: &SystemGraph, id: &ComponentId, execution: &Execution) -> Result<(), Refusal> {
    let bad = |field: &str, why: String| {
        let field = format!("execution.{field}");
        Err(Refusal::ArgumentInvalid { what: format!("Create {id}"), why: format!("{field}: {why}"), field })
    };
    if let (Some(_), Some(_)) = (&execution.stream_of, &execution.inside) {
        return bad(
            "inside",
            "it cannot be set together with stream_of; a component runs in one thread".to_owned(),
        );
    }
    let ridden = execution.stream_of.as_ref().map(|s| ("stream_of", s));
    if let Some((field, host)) = ridden.or(execution.inside.as_ref().map(|s| ("inside", s))) {
        if let Err(why) = check_host(graph, id, field, host) {
            return bad(field, why);
        }
        return match misplaced(field, execution) {
            Some((setting, why)) => {
                bad(setting, format!("{why}, since the component runs in the thread of `{host}`"))
            }
            None => Ok(()),
        };
    }
    let Some(model) = execution.model else {
        return bad("model", "neither the class nor the request says how it runs".to_owned());
    };
    match execution.period_ns {
        Some(_) if !model.has_grid() => {
            return bad("rate_hz", format!("a rate means nothing to model {}", model.name()));
        }
        Some(period) if period < PERIOD_NS.0 || period > PERIOD_NS.1 => {
            let (low, high) = (duration(PERIOD_NS.0), duration(PERIOD_NS.1));
            return bad("rate_hz", format!("a period of {} is outside {low} to {high}", duration(period)));
        }
        None if model == ExecutionModel::Periodic => {
            return bad("rate_hz", "model periodic needs a rate in Hz".to_owned());
        }
        _ => {}
    }
    match (execution.phase_ns, execution.period_ns) {
        (Some(phase), Some(period)) if phase >= period => {
            let (phase, period) = (duration(phase), duration(period));
            return bad("phase", format!("{phase} is not below the period, {period}"));
        }
        (Some(phase), None) if phase > 0 => return bad("phase", "there is no grid to shift".to_owned()),
        _ => {}
    }
    match execution.priority {
        Some(_) if model == ExecutionModel::None => {
            bad("priority", "a passive component (model none) has no thread".to_owned())
        }
        Some(p) if p < PRIORITY.0 || p > PRIORITY.1 => {
            bad("priority", format!("{p} is outside {} to {}", PRIORITY.0, PRIORITY.1))
        }
        _ => Ok(()),
    }
}

/// A setting that belongs to the thread, not to a component that only runs in it.
fn misplaced(field: &str, execution: &Execution) -> Option<(&'static str, &'static str)> {
    match execution.model {
        Some(ExecutionModel::Stream) | None => {}
        Some(_) if field == "stream_of" => return Some(("model", "only model stream fits")),
        Some(ExecutionModel::None) => return Some(("model", "a passive component (model none) has no step")),
        Some(_) => {}
    }
    if execution.period_ns.is_some() {
        Some(("rate_hz", "a rate cannot be set"))
    } else if execution.phase_ns.is_some_and(|p| p > 0) {
        Some(("phase", "a phase cannot be set"))
    } else if execution.priority.is_some() {
        Some(("priority", "a priority cannot be set"))
    } else if !execution.cpus.is_empty() {
        Some(("cpus", "processors cannot be chosen"))
    } else {
        None
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

/// Whether the thread a component runs in is still there: its host may have been removed by force, or made anew.
pub(super) fn check_thread(graph: &SystemGraph, execution: &Execution) -> Result<(), String> {
    let Some(host) = super::host_of(execution) else { return Ok(()) };
    let field = if execution.stream_of.is_some() { "stream_of" } else { "inside" };
    match graph.components.get(&host) {
        None => Err(format!("it runs in the thread of `{host}`, which does not exist any more")),
        Some(component) => able(component, field)
            .map_err(|why| format!("it was made to run in the thread of `{host}`, which now {why}")),
    }
}

/// Whether others can run in the stream or step of `host`.
fn able(host: &Component, field: &str) -> Result<(), String> {
    let execution = &host.execution;
    let model = execution.model.map_or("nothing", ExecutionModel::name);
    if field == "stream_of" {
        let rides = execution.stream_of.is_some() || execution.model == Some(ExecutionModel::Stream);
        let alone = execution.inside.is_none();
        return if rides && alone {
            Ok(())
        } else {
            Err(format!("runs as {model}; only a component of model stream leads a stream (or use inside)"))
        };
    }
    if execution.model == Some(ExecutionModel::None) {
        return Err("is passive (model none): it has no step to run inside".to_owned());
    }
    Ok(())
}
