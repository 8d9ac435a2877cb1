//! The right of a GCM to decide, where several could.
//!
//! Invariant: it holds only as long as it was confirmed for, by the clock, whoever runs late; once lost it
//! never comes back. A new one has a greater term.

use std::fmt;
use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;
use tokio::sync::watch;
use trocar_lcm_api::clock;
use trocar_model::Refusal;

/// A handle; clones share one right.
#[derive(Clone)]
pub struct Lead {
    term: u64,
    state: Arc<watch::Sender<State>>,
    doubt: Arc<Mutex<String>>,
}

#[derive(Clone)]
enum State {
    Until(Instant),
    Lost(String),
}

impl fmt::Debug for Lead {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Lead in term {}", self.term)
    }
}

impl Lead {
    /// The lead in a term that no other GCM has, confirmed until then.
    pub fn new(term: u64, until: Instant) -> Lead {
        Lead { term, state: Arc::new(watch::Sender::new(State::Until(until))), doubt: Arc::default() }
    }

    /// Returns its term.
    pub fn term(&self) -> u64 {
        self.term
    }

    /// Confirms it until a later moment.
    pub fn confirm(&self, until: Instant) {
        self.state.send_modify(|state| {
            if let State::Until(before) = state {
                *before = until.max(*before);
            }
        });
        self.doubt.lock().clear();
    }

    /// Notes why it could not be confirmed.
    pub fn doubt(&self, why: &str) {
        why.clone_into(&mut self.doubt.lock());
    }

    /// Ends it for good.
    pub fn lose(&self, why: &str) {
        self.state.send_if_modified(|state| {
            let is_news = matches!(state, State::Until(_));
            if is_news {
                *state = State::Lost(why.to_owned());
            }
            is_news
        });
    }

    /// Waits until it is lost for good; returns the reason.
    pub async fn lost(&self) -> String {
        let mut state = self.state.subscribe();
        // The sender lives as long as this.
        let _ = state.wait_for(|state| matches!(state, State::Lost(_))).await;
        match &*self.state.borrow() {
            State::Lost(why) => why.clone(),
            State::Until(_) => String::new(),
        }
    }

    /// # Errors
    /// NOT_LEADER: it is lost, or was not confirmed in time, so that another GCM may lead.
    pub fn holds(&self) -> Result<(), Refusal> {
        let why = match &*self.state.borrow() {
            State::Until(until) if clock::now() < *until => return Ok(()),
            State::Until(_) => {
                let doubt = self.doubt.lock();
                let why = if doubt.is_empty() { "it was not confirmed in time" } else { doubt.as_str() };
                format!("its lead is in doubt, and another GCM may lead: {why}")
            }
            State::Lost(why) => format!("it has lost the lead: {why}"),
        };
        Err(Refusal::NotLeader { leader: String::new(), why })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::time::Duration;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_lead_holds_as_long_as_it_was_confirmed_for() {
        let lead = Lead::new(3, clock::now() + Duration::from_secs(1));
        lead.holds().unwrap();
        tokio::time::advance(Duration::from_secs(2)).await;
        lead.doubt("nobody answers");
        let refused = lead.holds().unwrap_err();
        assert_eq!(refused.reason(), "NOT_LEADER");
        assert!(refused.to_string().contains("nobody answers"), "{refused}");
        lead.confirm(clock::now() + Duration::from_secs(1));
        lead.holds().unwrap();
        lead.confirm(clock::now());
        lead.holds().expect("it was confirmed for longer");
    }

    #[tokio::test(start_paused = true)]
    async fn a_lead_that_is_lost_never_comes_back() {
        let lead = Lead::new(3, clock::now() + Duration::from_secs(9));
        lead.lose("another GCM has taken it");
        lead.lose("something else");
        lead.confirm(clock::now() + Duration::from_secs(9));
        assert_eq!(lead.lost().await, "another GCM has taken it");
        assert!(lead.holds().unwrap_err().to_string().contains("another GCM has taken it"));
    }
}
