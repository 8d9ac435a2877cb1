//! The order in which components of one thread step: along their streams, else as they were created; a
//! component that runs inside another one stands right before it (`exec_in`) or right after it (`exec_out`).
//!
//! Invariant: pure; every member appears once; a cycle keeps creation order, so it costs one cycle of delay
//! and no more.

/// Place of a member among the others of its thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// On its own.
    Alone,
    /// Inside another, before it.
    Before(u32),
    /// Inside another, after it.
    After(u32),
}

impl Place {
    fn parent(self) -> Option<u32> {
        match self {
            Place::Alone => None,
            Place::Before(parent) | Place::After(parent) => Some(parent),
        }
    }
}

/// Sorts the members. `members` are (number, place), numbers in the order of creation; `streams` are
/// (producer, consumer), numbers that are no members are ignored. A member whose parent is no member stands
/// on its own.
pub(super) fn along(members: &[(u32, Place)], streams: &[(u32, u32)]) -> Vec<u32> {
    let known = |number: u32| members.iter().any(|(m, _)| *m == number);
    let mut all: Vec<(u32, Place)> = members
        .iter()
        .map(|(number, place)| {
            (*number, if place.parent().is_some_and(known) { *place } else { Place::Alone })
        })
        .collect();
    all.sort_unstable_by_key(|(number, _)| *number);
    let mut sorted = Vec::with_capacity(all.len());
    family(&all, streams, &|place| place == Place::Alone, &mut sorted);
    // A member whose chain of parents is a circle has no place above it: it comes at the end, as created.
    let lost: Vec<u32> = all.iter().map(|(n, _)| *n).filter(|n| !sorted.contains(n)).collect();
    sorted.extend(lost);
    sorted
}

/// Appends the members at `here` along their streams, each between the members that run inside it.
fn family(all: &[(u32, Place)], streams: &[(u32, u32)], here: &dyn Fn(Place) -> bool, sorted: &mut Vec<u32>) {
    let mut left: Vec<u32> =
        all.iter().filter(|(_, place)| here(*place)).map(|(number, _)| *number).collect();
    // A stream between two members that run inside others orders those they run inside.
    let edges: Vec<(u32, u32)> = streams
        .iter()
        .filter_map(|(from, to)| Some((above(all, &left, *from)?, above(all, &left, *to)?)))
        .filter(|(from, to)| from != to)
        .collect();
    while !left.is_empty() {
        let ready = left
            .iter()
            .position(|m| !edges.iter().any(|(from, to)| to == m && left.contains(from)))
            .unwrap_or(0);
        let member = left.remove(ready);
        family(all, streams, &|place| place == Place::Before(member), sorted);
        sorted.push(member);
        family(all, streams, &|place| place == Place::After(member), sorted);
    }
}

/// The member of `level` that `member` is or runs inside of, directly or through others.
fn above(all: &[(u32, Place)], level: &[u32], member: u32) -> Option<u32> {
    let mut at = member;
    for _ in 0..=all.len() {
        if level.contains(&at) {
            return Some(at);
        }
        at = all.iter().find(|(number, _)| *number == at)?.1.parent()?;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::Place::{After, Alone, Before};
    use super::{Place, along};

    fn alone(numbers: &[u32]) -> Vec<(u32, Place)> {
        numbers.iter().map(|n| (*n, Alone)).collect()
    }

    #[test]
    fn consumers_follow_their_producers_whatever_the_order_of_creation() {
        assert_eq!(along(&alone(&[1, 2, 3, 4]), &[(1, 4), (4, 2), (2, 3)]), [1, 4, 2, 3]);
    }

    #[test]
    fn a_cycle_and_foreign_streams_leave_creation_order() {
        assert_eq!(along(&alone(&[2, 1]), &[(1, 2), (2, 1), (9, 1)]), [1, 2]);
    }

    #[test]
    fn what_runs_inside_stands_right_before_or_right_after_however_deep() {
        let members = [(1, Alone), (2, After(1)), (3, Before(1)), (4, Before(3)), (5, After(3)), (6, Alone)];
        assert_eq!(along(&members, &[]), [4, 3, 5, 1, 2, 6]);
    }

    #[test]
    fn several_inside_one_follow_their_streams_and_then_their_creation() {
        let members = [(1, Alone), (2, Before(1)), (3, Before(1)), (4, Before(1))];
        assert_eq!(along(&members, &[(4, 2)]), [3, 4, 2, 1]);
    }

    #[test]
    fn a_stream_between_two_that_run_inside_orders_those_around_them() {
        let members = [(1, Alone), (2, Before(1)), (3, Alone), (4, After(3))];
        assert_eq!(along(&members, &[(4, 2)]), [3, 4, 2, 1]);
    }

    #[test]
    fn a_member_whose_parent_is_gone_or_is_itself_still_appears_once() {
        assert_eq!(along(&[(1, Before(9)), (2, Before(2))], &[]), [1, 2]);
    }
}
