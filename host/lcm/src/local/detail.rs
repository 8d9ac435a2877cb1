//! Figures of components for List and Describe: their timing, their counters, their threads.
//!
//! Invariant: reads counters only; never enters the component.

use trocar_model::ComponentId;

use super::super::{Detail, Spread};
use super::{LocalLcm, Slot};

impl LocalLcm {
    /// Returns the figures of those that are there.
    pub(super) fn details_of(&self, ids: Vec<ComponentId>) -> Vec<(ComponentId, Detail)> {
        let held = self.held();
        let is_around = |slot: &Slot| {
            slot.execution.inside.as_deref().is_none_or(|host| {
                let host = ComponentId::parse(host).ok();
                host.and_then(|host| held.components.get(&host)).is_some_and(|host| host.instance.is_active())
            })
        };
        let there = ids.into_iter().filter_map(|id| {
            let slot = held.components.get(&id)?.clone();
            let around = is_around(&slot);
            Some((id, slot, around))
        });
        let there: Vec<_> = there.collect();
        // Counters are read without a lock.
        drop(held);
        there.into_iter().map(|(id, slot, around)| (id, detail(&slot, around))).collect()
    }
}

/// The reason why its phase does not fit.
fn note(slot: &Slot) -> Option<String> {
    let note = slot.phase.as_ref().map(|phase| &phase.note).filter(|note| !note.is_empty())?;
    Some(format!("phase: {note}"))
}

/// `around`: whether the component it runs inside of, if any, is ACTIVE.
fn detail(slot: &Slot, around: bool) -> Detail {
    let s = slot.instance.books.steps.snapshot();
    let spread = |m: trocar_rt::timing::Spread| Spread {
        avg_ns: m.avg_ns,
        std_ns: m.std_ns,
        min_ns: m.min_ns,
        max_ns: m.max_ns,
    };
    let [commands_rejected, events_dropped] = slot.instance.queue_losses();
    Detail {
        period: spread(s.period),
        compute: spread(s.compute),
        lateness_p50_ns: s.lateness_p50_ns,
        lateness_p99_ns: s.lateness_p99_ns,
        lateness_max_ns: s.lateness_max_ns,
        executed: s.executed,
        skipped: s.skipped,
        overruns: s.overruns,
        load: s.load,
        commands: slot.instance.books.commands(),
        commands_rejected,
        events_dropped,
        thread: match (&slot.execution.stream_of, &slot.execution.inside) {
            (Some(head), _) => format!("stream of {head}"),
            (_, Some(head)) if !around => format!("inside {head}, which is not ACTIVE: no steps"),
            (_, Some(head)) => format!("inside {head}"),
            _ if slot.instance.is_called_back() => "threads of its device".into(),
            _ if slot.instance.is_passive() => "callers' threads".into(),
            _ => match slot.execution.threads {
                Some(threads) if threads > 1 => format!("own thread, with {} that help", threads - 1),
                _ => "own thread".into(),
            },
        },
        realtime: slot.executor.settings.realtime(),
        warnings: slot.instance.warnings().into_iter().chain(note(slot)).collect(),
        phase_ns: slot.executor.phase_ns().filter(|_| slot.has_own_grid()),
        phase_auto: slot.has_own_grid() && slot.execution.phase_ns.is_none(),
    }
}
