//! The thread of a component: the class's default overlaid with the request, and the component that owns the
//! thread.
//!
//! Invariant: a setting that was asked for is used or refused, never ignored; a default that does not fit the
//! model that was asked for falls away.

mod check;

pub(super) use check::{check, check_limits};
pub use check::{class_fault, period_fault};

use crate::{Component, ComponentId, Execution, ExecutionModel, Refusal, SystemGraph};

impl ExecutionModel {
    /// Tells whether it steps on a grid, so that a period means something.
    pub(crate) fn has_grid(self) -> bool {
        matches!(self, ExecutionModel::Periodic | ExecutionModel::Stream)
    }

    /// Tells whether it runs inside another component's step.
    pub(super) fn is_inside(self) -> bool {
        matches!(self, ExecutionModel::ExecIn | ExecutionModel::ExecOut)
    }
}

/// Returns the class's execution with everything `asked` sets in its place; a thread of another component
/// brings its own rate, priority and processors.
pub(super) fn overlay(class: &Execution, asked: &Execution) -> Execution {
    let named = |text: &Option<String>| text.clone().filter(|t| !t.is_empty());
    let (stream_of, inside) = (named(&asked.stream_of), named(&asked.inside));
    if stream_of.is_some() || inside.is_some() {
        let implied = if stream_of.is_some() {
            ExecutionModel::Stream
        } else {
            class.model.filter(|m| m.is_inside()).unwrap_or(ExecutionModel::ExecIn)
        };
        let model = asked.model.or(Some(implied));
        return Execution {
            model,
            period_ns: asked.period_ns,
            phase_ns: asked.phase_ns,
            stream_of,
            inside,
            priority: asked.priority,
            cpus: asked.cpus.clone(),
            catch_up: asked.catch_up,
            threads: asked.threads,
            max_step_ns: asked.max_step_ns.or(class.max_step_ns),
            history: asked.history.or(class.history),
            on_failure: asked
                .on_failure
                .or(class.on_failure.filter(|_| model == Some(ExecutionModel::Stream))),
            wake: asked.wake,
        };
    }
    let model = asked.model.or(class.model);
    let grid = model.is_some_and(ExecutionModel::has_grid);
    let stream = model == Some(ExecutionModel::Stream);
    let passive = model == Some(ExecutionModel::None);
    let own_thread = asked.model.is_some();
    Execution {
        model,
        period_ns: asked.period_ns.or(class.period_ns.filter(|_| grid)),
        phase_ns: asked.phase_ns.or(class.phase_ns.filter(|_| grid)),
        stream_of: named(&class.stream_of).filter(|_| !own_thread),
        inside: named(&class.inside).filter(|_| !own_thread),
        priority: asked.priority.or(class.priority.filter(|_| !passive)),
        cpus: if asked.cpus.is_empty() && !passive { class.cpus.clone() } else { asked.cpus.clone() },
        catch_up: asked.catch_up.or(class.catch_up.filter(|_| grid)),
        threads: asked.threads.or(class.threads.filter(|_| stream)),
        max_step_ns: asked.max_step_ns.or(class.max_step_ns.filter(|_| !grid)),
        history: asked.history.or(class.history),
        on_failure: asked.on_failure.or(class.on_failure.filter(|_| stream)),
        wake: asked.wake.or(class.wake.filter(|_| grid)),
    }
}

/// Returns the least that has to be asked of a class for an execution like `whole`: settings the class has by
/// itself are left out.
pub fn least_execution(class: &Execution, whole: &Execution) -> Execution {
    let mut asked = whole.clone();
    for leave_out in LEAVING {
        let mut less = asked.clone();
        leave_out(&mut less);
        if overlay(class, &less) == *whole {
            asked = less;
        }
    }
    asked
}

/// Takes out one setting each. A model that is left out brings others back, so it comes first.
const LEAVING: [fn(&mut Execution); 13] = [
    |e| e.model = None,
    |e| e.stream_of = None,
    |e| e.inside = None,
    |e| e.period_ns = None,
    |e| e.phase_ns = None,
    |e| e.priority = None,
    |e| e.cpus.clear(),
    |e| e.catch_up = None,
    |e| e.threads = None,
    |e| e.max_step_ns = None,
    |e| e.history = None,
    |e| e.on_failure = None,
    |e| e.wake = None,
];

/// Returns the present execution with everything `asked` sets in its place. A model without a host means a
/// thread of its own, but for exec_in and exec_out, which stay with the host they have.
pub(super) fn change(class: &Execution, present: &Execution, asked: &Execution) -> Execution {
    if super::host_of(present).is_none() {
        let period_ns = present.period_ns.or(class.period_ns);
        return overlay(&Execution { period_ns, ..present.clone() }, asked);
    }
    let stays = asked.model.is_none_or(|m| m.is_inside() && present.inside.is_some());
    let elsewhere = asked.stream_of.is_some() || asked.inside.is_some();
    if stays && !elsewhere {
        let (stream_of, inside) = (present.stream_of.clone(), present.inside.clone());
        return overlay(present, &Execution { stream_of, inside, ..asked.clone() });
    }
    overlay(class, asked)
}

/// Refuses a component that would run in its own thread by way of its hosts: A in A.
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
        // The graph itself holds no cycle, but a walk that trusts no input ends anyway.
        if path.len() > graph.components.len() + 1 {
            break;
        }
        next = graph.components.get(&host).and_then(|c| super::host_of(&c.execution));
    }
    Ok(())
}

/// Checks that the thread a component runs in is still there: its host may have been removed by force, or
/// made anew.
pub(super) fn check_thread(graph: &SystemGraph, execution: &Execution) -> Result<(), String> {
    let Some(host) = super::host_of(execution) else { return Ok(()) };
    let field = if execution.stream_of.is_some() { "stream_of" } else { "inside" };
    match graph.components.get(&host) {
        None => Err(format!("it runs in the thread of `{host}`, which does not exist any more")),
        Some(component) => able(component, field)
            .map_err(|why| format!("it was made to run in the thread of `{host}`, which now {why}")),
    }
}

/// Checks that others can run in the stream or step of `host`.
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
