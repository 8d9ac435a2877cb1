//! Threads of the process that the host did not start, as plugins and their libraries do.
//!
//! Invariant: a thread that begins or ends during the look is never counted as another one.

use std::collections::BTreeMap;

use trocar_rt::house;
use trocar_rt::threads;

/// Threads that the host did not start, by number and begin.
pub(super) struct Others(BTreeMap<i32, u64>);

impl Others {
    pub(super) fn now() -> Others {
        let mut own = house::threads();
        let listed = threads::list();
        // A thread that has come or gone meanwhile is on one of both lists.
        own.extend(house::threads());
        let others = listed.into_iter().filter(|tid| !own.contains(tid));
        Others(others.map(|tid| (tid, threads::began(tid))).filter(|(_, began)| *began > 0).collect())
    }

    /// Tells whether a thread runs that did not run then.
    pub(super) fn are_more(&self) -> bool {
        Others::now().0.iter().any(|(tid, began)| self.0.get(tid) != Some(began))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;
    use std::thread;

    use super::*;

    #[test]
    fn a_thread_that_the_host_did_not_start_is_seen_while_it_runs() {
        let before = Others::now();
        let (end, ended) = channel::<()>();
        let (tell, told) = channel();
        let other = thread::spawn(move || {
            tell.send(trocar_rt::os::thread_id()).ok();
            ended.recv().ok();
        });
        let tid = told.recv().unwrap_or_default();
        assert!(before.are_more() && Others::now().0.contains_key(&tid));
        drop(end);
        assert!(other.join().is_ok());
    }
}
