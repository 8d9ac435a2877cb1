//! Threads for this process: where the machine refuses one, a warning lasts until there are some again.
//!
//! Invariant: nothing is tried while every request for a thread was granted. Another process of this user
//! would get no thread either, so this one stays fit: a restart would not help.

use std::io;
use std::sync::{Arc, Weak};
use std::thread::Builder;
use std::time::Duration;

use trocar_rt::house;

use crate::lcm::{Concern, LocalLcm};

/// Pause between two looks.
const LOOK: Duration = Duration::from_secs(1);

/// Looks after them as long as the LCM is there.
pub(super) fn keep(lcm: &Arc<LocalLcm>) {
    tokio::spawn(watch(Arc::downgrade(lcm)));
}

async fn watch(lcm: Weak<LocalLcm>) {
    let mut looks = tokio::time::interval(LOOK);
    looks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut threads = Threads { refused: house::refused(), told: false };
    loop {
        looks.tick().await;
        let Some(lcm) = lcm.upgrade() else { return };
        let warning = threads.look(house::refused(), one_more);
        // Trying counts, too.
        threads.refused = house::refused();
        if let Some(warning) = warning {
            warning.iter().for_each(|warning| log::error!("{warning}"));
            lcm.warn(Concern::Threads, warning);
        }
    }
}

/// A thread that ends at once, to see whether there is one.
fn one_more() -> io::Result<()> {
    house::spawn(Builder::new().name("trocar-try".into()), || ()).map(drop)
}

struct Threads {
    /// Number of threads refused up to the last look.
    refused: u64,
    told: bool,
}

impl Threads {
    /// Returns the change of the warning; `None`: as before. The caller that asked was told of a refusal that
    /// lasted for a moment.
    fn look(&mut self, refused: u64, one_more: impl FnOnce() -> io::Result<()>) -> Option<Option<String>> {
        if refused == self.refused && !self.told {
            return None;
        }
        let given = one_more();
        if given.is_err() == std::mem::replace(&mut self.told, given.is_err()) {
            return None;
        }
        Some(given.err().map(|e| {
            format!(
                "the machine gives it no more threads ({e}): no component with a thread of its own can be made in it, and what \
                 waits for a thread of the host waits on; end programs of this user, or raise `ulimit -u` or the limit of its \
                 container (`trocar doctor` shows them)"
            )
        }))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn it_is_warned_from_a_refusal_on_until_there_is_a_thread_again() {
        assert!(Concern::Threads < Concern::Files, "it stays fit");
        let mut threads = Threads { refused: 0, told: false };
        let none = || Err(io::Error::from_raw_os_error(11));
        assert_eq!(threads.look(0, || panic!("nothing is tried while nothing was refused")), None);
        assert_eq!(threads.look(1, || Ok(())), None, "it was for a moment");
        threads.refused = 1;
        let warning = threads.look(2, none).unwrap().unwrap();
        assert!(warning.contains("gives it no more threads") && warning.contains("ulimit -u"), "{warning}");
        threads.refused = 2;
        assert_eq!(threads.look(2, none), None, "told already");
        assert_eq!(threads.look(2, || Ok(())), Some(None));
        assert_eq!(threads.look(2, || panic!("nothing is tried any more")), None);
    }
}
