//! One cycle of a thread: the members that step, their order, and their timing.
//!
//! Invariant: real-time. A member steps at most once per cycle; a member that runs inside another one steps
//! exactly when that one is due, before it (`exec_in`) or after it (`exec_out`), and never keeps the other
//! from its step.

use std::sync::Arc;

use trocar_model::State;
use trocar_plugin_api::abi::{NOT_ACTIVE, Tick};
use trocar_rt::executor::{Cycle, Pace};
use trocar_rt::{os, turn};

use super::boundary::{deferred, inside, told};
use super::context;
use super::core::{Core, Entered};
use super::instance::Instance;
use super::pending;
use super::supervise::Suspicion;
use super::watch::{Entry, Misdeed};

/// Time at which a member of a thread steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Follow {
    /// In every cycle of its thread.
    Thread,
    /// When new data have come: a filter of a stream.
    Input,
    /// Whenever this member (an instance's number) steps.
    Member(u32),
}

/// One component on a thread.
#[derive(Clone)]
pub(super) struct Member {
    pub(super) instance: Arc<Instance>,
    /// Its core, for the step path.
    core: Arc<Core>,
    pub(super) follow: Follow,
    /// Whether it steps in this cycle; `None` until decided.
    due: Option<bool>,
}

impl Member {
    pub(super) fn new(instance: Arc<Instance>, follow: Follow) -> Member {
        Member { core: instance.core.clone(), instance, follow, due: None }
    }
}

/// Runs a cycle in which every member that follows its thread steps; true when one did.
pub(super) fn all(members: &mut [Member], cycle: &Cycle) -> bool {
    run(members, cycle, false)
}

/// Runs a cycle in which only signalled members step; true when one did.
pub(super) fn signalled(members: &mut [Member], cycle: &Cycle) -> bool {
    run(members, cycle, true)
}

/// Runs the queued calls of members between cycles, where no step would come soon.
pub(super) fn serve(members: &[Member], pace: Pace) {
    if members.iter().any(|m| m.core.has_signal() && !steps_at_once(m, pace)) {
        turn::run(|| serve_signalled(members, pace));
    }
}

/// Tells whether the member's own step comes right away and takes the queued calls.
fn steps_at_once(member: &Member, pace: Pace) -> bool {
    let steps = member.core.is_active() && !member.core.is_called_back();
    steps && !matches!(member.follow, Follow::Member(_)) && pace == Pace::Signal
}

fn serve_signalled(members: &[Member], pace: Pace) {
    let mut served = false;
    for member in members.iter().filter(|m| m.core.has_signal()) {
        let core = &member.core;
        if steps_at_once(member, pace) {
            continue;
        }
        let steps = core.is_active() && !core.is_called_back();
        if !served {
            context::set_stepping(true);
        }
        served = true;
        if bypass(&member.instance) {
            continue;
        }
        // The mark of a filter also means that a frame is there; its step takes it.
        if !steps || member.follow != Follow::Input {
            core.take_signal();
        }
        core.serve();
    }
    if served {
        pending::publish();
        context::set_stepping(false);
        told::flush_wakes();
        deferred::give();
    }
}

/// Answers the calls queued for members that are not ACTIVE.
pub(super) fn refuse(members: &[Member]) {
    for member in members.iter().filter(|m| m.core.take_signal()) {
        member.core.serve();
    }
}

/// Runs the whole cycle as one turn of this thread, and takes the members' locks once for it: within it
/// neither bindings nor entries cost an atomic operation.
fn run(members: &mut [Member], cycle: &Cycle, by_signal: bool) -> bool {
    turn::run(|| {
        context::set_stepping(true);
        keep(members);
        let stepped = turn_of(members, cycle, by_signal);
        pending::publish();
        context::set_stepping(false);
        told::flush_wakes();
        deferred::give();
        members.iter().for_each(|m| m.core.object.let_go());
        stepped
    })
}

/// Takes the locks of the members that run on this thread alone.
fn keep(members: &[Member]) {
    let own = |m: &&Member| m.core.is_active() && !m.core.is_passive() && !m.core.is_called_back();
    members.iter().filter(own).for_each(|m| m.core.object.keep());
}

fn turn_of(members: &mut [Member], cycle: &Cycle, by_signal: bool) -> bool {
    members.iter_mut().for_each(|m| m.due = None);
    let mut stepped = false;
    // The end of one member's time is the beginning of the next one's.
    let mut now_ns = cycle.begin_ns;
    for at in 0..members.len() {
        let due = is_due(members, at, by_signal);
        let member = &members[at];
        if due {
            let on_grid = cycle.period_ns > 0 && goes_with_thread(members, at);
            now_ns = step(member, cycle, on_grid, now_ns);
            stepped = true;
        } else if member.core.has_signal() && !steps_for_signal(member, by_signal) {
            unstepped(member);
        }
    }
    stepped
}

/// Tells whether the member steps only when signalled. A signal that comes after it was asked in a cycle
/// keeps its mark for the next one: served without a step it would leave the members that run inside without
/// theirs.
fn steps_for_signal(member: &Member, by_signal: bool) -> bool {
    let follows = member.follow == Follow::Input || by_signal && member.follow == Follow::Thread;
    follows && member.core.is_active() && !member.core.is_called_back()
}

/// Tells whether its steps are its thread's cycles: not those of a filter, nor of a member that runs inside
/// one.
fn goes_with_thread(members: &[Member], at: usize) -> bool {
    let mut follow = members[at].follow;
    // The chain is no deeper than the number of members; the limit holds even if two members name each other.
    for _ in members {
        match follow {
            Follow::Thread => return true,
            Follow::Input => return false,
            Follow::Member(number) => match members.iter().find(|m| m.core.number == number) {
                Some(around) => follow = around.follow,
                None => return false,
            },
        }
    }
    false
}

/// Tells whether the member at `at` steps in this cycle; decided once, so that all members around it get the
/// same answer.
fn is_due(members: &mut [Member], at: usize, by_signal: bool) -> bool {
    if let Some(due) = members[at].due {
        return due;
    }
    // If two members name each other, neither steps.
    members[at].due = Some(false);
    let parent_is_due = match members[at].follow {
        Follow::Thread | Follow::Input => true,
        Follow::Member(number) => match members.iter().position(|m| m.core.number == number) {
            Some(parent) => is_due(members, parent, by_signal),
            None => false,
        },
    };
    let member = &members[at];
    let core = &member.core;
    let mut due = parent_is_due && core.is_active() && !core.is_called_back();
    if due && steps_for_signal(member, by_signal) {
        due = core.take_signal();
    } else if due {
        core.take_signal();
    }
    members[at].due = Some(due);
    due
}

/// Serves a signalled member that does not step: its queue is run or answered; frames may pass it.
fn unstepped(member: &Member) {
    if !bypass(&member.instance) && member.core.take_signal() {
        member.core.serve();
    }
}

/// Lets frames pass a failed component with a bypass, and answers its queued calls; false for any other.
fn bypass(instance: &Instance) -> bool {
    if !instance.bypasses() || instance.state() != State::Fault {
        return false;
    }
    // Cleared before the look at the frames: later arrivals and leftovers set the mark again.
    instance.take_signal();
    if let Some(mut entered) = instance.object.try_enter() {
        instance.bypass(&mut entered);
    }
    instance.refuse_queued(NOT_ACTIVE);
    true
}

/// Makes one step with its timing; returns its end, ns. `on_grid`: whether periods that its thread leaves out
/// are its own.
fn step(member: &Member, cycle: &Cycle, on_grid: bool, begin_ns: u64) -> u64 {
    let core = &*member.core;
    // A control entry is still inside; this cycle is left out and counted.
    let Some(mut entered) = core.object.try_enter() else {
        core.books.steps.record_skipped(1 + if on_grid { cycle.skipped } else { 0 });
        return begin_ns;
    };
    if !core.is_active() {
        // The component was stopped, or failed, after this cycle had asked which members step: the cycle is
        // not its own.
        drop(entered);
        if !bypass(&member.instance) {
            core.serve();
        }
        return begin_ns;
    }
    let inner = entered.inner();
    let fresh = inner.last_begin_ns == 0;
    // Periods left out before its start are not its own.
    let skipped = if on_grid && !fresh { cycle.skipped } else { 0 };
    inner.cycle += 1 + skipped;
    let period_ns = if on_grid { cycle.period_ns } else { 0 };
    let elapsed_ns = if fresh { period_ns } else { begin_ns.saturating_sub(inner.last_begin_ns) };
    inner.last_begin_ns = begin_ns;
    let tick = Tick {
        struct_size: size_of::<Tick>() as u32,
        flags: 0,
        cycle: inner.cycle - 1 - inner.cycle_at_start,
        now_ns: begin_ns,
        deadline_ns: if on_grid { cycle.deadline_ns } else { begin_ns },
        period_ns,
        elapsed_ns,
    };
    let Stepped { end_ns, ran } = enter(core, &mut entered, &tick);
    drop(entered);
    if !ran {
        core.books.steps.record_skipped(1 + skipped);
        return end_ns;
    }
    // Lateness of its thread; the time that others in the cycle took before it does not count as its own.
    let lateness_ns = if on_grid { cycle.begin_ns.saturating_sub(cycle.deadline_ns) } else { 0 };
    core.books.steps.record(begin_ns, end_ns, lateness_ns);
    core.books.steps.record_skipped(skipped);
    if on_grid && lateness_ns + (end_ns - begin_ns) > period_ns && core.watch.overran() {
        context::wake(core.watchdog());
    }
    end_ns
}

/// Result of a step.
struct Stepped {
    /// Its end, ns.
    end_ns: u64,
    /// Whether the component's own code ran: not when it left ACTIVE while its queues ran.
    ran: bool,
}

/// Makes one step: first the queued entries, then the component's own step. Real-time.
fn enter(core: &Core, entered: &mut Entered<'_>, tick: &Tick) -> Stepped {
    let watched = core.watch.begin(Entry::Step, tick.now_ns);
    let before = inside::swap_component(core);
    context::set_step_began(tick.now_ns);
    let suspicion = Suspicion::before(&core.watch);
    core.drain(entered);
    let ran = core.is_active();
    let failed = if ran { entered.step(tick).err() } else { None };
    context::set_step_began(0);
    let end_ns = os::now_ns();
    if !context::keep_rounding() {
        core.watch.misdeed(Misdeed::Rounding);
    }
    if let Some(suspicion) = suspicion {
        suspicion.after(&core.watch);
    }
    match failed {
        None => core.publish_row(entered, end_ns),
        Some(e) => core.fail(entered, "step", &e),
    }
    inside::swap_component(before);
    core.watch.leave(watched);
    core.pay_safe(entered);
    Stepped { end_ns, ran }
}
