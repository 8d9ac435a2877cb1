//! The order in which components of one thread are stepped: along their streams, else as they were created.
//!
//! Invariant: pure; every member appears once; a cycle keeps creation order, so it costs one cycle of delay and no more.

/// `members` in creation order; `streams` are (producer, consumer), others than members are ignored.
pub(super) fn along(members: &[u32], streams: &[(u32, u32)]) -> Vec<u32> {
    let mut left = members.to_vec();
    left.sort_unstable();
    let mut sorted = Vec::with_capacity(left.len());
    while !left.is_empty() {
        let ready = left
            .iter()
            .position(|m| !streams.iter().any(|(from, to)| to == m && from != m && left.contains(from)))
            .unwrap_or(0);
        sorted.push(left.remove(ready));
    }
    sorted
}

#[cfg(test)]
mod tests {
    use super::along;

    #[test]
    fn consumers_follow_their_producers_whatever_the_order_of_creation() {
        assert_eq!(along(&[1, 2, 3, 4], &[(1, 4), (4, 2), (2, 3)]), [1, 4, 2, 3]);
    }

    #[test]
    fn a_cycle_and_foreign_streams_leave_creation_order() {
        assert_eq!(along(&[2, 1], &[(1, 2), (2, 1), (9, 1)]), [1, 2]);
    }
}
