//! A fake system that answers the services of a component as the test says.
//!
//! Invariant: one answer for each verb; a verb without one is answered by that of "", or stays open.

use serde_json::{Value as Json, json};

/// Response to a request, or the reason of its refusal.
pub(crate) type Answer = dyn FnMut(&Json) -> Result<Json, String>;

/// The answers by verb; "" answers any other verb.
#[derive(Default)]
pub(crate) struct FakeSystem(Vec<(String, Box<Answer>)>);

impl FakeSystem {
    /// Tells whether there is any answer.
    pub(crate) fn answers(&self) -> bool {
        !self.0.is_empty()
    }

    /// Answers `verb` with `answer` from now on.
    pub(crate) fn answer_with(&mut self, verb: &str, answer: Box<Answer>) {
        self.0.retain(|(known, _)| known != verb);
        self.0.push((verb.to_string(), answer));
    }

    /// Returns the reply to a request; none when there is no answer for its verb.
    pub(crate) fn answer(&mut self, request: &Json) -> Option<Json> {
        let verb = request["verb"].as_str().unwrap_or_default();
        let named = self.0.iter().position(|(known, _)| known == verb);
        let at = named.or_else(|| self.0.iter().position(|(known, _)| known.is_empty()))?;
        Some(match (self.0[at].1)(request) {
            Ok(response) => json!({ "ok": true, "response": response }),
            Err(message) => json!({ "ok": false, "reason": "REFUSED", "message": message }),
        })
    }
}
