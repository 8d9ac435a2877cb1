//! Bounds of a process's memory: one from where on it is warned, and one where it ends.
//!
//! Invariant: a process that takes too much ends alone, by the kernel's refusal; nothing here takes part in
//! the work of components.

use std::sync::{Arc, Weak};
use std::time::Duration;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use super::HostError;
use crate::lcm::{Concern, LocalLcm};

/// Bounds of one process's memory, MiB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MemoryBounds {
    /// Resident memory above which the process is listed with a warning.
    pub warn_mib: Option<u32>,
    /// Most memory of its own (`RLIMIT_DATA`: heap and stacks as asked for, without memory that processes
    /// share); a request for more ends the process.
    pub limit_mib: Option<u32>,
}

/// Pause between two looks.
const LOOK: Duration = Duration::from_millis(250);
/// Part of the bound below which a warning is taken back, so that it does not come and go.
const BACK: f64 = 0.9;

impl MemoryBounds {
    /// Both bounds, when they can be.
    ///
    /// # Errors
    /// A warning that would come after the end.
    pub fn new(warn_mib: Option<u32>, limit_mib: Option<u32>) -> Result<MemoryBounds, String> {
        match (warn_mib, limit_mib) {
            (Some(warn), Some(limit)) if warn > limit => {
                Err(format!("the process ends at {limit} MiB, before it is warned of {warn} MiB"))
            }
            _ => Ok(MemoryBounds { warn_mib, limit_mib }),
        }
    }

    /// Sets the limit, and looks after the rest as long as the LCM is there.
    pub(super) fn keep(self, lcm: &Arc<LocalLcm>) -> Result<(), HostError> {
        if let Some(mib) = self.limit_mib {
            let bytes = u64::from(mib) << 20;
            let maximum = getrlimit(Resource::Data).maximum;
            setrlimit(Resource::Data, Rlimit { current: Some(bytes), maximum })
                .map_err(|e| HostError::Memory { mib, because: e.to_string() })?;
        }
        if let Some(warn_mib) = self.warn_mib {
            tokio::spawn(watch(Arc::downgrade(lcm), warn_mib, self.limit_mib));
        }
        Ok(())
    }
}

async fn watch(lcm: Weak<LocalLcm>, warn_mib: u32, limit_mib: Option<u32>) {
    let mut looks = tokio::time::interval(LOOK);
    looks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut told = false;
    loop {
        looks.tick().await;
        let Some(lcm) = lcm.upgrade() else { return };
        let Some(used) = resident_mib() else { return };
        if let Some(warning) = judge(&mut told, used, warn_mib, limit_mib) {
            warning.iter().for_each(|warning| log::warn!("{warning}"));
            lcm.warn(Concern::Memory, warning);
        }
    }
}

/// Returns the change of the warning; `None`: as before.
fn judge(told: &mut bool, used_mib: f64, warn_mib: u32, limit_mib: Option<u32>) -> Option<Option<String>> {
    let bound = f64::from(warn_mib) * if *told { BACK } else { 1.0 };
    let beyond = used_mib > bound;
    if beyond == std::mem::replace(told, beyond) {
        return None;
    }
    let end = limit_mib.map(|mib| format!(", and ends where it asks for more than {mib} MiB of its own"));
    let warning = || {
        let end = end.unwrap_or_default();
        format!(
            "the process has {used_mib:.0} MiB of memory in use, it was to be warned of {warn_mib} MiB{end}"
        )
    };
    Some(beyond.then(warning))
}

/// Returns the resident memory of the process now, MiB; `None` where the kernel does not tell.
fn resident_mib() -> Option<f64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: f64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size() as f64 / f64::from(1 << 20))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn a_warning_comes_once_and_is_taken_back_well_below_the_bound() {
        let mut told = false;
        let mut at = |used| judge(&mut told, used, 100, Some(200));
        assert_eq!(at(100.0), None, "at the bound");
        let warned = at(100.9).unwrap();
        assert!(
            warned.as_ref().is_some_and(|w| w.contains("101 MiB") && w.contains("200 MiB")),
            "{warned:?}"
        );
        assert_eq!(at(150.0), None, "told already");
        assert_eq!(at(95.0), None, "hardly below");
        assert_eq!(at(89.0), Some(None));
        assert_eq!(at(95.0), None, "not beyond again");
    }

    #[test]
    fn this_process_has_something_resident() {
        assert!(resident_mib().unwrap() > 1.0);
    }
}
