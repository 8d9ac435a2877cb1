//! The search for an order: each request at one moment between its question and its answer (Wing and Gong),
//! with a memory of what was tried (Lowe).
//!
//! Invariant: an order that is found respects time, the places that the system itself gave, and every answer.
//! A request whose answer was lost happened at one moment before it was lost, or never.

use std::collections::HashSet;
use std::fmt::Debug;
use std::hash::Hash;

/// Most configurations that are tried: more would be no answer in time.
const MOST_TRIED: usize = 20_000_000;

/// A system that does one call after the other.
pub(crate) trait Model {
    type State: Clone + Eq + Hash + Debug;
    type Call: Debug;

    /// The state after a call; `None` where this state does not answer it so.
    fn after(state: &Self::State, call: &Self::Call) -> Option<Self::State>;
}

/// A request and its answer.
#[derive(Clone, Debug)]
pub(crate) struct Event<C> {
    pub(crate) call: C,
    /// When it was asked, ns.
    pub(crate) began: u64,
    /// When it was answered, or known to be lost, ns.
    pub(crate) ended: u64,
    /// There was no answer: `call` says what it did if it happened.
    pub(crate) is_lost: bool,
    /// Its place among all changes, as the system says.
    pub(crate) place: Option<u64>,
}

/// One step on the way to an order, and the others that could be taken in its stead.
struct Step<S> {
    choices: Vec<(usize, S)>,
    next: usize,
    /// Before it.
    state: S,
    first: usize,
    placed: usize,
}

struct Search<'e, M: Model> {
    /// In the order of their questions.
    events: Vec<&'e Event<M::Call>>,
    /// Number of calls with an earlier place, of each that has one.
    rank: Vec<Option<usize>>,
    done: Vec<bool>,
    /// All before it are done.
    first: usize,
    /// Number of calls with a place that are done.
    placed: usize,
    state: M::State,
    answered_left: usize,
}

/// Calls that can be next, and those that stand in the way of all others.
struct Window<S> {
    choices: Vec<(usize, S)>,
    /// Calls that are done among those that are not.
    ahead: Vec<u32>,
    /// Calls that are not done, of which one has to be next.
    open: Vec<usize>,
}

/// Finds an order of all events from that state on.
///
/// # Errors
/// There is none: how far the best attempt came, and what could not be next. Or too much was tried.
pub(crate) fn explain<M: Model>(start: M::State, events: &[Event<M::Call>]) -> Result<(), String> {
    let mut search = Search::<M>::of(start, events);
    let (mut steps, mut tried, mut best) = (Vec::<Step<M::State>>::new(), HashSet::new(), None);
    loop {
        if search.answered_left == 0 {
            return Ok(());
        }
        let window = search.window();
        let is_new = tried.insert((search.first, window.ahead, search.state.clone()));
        if tried.len() > MOST_TRIED {
            return Err(format!("undecided after {MOST_TRIED} configurations"));
        }
        if best.as_ref().is_none_or(|(left, _)| search.answered_left < *left) {
            best = Some((search.answered_left, search.words(&window.open)));
        }
        let choices = if is_new { window.choices } else { Vec::new() };
        let (state, first, placed) = (search.state.clone(), search.first, search.placed);
        steps.push(Step { choices, next: 0, state, first, placed });
        while let Some(step) = steps.last_mut() {
            if step.next > 0 {
                search.take_back(step);
            }
            let Some((index, state)) = step.choices.get(step.next).cloned() else {
                steps.pop();
                continue;
            };
            step.next += 1;
            search.take(index, state);
            break;
        }
        if steps.is_empty() {
            let (left, words) = best.unwrap_or_default();
            let of = events.iter().filter(|event| !event.is_lost).count();
            return Err(format!(
                "no order explains it; {} of {of} answers in order, then {words}",
                of - left
            ));
        }
    }
}

impl<'e, M: Model> Search<'e, M> {
    fn of(state: M::State, events: &'e [Event<M::Call>]) -> Search<'e, M> {
        let mut events: Vec<&Event<M::Call>> = events.iter().collect();
        events.sort_by_key(|event| event.began);
        let mut places: Vec<u64> = events.iter().filter_map(|event| event.place).collect();
        places.sort_unstable();
        let of = |event: &&Event<M::Call>| Some(places.partition_point(|place| Some(*place) < event.place));
        let rank = events.iter().map(|event| event.place.and_then(|_| of(event))).collect();
        let answered_left = events.iter().filter(|event| !event.is_lost).count();
        let done = vec![false; events.len()];
        Search { events, rank, done, first: 0, placed: 0, state, answered_left }
    }

    /// Looks at those that nothing has to come before.
    fn window(&self) -> Window<M::State> {
        let mut open: Vec<usize> = Vec::new();
        let (mut ahead, mut earliest) = (Vec::new(), u64::MAX);
        for (index, event) in self.events.iter().enumerate().skip(self.first) {
            if event.began > earliest {
                break;
            }
            if self.done[index] {
                ahead.push(index as u32);
            } else {
                open.push(index);
                earliest = earliest.min(event.ended);
            }
        }
        open.retain(|index| self.events[*index].began <= earliest);
        let (mut answered, mut lost, mut given_up) = (Vec::new(), Vec::new(), None);
        for &index in &open {
            let event = self.events[index];
            if self.rank[index].is_some_and(|rank| rank != self.placed) {
                continue;
            }
            // It cannot have happened later: never, then.
            if event.is_lost && event.ended == earliest {
                given_up = Some((index, self.state.clone()));
            }
            let Some(state) = M::after(&self.state, &event.call) else { continue };
            match (event.is_lost, state == self.state) {
                // A call that changes nothing can as well be first.
                (false, true) => return Window { choices: vec![(index, state)], ahead, open },
                (false, false) => answered.push((index, state)),
                (true, true) => {}
                (true, false) => lost.push((index, state)),
            }
        }
        answered.extend(given_up);
        answered.append(&mut lost);
        Window { choices: answered, ahead, open }
    }

    fn take(&mut self, index: usize, state: M::State) {
        (self.done[index], self.state) = (true, state);
        self.placed += usize::from(self.rank[index].is_some());
        self.answered_left -= usize::from(!self.events[index].is_lost);
        while self.done.get(self.first) == Some(&true) {
            self.first += 1;
        }
    }

    /// Takes back the choice that a step made last.
    fn take_back(&mut self, step: &Step<M::State>) {
        let Some((index, _)) = step.choices.get(step.next - 1) else { return };
        self.done[*index] = false;
        self.answered_left += usize::from(!self.events[*index].is_lost);
        (self.state, self.first, self.placed) = (step.state.clone(), step.first, step.placed);
    }

    fn words(&self, open: &[usize]) -> String {
        let of = |index: &usize| {
            let Event { call, began, ended, is_lost, place } = self.events[*index];
            let place = place.map(|place| format!(" as {place}")).unwrap_or_default();
            let lost = if *is_lost { ", lost" } else { "" };
            format!("{call:?}{place}{lost} ({began} to {ended})")
        };
        let open: Vec<String> = open.iter().map(of).collect();
        format!("in {:?} none of: {}", self.state, open.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A place for a number.
    struct Cell;

    #[derive(Debug)]
    enum Use {
        Write(u8),
        Read(u8),
    }

    impl Model for Cell {
        type State = u8;
        type Call = Use;

        fn after(state: &u8, call: &Use) -> Option<u8> {
            match call {
                Use::Write(value) => Some(*value),
                Use::Read(value) => (value == state).then_some(*state),
            }
        }
    }

    fn event(call: Use, began: u64, ended: u64) -> Event<Use> {
        Event { call, began, ended, is_lost: false, place: None }
    }

    fn lost(call: Use, began: u64, ended: u64) -> Event<Use> {
        Event { is_lost: true, ..event(call, began, ended) }
    }

    fn placed(call: Use, began: u64, ended: u64, place: u64) -> Event<Use> {
        Event { place: Some(place), ..event(call, began, ended) }
    }

    fn is(events: &[Event<Use>]) -> bool {
        match explain::<Cell>(0, events) {
            Ok(()) => true,
            Err(why) => {
                assert!(why.starts_with("no order explains it"), "{why}");
                false
            }
        }
    }

    use Use::{Read, Write};

    #[test]
    fn what_is_asked_one_after_the_other_is_answered_so() {
        assert!(is(&[]));
        assert!(is(&[
            event(Write(1), 0, 1),
            event(Read(1), 2, 3),
            event(Write(2), 4, 5),
            event(Read(2), 6, 7)
        ]));
        assert!(!is(&[event(Write(1), 0, 1), event(Write(2), 2, 3), event(Read(1), 4, 5)]));
        assert!(!is(&[event(Read(1), 0, 1), event(Write(1), 2, 3)]), "read before it was written");
    }

    #[test]
    fn what_is_asked_at_the_same_time_may_be_in_any_order() {
        for read in [0, 1, 2] {
            assert!(is(&[event(Write(1), 0, 9), event(Write(2), 0, 9), event(Read(read), 0, 9)]), "{read}");
        }
        assert!(!is(&[event(Write(1), 0, 9), event(Write(2), 0, 9), event(Read(3), 0, 9)]));
        // Two who read after each other see the writes in one order.
        let reads = |first, second| {
            is(&[
                event(Write(1), 0, 9),
                event(Write(2), 0, 9),
                event(Read(first), 0, 4),
                event(Read(second), 5, 9),
            ])
        };
        assert!(reads(1, 2) && reads(2, 1) && reads(0, 1) && reads(1, 1));
        assert!(!reads(1, 0), "it was there, and is not");
        // A third one has seen the same order.
        let three = |third| {
            let mut events = vec![event(Write(1), 0, 9), event(Write(2), 0, 9), event(Read(1), 0, 2)];
            events.extend([event(Read(2), 3, 4), event(Read(third), 5, 6)]);
            is(&events)
        };
        assert!(three(2) && !three(1));
    }

    #[test]
    fn what_was_lost_happened_once_before_it_was_lost_or_never() {
        assert!(is(&[lost(Write(1), 0, 1), event(Read(0), 2, 3)]));
        assert!(is(&[lost(Write(1), 0, 1), event(Read(1), 2, 3)]));
        assert!(!is(&[lost(Write(1), 0, 1), event(Read(1), 2, 3), event(Read(0), 4, 5)]), "and was undone");
        assert!(!is(&[lost(Write(1), 0, 1), event(Read(0), 2, 3), event(Read(1), 4, 5)]), "later");
        let twice = [lost(Write(1), 0, 1), event(Read(1), 2, 3), event(Write(2), 4, 5), event(Read(1), 6, 7)];
        assert!(!is(&twice));
        // Several lost calls are each for itself.
        let two = |read| is(&[lost(Write(1), 0, 3), lost(Write(2), 0, 3), event(Read(read), 4, 5)]);
        assert!(two(0) && two(1) && two(2));
        // An answer that nobody got is nobody's to explain.
        assert!(is(&[lost(Write(1), 0, 3), lost(Write(2), 0, u64::MAX)]));
    }

    #[test]
    fn the_places_that_were_given_are_kept_to() {
        let with = |first, second, read| {
            is(&[placed(Write(1), 0, 9, first), placed(Write(2), 0, 9, second), event(Read(read), 10, 11)])
        };
        assert!(with(7, 8, 2) && with(8, 7, 1));
        assert!(!with(7, 8, 1) && !with(8, 7, 2));
        assert!(!is(&[placed(Write(1), 0, 1, 8), placed(Write(2), 2, 3, 7)]), "against time");
        assert!(!is(&[placed(Write(1), 0, 9, 7), placed(Write(2), 0, 9, 7)]), "one place, twice");
    }

    #[test]
    fn a_wrong_turn_is_taken_back() {
        // The lost write must be put between, which is seen only in the end.
        let mut events = vec![event(Write(1), 0, 99), lost(Write(2), 0, 50), event(Write(3), 0, 99)];
        events.extend([event(Read(3), 1, 10), event(Read(2), 11, 20), event(Read(1), 21, 99)]);
        assert!(is(&events));
        events.push(event(Read(2), 100, 101));
        assert!(!is(&events));
    }

    #[test]
    fn a_long_history_of_many_is_explained_soon() {
        // Sixteen at a time, in 2000 rounds; each round ends with the value that one of them wrote.
        let mut events = Vec::new();
        for round in 0..2_000u64 {
            let at = round * 100;
            let value = |n: u64| ((round + n) % 200) as u8 + 1;
            events.extend((0..16).map(|n| placed(Write(value(n)), at, at + 50, round * 16 + n)));
            events.push(event(Read(value(15)), at + 60, at + 70));
        }
        assert!(is(&events));
        events.push(event(Read(0), 300_000, 300_001));
        assert!(!is(&events));
    }
}
