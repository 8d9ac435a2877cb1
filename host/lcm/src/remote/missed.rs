//! Samples of an output that no link of a connection was offered, counted exactly by their numbers.
//!
//! Invariant: an output numbers each of its writes, and a link is offered all of them, one after the other,
//! from its first to its last. So the samples between the last of one link and the first of the next were
//! lost, whenever exactly either link was cut or wired up.

use super::server::Offered;

/// Count over all links of one connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Missed {
    /// The last sample that was offered, or written before the first link; `None`: it was never linked.
    last: Option<u64>,
    /// Lost between links that have ended.
    lost: u64,
}

impl Missed {
    /// Lost until now; `now`: offered to the present link, if there is one.
    pub(super) fn so_far(&self, now: Option<Offered>) -> u64 {
        let Some((last, now)) = self.last.zip(now) else { return self.lost };
        // Nothing was offered yet: the samples written so far will not be.
        let next = if now.first > 0 { now.first } else { now.written + 1 };
        self.lost + next.saturating_sub(last + 1)
    }

    /// Notes the end of a link that was offered these samples. Samples that a cycle under way still offers to
    /// it lie before the first of the next one.
    pub(super) fn ended(&mut self, link: Offered) {
        if link.first == 0 {
            self.last.get_or_insert(link.written);
            return;
        }
        self.lost = self.so_far(Some(link));
        self.last = Some(link.first + link.count - 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offered(first: u64, count: u64, written: u64) -> Offered {
        Offered { first, count, written }
    }

    #[test]
    fn what_was_written_before_the_first_link_is_not_lost() {
        let mut missed = Missed::default();
        assert_eq!((missed.so_far(None), missed.so_far(Some(offered(41, 1, 41)))), (0, 0));
        missed.ended(offered(41, 10, 50));
        assert_eq!(missed.so_far(None), 0);
    }

    #[test]
    fn what_lies_between_two_links_is_lost_whenever_it_is_asked_for() {
        let mut missed = Missed::default();
        missed.ended(offered(1, 10, 10));
        assert_eq!(missed.so_far(Some(offered(0, 0, 10))), 0, "nothing was written meanwhile");
        assert_eq!(missed.so_far(Some(offered(0, 0, 13))), 3, "three were, and none was offered");
        assert_eq!(missed.so_far(Some(offered(13, 0, 13))), 2, "the third is just being offered");
        assert_eq!(missed.so_far(Some(offered(13, 5, 17))), 2);
        missed.ended(offered(13, 5, 17));
        assert_eq!(missed.so_far(Some(offered(18, 1, 18))), 2, "the next link went on at once");
    }

    #[test]
    fn a_sample_that_was_offered_to_a_link_while_it_was_cut_is_lost_once() {
        let mut missed = Missed::default();
        missed.ended(offered(1, 10, 10));
        // The number of its first sample was noted, but the sample was counted too late.
        missed.ended(offered(11, 0, 10));
        assert_eq!(missed.so_far(Some(offered(12, 1, 12))), 1);
    }

    #[test]
    fn a_link_that_was_offered_nothing_changes_nothing() {
        let mut missed = Missed::default();
        missed.ended(offered(0, 0, 7));
        assert_eq!(missed.so_far(Some(offered(10, 1, 10))), 2, "8 and 9 came after it was linked first");
        missed.ended(offered(10, 1, 10));
        missed.ended(offered(0, 0, 12));
        assert_eq!(missed.so_far(Some(offered(14, 3, 16))), 2 + 3);
    }
}
