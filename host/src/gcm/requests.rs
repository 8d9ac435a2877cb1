//! Answers kept by request id, so that a repeated request gets the same answer and is not done twice.
//!
//! Invariant: bounded in number, in bytes and in age; one id is being carried out at most once, and never
//! answered with the result of another request. A request is remembered by its hash, not by its words.

use std::collections::VecDeque;
use std::fmt::{self, Debug, Write};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::answer::Answer;
use super::journal::{Asked, Remembered};
use super::ledger::{at, wall_ns};

const KEPT: usize = 4096;
/// Bytes that all answers together may take, about.
const BYTES: usize = 64 << 20;
const AGE: Duration = Duration::from_secs(600);

/// State of a request id.
pub(super) enum Known {
    /// Nothing: carry it out, put the answer here, and say so to [`Answers::given`].
    New(watch::Sender<Option<Answer>>),
    /// The request was asked before: the answer is here, or will be.
    Same(watch::Receiver<Option<Answer>>),
    /// The id stands for another request.
    Other,
}

#[derive(Clone)]
struct Entry {
    at: Instant,
    /// The same by the time of day, ns since 1970 (UTC).
    wall_ns: u64,
    id: String,
    asked: Hash,
    /// Bytes of id and answer, as far as it is there.
    bytes: usize,
    answer: watch::Receiver<Option<Answer>>,
}

impl Entry {
    /// Tells whether the task that carried out the request ended without an answer.
    fn given_up(&self) -> bool {
        self.answer.has_changed().is_err() && self.answer.borrow().is_none()
    }
}

#[derive(Clone, Default)]
pub(super) struct Answers {
    kept: VecDeque<Entry>,
    bytes: usize,
}

impl Answers {
    /// Puts in an answer that was given at some time, in place of an earlier one of that id.
    pub(super) fn put(&mut self, Remembered { wall_ns, asked, answer }: Remembered) {
        let bytes = asked.request_id.len() + length(&answer);
        let (id, hash, at) = (asked.request_id, asked.hash, at(wall_ns));
        self.kept.retain(|e| e.id != id);
        let answer = watch::channel(Some(answer)).1;
        self.kept.push_back(Entry { at, wall_ns, id, asked: hash, bytes, answer });
        self.bytes = self.kept.iter().map(|e| e.bytes).sum();
        self.bound();
    }

    /// Returns the answers that were given, for the GCM after this one.
    pub(super) fn remembered(&self) -> Vec<Remembered> {
        let given = self.kept.iter().filter_map(|entry| {
            let answer = entry.answer.borrow().clone()?;
            let asked = Asked { request_id: entry.id.clone(), hash: entry.asked, ..Asked::default() };
            Some(Remembered { wall_ns: entry.wall_ns, asked, answer })
        });
        given.collect()
    }

    /// Looks an id up and takes it if it is free, in one step. `asked`: hash of the request.
    pub(super) fn ask(&mut self, id: &str, asked: Hash, now: Instant) -> Known {
        self.kept.retain(|e| !e.given_up() && now.saturating_duration_since(e.at) <= AGE);
        self.bytes = self.kept.iter().map(|e| e.bytes).sum();
        if let Some(entry) = self.kept.iter().find(|e| e.id == id) {
            return if entry.asked == asked { Known::Same(entry.answer.clone()) } else { Known::Other };
        }
        let (tell, answer) = watch::channel(None);
        self.bytes += id.len();
        let (id, bytes, wall_ns) = (id.to_owned(), id.len(), wall_ns());
        self.kept.push_back(Entry { at: now, wall_ns, id, asked, bytes, answer });
        self.bound();
        Known::New(tell)
    }

    /// The answer to `id` has been told: it counts from now on.
    pub(super) fn given(&mut self, id: &str, answer: &Answer) {
        let Some(entry) = self.kept.iter_mut().rfind(|e| e.id == id) else { return };
        let bytes = length(answer);
        entry.bytes += bytes;
        self.bytes += bytes;
        self.bound();
    }

    /// Forgets the oldest, but never the newest.
    fn bound(&mut self) {
        while (self.kept.len() > KEPT || self.bytes > BYTES) && self.kept.len() > 1 {
            self.bytes -= self.kept.pop_front().map_or(0, |oldest| oldest.bytes);
        }
    }
}

/// SHA-256 of a request in its own JSON, whose keys are sorted.
pub(super) type Hash = [u8; 32];

/// About as many bytes as an answer takes.
fn length(answer: &Answer) -> usize {
    struct Counting(usize);
    impl Write for Counting {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            self.0 += text.len();
            Ok(())
        }
    }
    let mut counting = Counting(0);
    let mut count = |part: &dyn Debug| {
        let _ = write!(counting, "{part:?}");
    };
    match answer {
        Ok(done) => {
            count(&done.plan.changes);
            count(&done.reports);
        }
        Err(refusal) => count(refusal),
    }
    counting.0
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use trocar_model::Refusal;

    use super::super::Executed;
    use super::*;

    /// Hash of a request.
    fn of(path: &str) -> Hash {
        let mut hash = Hash::default();
        let most = hash.len().min(path.len());
        hash[..most].copy_from_slice(&path.as_bytes()[..most]);
        hash
    }

    #[test]
    fn an_answer_is_forgotten_after_ten_minutes() {
        let (mut answers, now) = (Answers::default(), Instant::now());
        let Known::New(tell) = answers.ask("a", of("host/robot"), now) else { panic!("nobody asked before") };
        tell.send_replace(Some(Ok(Executed::default())));
        assert!(
            matches!(answers.ask("a", of("host/robot"), now + AGE), Known::Same(_)),
            "forgotten too early"
        );
        let later = now + AGE + Duration::from_secs(1);
        assert!(matches!(answers.ask("a", of("host/robot"), later), Known::New(_)), "kept too long");
    }

    #[test]
    fn an_id_used_for_something_else_is_told_apart() {
        let (mut answers, now) = (Answers::default(), Instant::now());
        let Known::New(_tell) = answers.ask("a", of("host/robot"), now) else {
            panic!("nobody asked before")
        };
        assert!(matches!(answers.ask("a", of("host/other"), now), Known::Other));
    }

    #[test]
    fn an_id_whose_request_was_given_up_is_free_again() {
        let (mut answers, now) = (Answers::default(), Instant::now());
        drop(answers.ask("a", of("host/robot"), now));
        assert!(matches!(answers.ask("a", of("host/robot"), now), Known::New(_)));
    }

    #[test]
    fn big_requests_and_big_answers_take_no_more_than_their_share() {
        let (mut answers, now) = (Answers::default(), Instant::now());
        let text = "x".repeat(BYTES / 16);
        for i in 0..40 {
            let id = i.to_string();
            let Known::New(tell) = answers.ask(&id, of(&format!("host/n{i}")), now) else {
                panic!("nobody asked before")
            };
            let answer = Err(Refusal::Internal { text: text.clone() });
            tell.send_replace(Some(answer.clone()));
            answers.given(&id, &answer);
            assert!(answers.bytes <= BYTES, "{} bytes after {i}", answers.bytes);
        }
        assert!((10..=16).contains(&answers.kept.len()), "{} are kept", answers.kept.len());
        assert!(matches!(answers.ask("39", of("host/n39"), now), Known::Same(_)), "the newest is kept");
        let late = now + AGE + Duration::from_secs(1);
        assert!(matches!(answers.ask("new", of("host/new"), late), Known::New(_)));
        assert_eq!(answers.bytes, "new".len(), "what is forgotten counts no more");
    }

    #[test]
    fn the_number_of_answers_is_bounded() {
        let (mut answers, now) = (Answers::default(), Instant::now());
        let mut tells = Vec::new();
        for i in 0..KEPT + 10 {
            tells.push(answers.ask(&i.to_string(), of("host/robot"), now));
        }
        assert_eq!(answers.kept.len(), KEPT);
    }
}
