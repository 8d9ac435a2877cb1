//! One input while it is recorded: which of its samples are kept, which were lost.
//!
//! Invariant: kept + left out + lost = sent by the source since the recording began, as far as its count
//! tells. Samples that were lost before, as far as the recording reaches back, are among the lost.

use std::collections::VecDeque;
use std::sync::Arc;

use trocar_sdk::{AnyView, RateLimit};

use crate::block::{HeldPart, LARGE};
use crate::encoder::{Encoder, Frame};
use crate::orders::{Channel, Codec, Missing};
use crate::seen::Seen;
use crate::way::Way;

/// Room for what encoding adds to the bytes of a frame.
const AROUND: usize = 512;
/// Frames of a topic that are held at once: their source fills them anew only afterwards.
const HELD_AT_ONCE: usize = 3;
/// Losses that are remembered with their times; of more, the oldest pass for newer ones.
const RECENT: usize = 64;

/// One input.
#[derive(Default)]
pub(crate) struct Topic {
    /// `/process/component/port`, or the input's own name as long as nothing is known.
    pub(crate) name: String,
    /// Which of them are kept: each n-th.
    pub(crate) every: u64,
    pub(crate) rate: RateLimit,
    pub(crate) kept: u64,
    pub(crate) left_out: u64,
    pub(crate) lost: u64,
    pub(crate) bytes: u64,
    /// Number of times its source went away.
    pub(crate) interrupted: u64,
    /// When it did last, ns.
    interrupted_ns: u64,
    /// Connection of the input, as far as was told.
    link: Option<Link>,
    /// The connection the last sample came by; 0 = none.
    source: u64,
    seq: u64,
    /// So many are left out before the next one of each n-th.
    to_skip: u64,
    /// When something was lost, ns, and how much.
    recent: VecDeque<(u64, u64)>,
    encoder: Option<Encoder>,
    /// One more for each frame that is held.
    held: Arc<()>,
}

/// Connection of an input, as the GCM tells it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Link {
    /// Number of the connection.
    pub(crate) id: u64,
    /// Number of the link to the source's process: another one each time they are linked; 0 if the source is
    /// in this process.
    pub(crate) epoch: u64,
    /// Term of the GCM that said so.
    pub(crate) term: u64,
}

/// Returns what is missing of these topics so far.
pub(crate) fn missing(each: &[Topic]) -> Missing {
    let those = |count: fn(&Topic) -> u64| {
        let all = each.iter().map(|topic| (topic.name.clone(), count(topic)));
        all.filter(|(_, n)| *n > 0).collect()
    };
    let silent = each.iter().filter(|topic| topic.is_silent()).map(|topic| topic.name.clone()).collect();
    Missing { lost: those(|topic| topic.lost), interrupted: those(|topic| topic.interrupted), silent }
}

impl Topic {
    pub(crate) fn is_known(&self, source: u64) -> bool {
        self.source == source && self.encoder.is_some()
    }

    /// Whether it is recorded, and has given nothing.
    pub(crate) fn is_silent(&self) -> bool {
        self.link.is_some() && self.kept + self.left_out + self.lost == 0
    }

    /// Forgets everything except its name and the thinning.
    pub(crate) fn forget(&mut self) {
        let name = std::mem::take(&mut self.name);
        *self = Topic { name, every: self.every, rate: self.rate, ..Topic::default() };
    }

    /// Begins the counts anew; losses and interruptions count from that time on.
    pub(crate) fn begin(&mut self, since_ns: u64) {
        (self.kept, self.left_out, self.bytes) = (0, 0, 0);
        self.interrupted = u64::from(self.interrupted_ns != 0 && self.interrupted_ns >= since_ns);
        self.to_skip = 0;
        self.rate.restart();
        self.recent.retain(|(when_ns, _)| *when_ns >= since_ns);
        self.lost = self.recent.iter().map(|(_, n)| n).sum();
    }

    fn lose(&mut self, n: u64, now_ns: u64) {
        if n == 0 {
            return;
        }
        self.lost += n;
        self.recent.push_back((now_ns, n));
        if self.recent.len() > RECENT
            && let (Some((_, older)), Some(oldest)) = (self.recent.pop_front(), self.recent.front_mut())
        {
            oldest.1 += older;
        }
    }

    /// Takes the connection as the GCM of this term says; none if it went away.
    pub(crate) fn link_is(&mut self, link: Option<Link>, term: u64, now_ns: u64) {
        let same = match (self.link, link) {
            (None, _) => true,
            (Some(old), Some(new)) => (old.id, old.epoch) == (new.id, new.epoch),
            // One that has just begun does not know yet who is there; samples come all the same.
            (Some(old), None) if old.term != term => return,
            (Some(_), None) => false,
        };
        self.link = link;
        if !same {
            self.interrupted += 1;
            self.interrupted_ns = now_ns;
        }
    }

    /// Takes the input as connected to nothing, as found here: a GCM may not have told yet.
    pub(crate) fn is_cut(&mut self, now_ns: u64) {
        let term = self.link.map_or(0, |link| link.term);
        self.link_is(None, term, now_ns);
    }

    /// Another name, so other channels.
    pub(crate) fn rename(&mut self, name: &str) {
        if self.name != name {
            self.name = name.to_owned();
            self.encoder = None;
        }
    }

    /// Handles another connection: finds out its type. `add` gives a channel its number.
    pub(crate) fn connected(
        &mut self,
        source: u64,
        description: &str,
        (codec, sample): (Codec, &Seen<'_>),
        add: &mut dyn FnMut(Channel) -> u32,
    ) {
        if self.source != source {
            self.seq = 0;
        }
        self.source = source;
        self.encoder = Encoder::of(description, &self.name, (codec, sample), add);
    }

    /// Looks at a sample that is not recorded, so that what came before a recording is no loss of it.
    pub(crate) fn pass(&mut self, seen: &Seen<'_>) {
        self.seq = seen.seq;
    }

    /// Keeps a sample, unless it is to be left out or there is no room.
    pub(crate) fn take(&mut self, seen: &Seen<'_>, now_ns: u64, way: &mut Way) {
        if self.seq != 0 && seen.seq > self.seq {
            self.lose(seen.seq - self.seq - 1, now_ns);
        }
        self.seq = seen.seq;
        let skip = self.to_skip > 0;
        self.to_skip = self.to_skip.saturating_sub(1);
        let stamp_ns = if seen.stamp_ns == 0 { now_ns } else { seen.stamp_ns };
        if !self.rate.is_due(stamp_ns) || skip {
            self.left_out += 1;
            return;
        }
        let Some(encoder) = &self.encoder else {
            self.lose(1, now_ns);
            return;
        };
        let around = 2 * seen.value.len() + AROUND;
        let mut fits = seen.value.len() == encoder.size() && way.has_room(around);
        let held =
            seen.holdable().filter(|_| fits && self.may_hold(seen.bytes.len())).and_then(AnyView::hold);
        let held = held.map(|frame| Arc::new(HeldPart::new(frame, self.held.clone())));
        fits &= held.is_some() || seen.bytes.is_empty() || way.has_room_for_frame(around + seen.bytes.len());
        let frame = Frame { bytes: seen.bytes, held };
        match fits.then(|| encoder.write(seen, &frame, (now_ns, stamp_ns), way)).flatten() {
            Some(bytes) => {
                self.kept += 1;
                self.bytes += bytes as u64;
                self.to_skip = self.every.saturating_sub(1);
                self.rate.keep(stamp_ns);
            }
            None => self.lose(1, now_ns),
        }
    }

    /// Whether a frame of so many bytes is to be held.
    fn may_hold(&self, len: usize) -> bool {
        // One count is its own.
        len >= LARGE && Arc::strong_count(&self.held) <= HELD_AT_ONCE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::way::way;

    const NUMBER: &str = r#"{"plain": "f64"}"#;

    /// All of it is kept.
    fn whole() -> Topic {
        Topic { every: 1, ..Topic::default() }
    }

    /// Returns the fate of samples with these numbers and stamps: kept, left out, lost.
    fn taken(mut topic: Topic, samples: &[(u64, u64)]) -> (u64, u64, u64) {
        let (mut way, _received, _) = way(1 << 20);
        let value = 1f64.to_le_bytes();
        for (seq, stamp_ns) in samples.iter().copied() {
            let seen = Seen::plain(&value, stamp_ns, seq);
            if !topic.is_known(1) {
                topic.connected(1, NUMBER, (Codec::Raw, &seen), &mut |_| 0);
            }
            topic.take(&seen, 1, &mut way);
        }
        (topic.kept, topic.left_out, topic.lost)
    }

    #[test]
    fn what_is_not_thinned_is_kept_whatever_its_stamps() {
        let falling = [(1, 900), (2, 100), (3, 100), (4, 50), (5, 1000)];
        assert_eq!(taken(whole(), &falling), (5, 0, 0));
    }

    #[test]
    fn of_many_each_nth_is_kept_and_the_others_are_left_out_and_not_lost() {
        let all: Vec<(u64, u64)> = (1..=100).map(|n| (n, n * 10)).collect();
        assert_eq!(taken(Topic { every: 10, ..whole() }, &all), (10, 90, 0));
        assert_eq!(taken(Topic { rate: RateLimit::every(200), ..whole() }, &all), (5, 95, 0));
    }

    #[test]
    fn a_stamp_far_ahead_silences_nobody() {
        let jumps = [(1, 10), (2, 1_000_000), (3, 30), (4, 40), (5, 240)];
        assert_eq!(taken(Topic { rate: RateLimit::every(200), ..whole() }, &jumps), (4, 1, 0));
    }

    #[test]
    fn numbers_that_never_came_are_lost() {
        assert_eq!(taken(whole(), &[(3, 1), (4, 2), (9, 3)]), (3, 0, 4));
    }

    #[test]
    fn what_was_lost_before_a_recording_counts_as_far_as_that_reaches_back() {
        let mut topic = whole();
        topic.lose(3, 100);
        topic.lose(4, 200);
        topic.begin(150);
        assert_eq!(topic.lost, 4);
        topic.lose(1, 300);
        topic.begin(400);
        assert_eq!(topic.lost, 0, "the next one begins behind it");
        (0..10 * RECENT as u64).for_each(|n| topic.lose(1, n));
        topic.begin(0);
        assert_eq!((topic.lost, topic.recent.len()), (10 * RECENT as u64, RECENT), "none is forgotten");
    }

    #[test]
    fn what_it_was_connected_to_and_is_not_any_more_interrupts_it() {
        let mut topic = whole();
        let told = |topic: &mut Topic, link: Option<(u64, u64)>, term, now_ns| {
            topic.link_is(link.map(|(id, epoch)| Link { id, epoch, term }), term, now_ns);
            topic.interrupted
        };
        assert_eq!(told(&mut topic, None, 1, 10), 0, "it was never connected");
        assert_eq!(told(&mut topic, Some((1, 1)), 1, 20), 0);
        assert_eq!(told(&mut topic, Some((1, 1)), 1, 30), 0, "it stays connected");
        assert_eq!(told(&mut topic, None, 1, 40), 1, "it was cut");
        assert_eq!(told(&mut topic, None, 1, 50), 1, "once");
        assert_eq!(told(&mut topic, Some((2, 1)), 1, 60), 1, "it is connected again");
        assert_eq!(told(&mut topic, Some((2, 2)), 1, 70), 2, "it is linked anew");
        assert_eq!(told(&mut topic, None, 2, 80), 2, "another GCM does not know it yet");
        assert_eq!(told(&mut topic, Some((2, 2)), 2, 90), 2, "and then does");
        topic.is_cut(100);
        topic.is_cut(100);
        assert_eq!(told(&mut topic, None, 2, 110), 3, "it was found cut before that was told");
        topic.begin(95);
        assert_eq!(topic.interrupted, 1, "this recording reaches back behind that");
        topic.begin(120);
        assert_eq!(topic.interrupted, 0, "this one does not");
    }

    #[test]
    fn what_is_connected_and_gave_nothing_is_silent() {
        let mut topic = whole();
        topic.begin(0);
        assert!(!topic.is_silent(), "it is connected to nothing");
        topic.link_is(Some(Link { id: 1, epoch: 0, term: 1 }), 1, 10);
        assert!(topic.is_silent());
        topic.lose(1, 20);
        assert!(!topic.is_silent(), "it gave something, which was lost");
    }

    #[test]
    fn few_frames_are_held_at_once_and_small_ones_are_not() {
        let topic = whole();
        assert!(topic.may_hold(LARGE) && !topic.may_hold(LARGE - 1));
        let mut held: Vec<Arc<()>> = (1..HELD_AT_ONCE).map(|_| topic.held.clone()).collect();
        assert!(topic.may_hold(LARGE), "one more");
        held.push(topic.held.clone());
        assert!(!topic.may_hold(LARGE), "{HELD_AT_ONCE} are held");
        held.pop();
        assert!(topic.may_hold(LARGE), "one was written");
    }
}
