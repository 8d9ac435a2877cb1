//! Real-time settings of threads and of the process: requests, grants of the machine, warnings about
//! refusals.
//!
//! Invariant: a component runs whatever is refused; every refusal becomes a warning that says what to do
//! about it.

use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, OnceLock};

use parking_lot::Mutex;
use trocar_model::Execution;
use trocar_rt::os::{self, Hygiene};
use trocar_rt::team::Team;

/// Stack of a component's thread, bytes.
pub(super) const STACK_BYTES: usize = 1 << 20;

/// Prefix of the names of threads that help a stream; no component's name has it.
pub(super) const HELPER: &str = "+";

/// Bytes of a thread's name the kernel keeps.
pub(super) const NAME_BYTES: usize = 15;

/// Bytes of its stack, from the top, that a thread touches and locks when the process could not lock
/// everything.
const LOCKED_STACK: usize = 128 << 10;

/// Locked part of the process's memory.
#[derive(Clone, Debug, Default)]
pub(super) enum Memory {
    /// Locking was not asked for.
    #[default]
    Loose,
    /// All memory, also future memory.
    All,
    /// Frame pools and the upper [`LOCKED_STACK`] of each thread's stack only, and why not all.
    Stacks(String),
}

impl Memory {
    /// Locks the memory that the machine allows. All of it only if that cannot make later threads and
    /// mappings fail.
    pub(super) fn lock() -> Memory {
        match os::lock_memory() {
            Ok(()) => Memory::All,
            Err(e) => Memory::Stacks(e.to_string()),
        }
    }

    /// Tells whether memory used on a step has to be locked piece by piece.
    pub(super) fn is_in_pieces(&self) -> bool {
        matches!(self, Memory::Stacks(_))
    }
}

/// Settings that a thread was granted.
#[derive(Default)]
pub(super) struct Settings {
    warnings: Mutex<Vec<String>>,
    realtime: AtomicBool,
    /// SCHED_FIFO priority that was granted; 0 = normal scheduling.
    priority: AtomicU8,
    /// State of the thread before any component ran on it.
    hygiene: OnceLock<Hygiene>,
    /// True while the thread was asked to restore its signal mask and has not done so yet.
    pub(super) mask_due: AtomicBool,
}

impl Settings {
    /// Applies the settings to the calling thread.
    pub(super) fn settle(&self, name: &str, execution: &Execution) {
        os::set_thread_name(name);
        self.hygiene.get_or_init(os::thread_hygiene);
        let mut warnings = Vec::new();
        if let Err(e) = os::set_timer_slack_ns(1) {
            warnings.push(format!("timer slack stays at the system's default: {e}"));
        }
        let realtime = schedule(execution, &mut warnings);
        self.realtime.store(realtime, Ordering::Relaxed);
        self.priority.store(execution.priority.filter(|_| realtime).unwrap_or(0), Ordering::Relaxed);
        self.warnings.lock().extend(warnings);
    }

    /// Locks the calling thread's stack where the whole process is not locked but should be.
    pub(super) fn lock(&self, memory: &Memory) {
        let Memory::Stacks(why) = memory else { return };
        self.warn(match lock_stack() {
            Ok(()) => format!(
                "only frame pools and the upper {} KiB of each thread's stack are locked into memory: {why}",
                LOCKED_STACK >> 10
            ),
            Err(e) => format!("its stack is not locked into memory, page faults may delay it: {why}; {e}"),
        });
    }

    /// Locks the stack of a helping thread likewise; the stream's own thread reports why not all is locked.
    fn lock_helper(&self, helper: usize, memory: &Memory) {
        if memory.is_in_pieces()
            && let Err(e) = lock_stack()
        {
            self.warn(format!(
                "the stack of helper thread {helper} is not locked into memory, page faults may delay it: {e}"
            ));
        }
    }

    fn warn(&self, said: String) {
        self.warnings.lock().push(said);
    }

    pub(super) fn warnings(&self) -> Vec<String> {
        self.warnings.lock().clone()
    }

    /// True when SCHED_FIFO was granted.
    pub(super) fn realtime(&self) -> bool {
        self.realtime.load(Ordering::Relaxed)
    }

    /// Expected state of its thread; `None` before it ran.
    pub(super) fn hygiene(&self) -> Option<Hygiene> {
        self.hygiene.get().copied()
    }

    /// SCHED_FIFO priority that was granted; 0 = normal scheduling.
    pub(super) fn priority(&self) -> u8 {
        self.priority.load(Ordering::Relaxed)
    }
}

/// Locks the calling thread's stack below this frame: the pages its entries will use.
#[inline(never)]
fn lock_stack() -> Result<(), os::OsError> {
    let mut stack = [0u8; LOCKED_STACK];
    // By reference: a copy would lie deeper, and be locked instead of these.
    std::hint::black_box(&mut stack);
    os::lock_region(stack.as_ptr(), stack.len())
}

/// Sets priority and processors of the calling thread; true when it is a real-time thread now.
fn schedule(execution: &Execution, warnings: &mut Vec<String>) -> bool {
    let mut realtime = false;
    if let Some(priority) = execution.priority {
        match os::set_fifo(priority) {
            Ok(()) => realtime = true,
            Err(e) => warnings.push(format!(
                "real-time priority {priority} was refused, it runs with normal scheduling: {e}"
            )),
        }
    }
    if !execution.cpus.is_empty()
        && let Err(e) = os::set_affinity(&execution.cpus)
    {
        warnings.push(format!("processors {:?} were refused, it runs on any: {e}", execution.cpus));
    }
    realtime
}

/// The threads that share the work of a stream; `None` when one is enough. Helpers run with the settings of
/// their stream's own thread, which are `of`.
///
/// # Errors
/// The machine gives no more threads.
pub(super) fn team(
    name: &str,
    execution: &Execution,
    memory: &Memory,
    of: Arc<Settings>,
) -> std::io::Result<Option<Arc<Team>>> {
    let threads = execution.threads.unwrap_or(1) as usize;
    if threads < 2 {
        return Ok(None);
    }
    let (name, execution, memory) = (name.to_owned(), execution.clone(), memory.clone());
    let team = Team::new(threads, move |helper| {
        os::set_thread_name(&format!("{HELPER}{helper} {name}"));
        // The stream's own thread reports refusals; it asks for the same.
        schedule(&execution, &mut Vec::new());
        of.lock_helper(helper, &memory);
    })?;
    Ok(Some(Arc::new(team)))
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Barrier, Mutex, PoisonError};

    use trocar_model::Execution;

    use super::{HELPER, Memory, Settings, team};

    #[test]
    fn where_the_memory_cannot_be_locked_the_state_says_what_is_and_why() {
        let settings = Settings::default();
        settings.lock(&Memory::Loose);
        settings.lock(&Memory::All);
        assert_eq!(settings.warnings(), Vec::<String>::new());
        settings.lock(&Memory::Stacks("the limit is finite".into()));
        let said = settings.warnings().join(" ");
        assert!(said.contains("locked into memory") && said.contains("the limit is finite"), "{said}");
    }

    /// Whether the kernel keeps the page of this address in memory.
    fn is_locked(address: usize) -> Option<bool> {
        let maps = std::fs::read_to_string("/proc/self/smaps").ok()?;
        let mut inside = false;
        for line in maps.lines() {
            let range = line.split(' ').next().and_then(|range| range.split_once('-'));
            let ends = range.map(|(from, to)| [from, to].map(|end| usize::from_str_radix(end, 16)));
            match ends {
                Some([Ok(from), Ok(to)]) => inside = (from..to).contains(&address),
                _ if inside && line.starts_with("VmFlags:") => {
                    return Some(line.split_whitespace().any(|flag| flag == "lo"));
                }
                _ => {}
            }
        }
        None
    }

    #[test]
    fn the_stack_of_a_helper_is_locked_or_the_state_names_the_helper() {
        const THREADS: u32 = 3;
        let settings = Arc::new(Settings::default());
        let execution = Execution { threads: Some(THREADS), ..Execution::default() };
        let memory = Memory::Stacks("the limit is finite".into());
        let team = team("s", &execution, &memory, settings.clone()).unwrap_or_default();
        let Some(team) = team else { unreachable!("three threads are a team") };
        let all_here = Barrier::new(THREADS as usize);
        let helpers = Mutex::new(Vec::new());
        team.run(THREADS, &|_| {
            all_here.wait();
            let mut deep = [0u8; 32 << 10];
            std::hint::black_box(&mut deep);
            let name = std::fs::read_to_string("/proc/thread-self/comm").unwrap_or_default();
            if let Some(helper) = name.strip_prefix(HELPER) {
                let helper = helper.chars().take_while(char::is_ascii_digit).collect::<String>();
                let found = (helper, is_locked(deep.as_ptr().addr()));
                helpers.lock().unwrap_or_else(PoisonError::into_inner).push(found);
            }
            0
        });
        let helpers = helpers.into_inner().unwrap_or_else(PoisonError::into_inner);
        assert_eq!(helpers.len() as u32, THREADS - 1, "{helpers:?}");
        let warnings = settings.warnings();
        for (helper, locked) in helpers {
            let named = warnings
                .iter()
                .any(|w| w.contains(&format!("helper thread {helper} ")) && w.contains("ulimit -l"));
            assert_eq!(locked, Some(!named), "helper {helper}: {warnings:?}");
        }
    }
}
