//! Puts on record which commands were asked of actuators from outside.
//!
//! Invariant: the first of each caller and command is on record at once; more of the same within a second are
//! one record with their number, so that a stream of commands does not drive the others out.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use trocar_model::{Refusal, Safety};
use trocar_proto::v1;

use super::{Edge, part};
use crate::control::convert;
use crate::gcm::Gcm;

/// Time for which more of the same is only counted.
const TOGETHER: Duration = Duration::from_secs(1);
/// Longest argument that is put on record whole, bytes.
const LONGEST: usize = 4096;
/// Most callers and commands that are counted apart.
const MOST: usize = 1024;

/// Caller and path of a command.
type Key = (String, String);

/// Commands that were asked again, within the last second each.
#[derive(Clone, Default)]
pub(crate) struct Commanded(Arc<Mutex<BTreeMap<Key, u64>>>);

impl Commanded {
    /// Counts a command; true: it is the first of its kind, and ends to be counted with `ended`.
    fn is_first(&self, key: &Key) -> bool {
        let mut counted = self.0.lock();
        if let Some(more) = counted.get_mut(key) {
            *more += 1;
            return false;
        }
        // Each is a record of its own, when there are too many to count.
        if counted.len() < MOST {
            counted.insert(key.clone(), 0);
        }
        true
    }

    /// Returns how many more there were.
    fn ended(&self, key: &Key) -> u64 {
        self.0.lock().remove(key).unwrap_or_default()
    }
}

impl Edge {
    /// Calls a command; one that moves something is on record.
    pub(super) async fn invoked(
        &self,
        who: String,
        request: v1::InvokeRequest,
        until: Instant,
    ) -> Result<v1::InvokeResponse, Refusal> {
        let (path, moves) = (request.path.clone(), self.moves(&request));
        let answer = self.call(request, until).await;
        if let Some(text) = moves {
            self.commanded(who, &path, text, answer.as_ref().map(|_| ()));
        }
        answer
    }

    /// Returns how a command is put on record; `None`: it moves nothing.
    fn moves(&self, request: &v1::InvokeRequest) -> Option<String> {
        let graph = self.gcm.as_ref()?.graph();
        let (id, port, member) = part::split(&request.path).ok()?;
        let component = graph.components.get(&id).filter(|c| c.class.safety == Safety::Actuator)?;
        let found = part::narrow(&component.ports, &id, port.as_ref(), member.as_ref()).ok()?;
        let reads = found.provided.iter().flat_map(|p| &p.commands).all(|c| c.kind.is_read());
        if reads {
            return None;
        }
        let value = request.json.clone().map(convert::from_value);
        let arg = value.map(|value| format!(",\"json\":{}", cut(value.to_string()))).unwrap_or_default();
        let arg = if request.encoded.is_empty() { arg } else { ",\"encoded\":\"…\"".into() };
        Some(format!("{{\"invoke\":{{\"path\":\"{}\"{arg}}}}}", request.path))
    }

    /// Puts a command on record that was called.
    fn commanded(&self, who: String, path: &str, text: String, outcome: Result<(), &Refusal>) {
        let Some(gcm) = &self.gcm else { return };
        // One program may dial anew for each command.
        let user = who.split_once(" at ").or(who.split_once(" by ")).map_or(&*who, |(user, _)| user);
        let (commanded, key) = (self.commanded.clone(), (user.to_owned(), path.to_owned()));
        if !commanded.is_first(&key) {
            return;
        }
        gcm.put_on_record(&who, text, outcome);
        let gcm = gcm.clone();
        tokio::spawn(async move {
            tokio::time::sleep(TOGETHER).await;
            more(&gcm, &commanded, &key);
        });
    }
}

/// The beginning of a long argument.
fn cut(mut arg: String) -> String {
    if arg.len() > LONGEST {
        arg.truncate(arg.floor_char_boundary(LONGEST));
        arg.push('…');
    }
    arg
}

fn more(gcm: &Gcm, commanded: &Commanded, key: &Key) {
    let more = commanded.ended(key);
    if more > 0 {
        let text = format!("{{\"invoke\":{{\"path\":\"{}\"}}}} {more} more times within a second", key.1);
        gcm.put_on_record(&key.0, text, Ok(()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_again_within_a_second_is_counted() {
        let (commanded, key) = (Commanded::default(), ("user 0".to_owned(), "host/arm/ctl/move".to_owned()));
        let other = ("user 1".to_owned(), key.1.clone());
        assert!(commanded.is_first(&key) && commanded.is_first(&other));
        assert!((0..500).all(|_| !commanded.is_first(&key)));
        assert_eq!((commanded.ended(&key), commanded.ended(&other)), (500, 0));
        assert!(commanded.is_first(&key), "it is counted anew");
        let many = |n: usize| (format!("user {n}"), key.1.clone());
        assert!((2..2 * MOST).all(|n| commanded.is_first(&many(n))), "each is on record");
        assert!(commanded.0.lock().len() <= MOST);
    }
}
