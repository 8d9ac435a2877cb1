//! One cycle of a thread: the members that step, their order, and their timing.
//!
//! Invariant: real-time. A member steps at most once per cycle; a member that runs inside another one steps
//! exactly when that one is due, before it (`exec_in`) or after it (`exec_out`), and never keeps the other
//! from its step.

use std::sync::Arc;

use trocar_model::State;
use trocar_plugin_api::abi::{NOT_ACTIVE, Tick};
use trocar_rt::executor::{Cycle, Pace};
use trocar_rt::turn;

use super::boundary::{late, told};
use super::context;
use super::instance::{Instance, Stepped};
use super::pending;

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
    pub(super) follow: Follow,
    /// Whether it steps in this cycle; `None` until decided.
    due: Option<bool>,
}

impl Member {
    pub(super) fn new(instance: Arc<Instance>, follow: Follow) -> Member {
        Member { instance, follow, due: None }
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
    if members.iter().any(|m| m.instance.has_signal() && !steps_at_once(m, pace)) {
        turn::run(|| serve_signalled(members, pace));
    }
}

/// Tells whether the member's own step comes right away and takes the queued calls.
fn steps_at_once(member: &Member, pace: Pace) -> bool {
    let steps = member.instance.is_active() && !member.instance.is_called_back();
    steps && !matches!(member.follow, Follow::Member(_)) && pace == Pace::Signal
}

fn serve_signalled(members: &[Member], pace: Pace) {
    let mut served = false;
    for member in members.iter().filter(|m| m.instance.has_signal()) {
        let instance = &member.instance;
        if steps_at_once(member, pace) {
            continue;
        }
        let steps = instance.is_active() && !instance.is_called_back();
        if !served {
            context::set_stepping(true);
        }
        served = true;
        if bypass(instance) {
            continue;
        }
        // The mark of a filter also means that a frame is there; its step takes it.
        if !steps || member.follow != Follow::Input {
            instance.take_signal();
        }
        instance.serve();
    }
    if served {
        pending::publish();
        context::set_stepping(false);
        told::flush_wakes();
        late::give();
    }
}

/// Answers the calls queued for members that are not ACTIVE.
pub(super) fn refuse(members: &[Member]) {
    for member in members.iter().filter(|m| m.instance.take_signal()) {
        member.instance.serve();
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
        late::give();
        members.iter().for_each(|m| m.instance.object.let_go());
        stepped
    })
}

/// Takes the locks of the members that run on this thread alone.
fn keep(members: &[Member]) {
    let own =
        |m: &&Member| m.instance.is_active() && !m.instance.is_passive() && !m.instance.is_called_back();
    members.iter().filter(own).for_each(|m| m.instance.object.keep());
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
        } else if member.instance.has_signal() && !steps_for_signal(member, by_signal) {
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
    follows && member.instance.is_active() && !member.instance.is_called_back()
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
            Follow::Member(number) => match members.iter().find(|m| m.instance.number == number) {
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
        Follow::Member(number) => match members.iter().position(|m| m.instance.number == number) {
            Some(parent) => is_due(members, parent, by_signal),
            None => false,
        },
    };
    let member = &members[at];
    let instance = &member.instance;
    let mut due = parent_is_due && instance.is_active() && !instance.is_called_back();
    if due && steps_for_signal(member, by_signal) {
        due = instance.take_signal();
    } else if due {
        instance.take_signal();
    }
    members[at].due = Some(due);
    due
}

/// Serves a signalled member that does not step: its queue is run or answered; frames may pass it.
fn unstepped(member: &Member) {
    if !bypass(&member.instance) && member.instance.take_signal() {
        member.instance.serve();
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
    let instance = &*member.instance;
    // A control entry is still inside; this cycle is left out and counted.
    let Some(mut entered) = instance.object.try_enter() else {
        instance.stats.record_skipped(1 + if on_grid { cycle.skipped } else { 0 });
        return begin_ns;
    };
    if !instance.is_active() {
        // The component was stopped, or failed, after this cycle had asked which members step: the cycle is
        // not its own.
        drop(entered);
        if !bypass(instance) {
            instance.serve();
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
    let Stepped { end_ns, ran } = instance.step(&mut entered, &tick);
    drop(entered);
    if !ran {
        instance.stats.record_skipped(1 + skipped);
        return end_ns;
    }
    // Lateness of its thread; the time that others in the cycle took before it does not count as its own.
    let lateness_ns = if on_grid { cycle.begin_ns.saturating_sub(cycle.deadline_ns) } else { 0 };
    instance.stats.record(begin_ns, end_ns, lateness_ns);
    instance.stats.record_skipped(skipped);
    if on_grid && lateness_ns + (end_ns - begin_ns) > period_ns && instance.watch.overran() {
        context::wake(instance.watchdog());
    }
    end_ns
}
