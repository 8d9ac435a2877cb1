//! The GCM as it is shipped, with both halves of Attach, among model processes, networks and disks that fail:
//! one thread, one seed, a clock that jumps from event to event.
//!
//! Invariant: what is simulated is what surrounds the managers; nothing of theirs is a model.

mod callers;
mod chance;
mod classes;
mod disk;
mod goes_on;
mod ids;
#[path = "../../../host/lcm/src/latches.rs"]
mod latches;
mod network;
mod process;
mod truth;
mod world;

use std::collections::BTreeMap;

use chance::Chance;
use parking_lot::Mutex;
pub use truth::Ended;
use truth::Truth;
use world::World;

/// Runs one seed for so many events. `is_told`: they are printed, up to a violation.
///
/// # Panics
/// The machine gives no thread.
pub fn run(seed: u64, events: u64, is_told: bool) -> Ended {
    // Also of tasks that nobody waits for.
    std::panic::set_hook(Box::new(|why| {
        eprintln!("{why}");
        PANICKED.lock().get_or_insert(why.to_string());
    }));
    let work = move || {
        // Before anything is drawn on this thread.
        chance::seed(seed);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build();
        let runtime = runtime.expect("a runtime");
        let truth = Truth::new(is_told);
        runtime.block_on(World::new(Chance::of(seed), truth.clone()).lives(events));
        truth.ended()
    };
    let ended = std::thread::Builder::new().spawn(work).expect("a thread").join();
    let mut ended = ended.unwrap_or(Ended { events: 0, hash: 0, violation: None, counts: BTreeMap::new() });
    ended.violation = ended.violation.or_else(|| PANICKED.lock().take());
    ended
}

/// The first panic.
static PANICKED: Mutex<Option<String>> = Mutex::new(None);
