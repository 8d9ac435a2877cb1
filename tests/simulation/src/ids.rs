//! Requests with an id: what was asked under each, and what came of it.
//!
//! Invariant: of one id there is one record; the same request again is answered the same, and another one is
//! refused, also by a later manager. One that is not on record is gone with its manager.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use trocar::gcm::{Answer, Record};
use trocar_lcm_api::clock;
use trocar_model::{Entry, Refusal};

/// Time for which an id is known.
const KNOWN: Duration = Duration::from_secs(600);

/// Place of a request among all of its id.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turn {
    /// It is to be carried out.
    First,
    /// It is the same as the first, which was asked at that event.
    Same(u64),
    /// It is another one than the first.
    Other,
}

#[derive(Default)]
pub(super) struct Ids(BTreeMap<String, Known>);

struct Known {
    /// The request in words.
    asked: String,
    /// Event at which it was asked first.
    event: u64,
    at: Instant,
    /// Manager that knows it.
    manager: u64,
    /// Term and time of its record.
    record: Option<(u64, u64)>,
    answer: Option<String>,
}

impl Ids {
    /// Somebody asks a manager for something under an id.
    pub(super) fn asked(&mut self, id: &str, asked: String, manager: u64, event: u64) -> Turn {
        let known = self.0.get(id).filter(|known| clock::since(known.at) < KNOWN);
        match known.filter(|known| known.manager == manager || known.record.is_some()) {
            Some(known) if known.asked == asked => Turn::Same(known.event),
            Some(_) => Turn::Other,
            None => {
                let (at, record, answer) = (clock::now(), None, None);
                self.0.insert(id.into(), Known { asked, event, at, manager, record, answer });
                Turn::First
            }
        }
    }

    /// It was answered. Returns what is wrong.
    pub(super) fn answered(&mut self, id: &str, turn: Turn, answer: &Answer) -> Option<String> {
        if turn == Turn::Other {
            let is_refused =
                matches!(answer, Err(Refusal::ArgumentInvalid { field, .. }) if field == "request_id");
            return (!is_refused).then(|| format!("{id} stands for another request, and got {answer:?}"));
        }
        // It is still being carried out, and is waited for no longer.
        if matches!(answer, Err(Refusal::Busy { doing }) if doing == "the same request") {
            return None;
        }
        self.is_same(id, format!("{answer:?}"))
    }

    /// A record was written. Returns what is wrong.
    pub(super) fn on_record(&mut self, record: &Record) -> Option<String> {
        let (Some(asked), Some(answer)) = (&record.asked, &record.answer) else { return None };
        let (id, is) = (asked.request_id.as_str(), (record.term, record.monotonic_ns));
        // A Stop is carried out each time.
        if id.is_empty() || matches!(record.entry, Entry::Stopped { .. }) {
            return None;
        }
        let Some(known) = self.0.get_mut(id) else {
            return Some(format!("{id} is on record, and nobody has asked for it"));
        };
        let before = known.record.replace(is).filter(|before| *before != is);
        if before.is_some() && clock::since(known.at) < KNOWN {
            return Some(format!("{id} is on record twice, as {} and {answer:?}", known.answer.as_deref()?));
        }
        self.is_same(id, format!("{answer:?}"))
    }

    fn is_same(&mut self, id: &str, answer: String) -> Option<String> {
        let known = self.0.get_mut(id)?;
        let first = known.answer.get_or_insert_with(|| answer.clone());
        (*first != answer).then(|| format!("{id} was answered {first}, and then {answer}"))
    }
}
