//! Dynamic component services: the component's requests, and the replies to them.
//!
//! Invariant: replies are delivered between entries, never from within one, as a host does.

use super::bench::{Bench, Done, Failure, Life};
use crate::class::Class;
use serde_json::Value as Json;
use std::sync::PoisonError;
use trocar_plugin_api::abi::{self, Bytes};

/// Most rounds of replies that lead to further services.
const MAX_ROUNDS: usize = 100;

impl<C: Class> Bench<C> {
    /// Services asked for since the last asking, and not answered by `answer_service`: token and JSON.
    pub fn services(&mut self) -> Vec<(u64, String)> {
        std::mem::take(&mut self.host.services.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Lets a fake system answer the services of one verb ("" for every other) with the response, or with the
    /// reason of a refusal. The reply is delivered when the entry that asked is over; the reply to a device's
    /// callback, after the next entry.
    pub fn answer_service(&mut self, verb: &str, f: impl FnMut(&Json) -> Result<Json, String> + 'static) {
        self.system.answer_with(verb, Box::new(f));
        self.reply_all();
    }

    /// Answers one service by its token.
    ///
    /// # Errors
    /// The component refused the reply, or is in FAULT and gets none.
    pub fn reply(&mut self, token: u64, reply: &str) -> Done {
        let (f, bytes) = (self.table.on_service, Bytes { ptr: reply.as_ptr(), len: reply.len() });
        self.history.note(self.now().ns(), format!("reply {reply}"));
        if self.life() == Life::Fault {
            let reason = "the component is in FAULT: a host hands it no reply".to_string();
            return Err(Failure { status: abi::STATUS_FAILED, reason });
        }
        // SAFETY: a live instance; the text lives through the call.
        let done = self.enter(|this, _| f.map_or(abi::STATUS_OK, |f| unsafe { f(this, token, bytes) }));
        self.survived("on_service", done)
    }

    /// Answers the requests that the fake system can answer; a reply may lead to more requests.
    #[track_caller]
    pub(crate) fn reply_all(&mut self) {
        if !self.system.answers() || self.life() == Life::Fault {
            return;
        }
        for _ in 0..MAX_ROUNDS {
            let asked = self.services();
            let mut open = Vec::new();
            let mut answered = false;
            for (token, request) in asked {
                let json: Json = serde_json::from_str(&request).unwrap_or_default();
                let Some(reply) = self.system.answer(&json) else {
                    open.push((token, request));
                    continue;
                };
                if let Err(e) = self.reply(token, &reply.to_string()) {
                    panic!("the component refused the reply to {request}: {e}");
                }
                answered = true;
            }
            self.host.services.lock().unwrap_or_else(PoisonError::into_inner).extend(open);
            if !answered {
                return;
            }
        }
        panic!("after {MAX_ROUNDS} rounds of replies the component still asks for services");
    }
}
