//! The Stops that were ordered here, and the decisions that they hold off.
//!
//! Invariant: a Stop is noted before any component is looked at, and a component is set in motion only while
//! no Stop that was decided later names it. The oldest are forgotten to the safe side.

use std::collections::BTreeMap;

use parking_lot::Mutex;
use trocar_lcm_api::{Decision, Stop, StoppedHere};
use trocar_model::{ComponentId, Target};

/// Most targets that are told apart.
const MOST: usize = 1024;

#[derive(Default)]
pub(super) struct Latches(Mutex<Latched>);

#[derive(Default)]
struct Latched {
    latches: BTreeMap<Target, Latch>,
    /// Everything decided before this is held off: what was forgotten.
    floor: Decision,
    /// The last decision of which there was an order.
    seen: Decision,
    /// Number of the last Stop that this process was asked for itself.
    here: u64,
}

#[derive(Clone, Copy, Default)]
struct Latch {
    /// The Stop that the GCM decided.
    decision: Decision,
    /// The Stop that this process was asked for itself, until the GCM has answered it; 0: none.
    here: u64,
}

impl Latches {
    /// Notes a Stop. Returns what there is to tell of Stops that this process was asked for itself, when this
    /// is one of them.
    pub(super) fn stop(&self, stop: &Stop, decision: Decision) -> Option<StoppedHere> {
        let mut latched = self.0.lock();
        let is_here = decision == Decision::HERE;
        if is_here {
            latched.here += 1;
        } else {
            latched.seen = latched.seen.max(decision);
            latched.answered(stop.known_here, decision);
        }
        let here = if is_here { latched.here } else { 0 };
        for target in &stop.targets {
            let latch = latched.latches.entry(target.clone()).or_default();
            latch.here = latch.here.max(here);
            if !is_here {
                latch.decision = latch.decision.max(decision);
            }
            latched.bound();
        }
        is_here.then(|| latched.told())
    }

    /// Tells why this decision sets the component in motion no more; `None`: it may.
    pub(super) fn hold_off(&self, id: &ComponentId, decision: Decision) -> Option<&'static str> {
        let mut latched = self.0.lock();
        latched.seen = latched.seen.max(decision);
        let mut naming = latched.latches.iter().filter(|(target, _)| target.names(id));
        if latched.floor > decision {
            return Some("Stops have been asked for since this was decided");
        }
        naming.find_map(|(_, latch)| match latch {
            Latch { here: 1.., .. } => {
                Some("it was stopped at its process, and the GCM does not know it yet")
            }
            // A Start that was given up is stopped by its own decision.
            latch if latch.decision >= decision && latch.decision != Decision::NONE => {
                Some("it was stopped while this was being carried out")
            }
            _ => None,
        })
    }

    /// The last decision of which there was an order.
    pub(super) fn seen(&self) -> Decision {
        self.0.lock().seen
    }

    /// The Stops of which the GCM has to hear.
    pub(super) fn stopped_here(&self) -> StoppedHere {
        self.0.lock().told()
    }
}

impl Latched {
    /// The GCM has heard of the Stops up to `here`, and decided their own.
    fn answered(&mut self, here: u64, decision: Decision) {
        for latch in self.latches.values_mut().filter(|latch| (1..=here).contains(&latch.here)) {
            (latch.here, latch.decision) = (0, latch.decision.max(decision));
        }
    }

    /// Forgets the oldest target: what was decided before it is held off for every component. A Stop that
    /// the GCM has not answered is not forgotten.
    fn bound(&mut self) {
        if self.latches.len() <= MOST {
            return;
        }
        let answered = self.latches.iter().filter(|(_, latch)| latch.here == 0);
        if let Some(oldest) =
            answered.min_by_key(|(_, latch)| latch.decision).map(|(target, _)| target.clone())
        {
            let forgotten = self.latches.remove(&oldest).unwrap_or_default();
            self.floor = self.floor.max(forgotten.decision);
            return;
        }
        // More of them than are told apart: everything is stopped here.
        let decision = self.latches.values().map(|latch| latch.decision).max().unwrap_or_default();
        self.latches = BTreeMap::from([(Target::everything(), Latch { decision, here: self.here })]);
    }

    fn told(&self) -> StoppedHere {
        let open = self.latches.iter().filter(|(_, latch)| latch.here > 0);
        let targets: Vec<_> = open.map(|(target, latch)| (target.clone(), latch.here)).collect();
        StoppedHere { number: if targets.is_empty() { 0 } else { self.here }, targets }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn id(path: &str) -> ComponentId {
        ComponentId::parse(path).unwrap()
    }

    fn stop(paths: &[&str], known_here: u64) -> Stop {
        let targets = paths.iter().map(|path| Target::parse(path).unwrap()).collect();
        Stop { targets, known_here }
    }

    #[test]
    fn a_stop_holds_off_what_was_decided_before_it_and_nothing_else() {
        let latches = Latches::default();
        assert_eq!(latches.stop(&stop(&["host/arm", "host/cam*"], 0), Decision(7)), None);
        for (path, decision, held) in [
            ("host/arm", 6, true),
            ("host/arm", 8, false),
            ("host/camera", 6, true),
            ("host/camera", 8, false),
            ("host/other", 6, false),
        ] {
            assert_eq!(latches.hold_off(&id(path), Decision(decision)).is_some(), held, "{path} {decision}");
        }
        latches.stop(&stop(&["host/arm"], 0), Decision(3));
        assert!(latches.hold_off(&id("host/arm"), Decision(6)).is_some(), "an older Stop comes late");
        assert_eq!(latches.seen(), Decision(8));
    }

    #[test]
    fn a_stop_at_the_process_holds_off_everything_until_the_gcm_has_answered_it() {
        let latches = Latches::default();
        let told = latches.stop(&stop(&["host/arm"], 0), Decision::HERE).unwrap();
        assert_eq!((told.number, told.targets.len()), (1, 1));
        // The GCM decides another Stop of the same, and does not know of this one.
        latches.stop(&stop(&["host/arm"], 0), Decision(7));
        assert!(latches.hold_off(&id("host/arm"), Decision(8)).is_some());
        assert_eq!(latches.stopped_here(), told);
        // It hears of the first while there is a second.
        let both = latches.stop(&stop(&["host/camera"], 0), Decision::HERE).unwrap();
        latches.stop(&stop(&["host/arm"], told.number), Decision(9));
        assert_eq!(latches.hold_off(&id("host/arm"), Decision(10)), None);
        assert!(latches.hold_off(&id("host/arm"), Decision(8)).is_some(), "decided before it knew");
        assert!(latches.hold_off(&id("host/camera"), Decision(10)).is_some());
        latches.stop(&stop(&["host/camera"], both.number), Decision(11));
        assert_eq!(latches.hold_off(&id("host/camera"), Decision(12)), None);
        assert_eq!(latches.stopped_here(), StoppedHere::default());
    }

    #[test]
    fn what_is_forgotten_is_held_off_for_everybody() {
        let latches = Latches::default();
        for n in 1..=2000 {
            latches.stop(&stop(&[&format!("host/c{n}")], 0), Decision(n));
            assert!(latches.0.lock().latches.len() <= MOST);
        }
        assert!(latches.hold_off(&id("host/c1"), Decision(0)).is_some(), "an early one");
        assert!(latches.hold_off(&id("host/c2000"), Decision(1999)).is_some(), "the last one");
        assert_eq!(latches.hold_off(&id("host/other"), Decision(2001)), None);
        for n in 1..=2000 {
            latches.stop(&stop(&[&format!("host/h{n}")], 0), Decision::HERE);
            assert!(latches.0.lock().latches.len() <= MOST);
        }
        let open = latches.hold_off(&id("host/h1"), Decision(1 << 40));
        assert!(open.is_some(), "one that the GCM has not heard of is never forgotten");
    }
}
