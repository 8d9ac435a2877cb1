//! The phases at which the components of this process step, as the GCM gives them.
//!
//! Invariant: a phase that was asked for is kept; a thread moves its own grid, by a job between two cycles.

use trocar_model::{ComponentId, Phase, StepTimes};

use super::super::executor::Pace;
use super::{Held, LocalLcm, Slot};

/// Number of steps after which the figures of a component are meaningful: the first ones are slow.
const TELLING: u64 = 500;
/// Steps lie within so many standard deviations of their mean, except rare ones.
const DEVIATIONS: f64 = 2.0;
/// A step that takes longer than so many times the mean was interrupted, which says nothing about the next
/// ones.
const TIMES: f64 = 4.0;

impl LocalLcm {
    pub(super) fn give_phases(&self, given: Option<Vec<(ComponentId, Phase)>>) -> StepTimes {
        let mut held = self.held();
        if let Some(given) = given {
            held.phases = given.into_iter().collect();
            let Held { components, phases, .. } = &mut *held;
            for (id, slot) in components {
                slot.give_phase(phases.get(id));
            }
        }
        held.components.iter().filter_map(|(id, slot)| Some((id.clone(), slot.step_ns()?))).collect()
    }
}

impl Slot {
    /// Tells whether its thread is its own, and steps on a grid.
    pub(super) fn has_own_grid(&self) -> bool {
        let own = self.execution.stream_of.is_none() && self.execution.inside.is_none();
        own && matches!(self.executor.pace, Pace::Grid { .. })
    }

    pub(super) fn give_phase(&mut self, phase: Option<&Phase>) {
        if self.has_own_grid() && self.execution.phase_ns.is_none() {
            self.executor.set_phase(phase.map_or(0, |phase| phase.phase_ns));
            self.phase = phase.cloned();
        }
    }

    fn step_ns(&self) -> Option<u64> {
        let stats = self.instance.books.steps.snapshot();
        let compute = stats.compute;
        let most_ns = compute.avg_ns + DEVIATIONS * compute.std_ns;
        let step_ns = most_ns.min(TIMES * compute.avg_ns).ceil() as u64;
        (stats.executed >= TELLING).then(|| step_ns.min(compute.max_ns))
    }
}
