//! Answers kept by request id, so that a repeated request gets the same answer and is not done twice.
//!
//! Invariant: bounded in number and in age; one id is being carried out at most once, and never answered with what
//! became of another request.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use tokio::sync::watch;
use trocar_model::{Refusal, Request};

use super::execute::Executed;

const KEPT: usize = 4096;
const AGE: Duration = Duration::from_secs(600);

pub(super) type Answer = Result<Executed, Refusal>;

/// What is known of a request id.
pub(super) enum Known {
    /// Nothing: carry it out and put the answer here.
    New(watch::Sender<Option<Answer>>),
    /// It was asked before: the answer is here, or will be.
    Same(watch::Receiver<Option<Answer>>),
    /// The id stands for another request.
    Other,
}

struct Entry {
    at: Instant,
    id: String,
    requests: Vec<Request>,
    answer: watch::Receiver<Option<Answer>>,
}

impl Entry {
    /// Whoever carried it out is gone without an answer.
    fn given_up(&self) -> bool {
        self.answer.has_changed().is_err() && self.answer.borrow().is_none()
    }
}

#[derive(Default)]
pub(super) struct Answers {
    kept: VecDeque<Entry>,
}

impl Answers {
    /// Looks an id up and takes it if it is free, in one step.
    pub(super) fn ask(&mut self, id: &str, requests: &[Request], now: Instant) -> Known {
        while self.kept.front().is_some_and(|e| now.saturating_duration_since(e.at) > AGE) {
            self.kept.pop_front();
        }
        self.kept.retain(|e| !e.given_up());
        if let Some(entry) = self.kept.iter().find(|e| e.id == id) {
            return if entry.requests == requests { Known::Same(entry.answer.clone()) } else { Known::Other };
        }
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        let (tell, answer) = watch::channel(None);
        self.kept.push_back(Entry { at: now, id: id.to_owned(), requests: requests.to_vec(), answer });
        Known::New(tell)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use trocar_model::Target;

    use super::*;

    fn stop(path: &str) -> Vec<Request> {
        vec![Request::Stop { targets: vec![Target::parse(path).unwrap()] }]
    }

    #[test]
    fn an_answer_is_forgotten_after_ten_minutes() {
        let (mut answers, now) = (Answers::default(), Instant::now());
        let Known::New(tell) = answers.ask("a", &stop("host/robot"), now) else {
            panic!("nobody asked before")
        };
        tell.send_replace(Some(Ok(Executed::default())));
        assert!(
            matches!(answers.ask("a", &stop("host/robot"), now + AGE), Known::Same(_)),
            "forgotten too early"
        );
        let later = now + AGE + Duration::from_secs(1);
        assert!(matches!(answers.ask("a", &stop("host/robot"), later), Known::New(_)), "kept too long");
    }

    #[test]
    fn an_id_used_for_something_else_is_told_apart() {
        let (mut answers, now) = (Answers::default(), Instant::now());
        let Known::New(_tell) = answers.ask("a", &stop("host/robot"), now) else {
            panic!("nobody asked before")
        };
        assert!(matches!(answers.ask("a", &stop("host/other"), now), Known::Other));
    }

    #[test]
    fn an_id_whose_request_was_given_up_is_free_again() {
        let (mut answers, now) = (Answers::default(), Instant::now());
        drop(answers.ask("a", &stop("host/robot"), now));
        assert!(matches!(answers.ask("a", &stop("host/robot"), now), Known::New(_)));
    }

    #[test]
    fn the_number_of_answers_is_bounded() {
        let (mut answers, now) = (Answers::default(), Instant::now());
        let mut tells = Vec::new();
        for i in 0..KEPT + 10 {
            tells.push(answers.ask(&i.to_string(), &stop("host/robot"), now));
        }
        assert_eq!(answers.kept.len(), KEPT);
    }
}
