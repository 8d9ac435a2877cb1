//! Answers kept by request id, so that a repeated request gets the same answer and is not done twice.
//!
//! Invariant: bounded in number and in age.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use trocar_model::Refusal;

use super::manager::Executed;

const KEPT: usize = 4096;
const AGE: Duration = Duration::from_secs(600);

#[derive(Default)]
pub(super) struct Answers {
    kept: VecDeque<(Instant, String, Result<Executed, Refusal>)>,
}

impl Answers {
    pub(super) fn get(&mut self, id: &str) -> Option<Result<Executed, Refusal>> {
        while self.kept.front().is_some_and(|(at, ..)| at.elapsed() > AGE) {
            self.kept.pop_front();
        }
        self.kept.iter().find(|(_, known, _)| known == id).map(|(.., answer)| answer.clone())
    }

    pub(super) fn put(&mut self, id: String, answer: Result<Executed, Refusal>) {
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back((Instant::now(), id, answer));
    }
}
