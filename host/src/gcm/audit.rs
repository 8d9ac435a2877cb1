//! The audit line: the caller, the request in its own JSON, and the result.
//!
//! Invariant: one line per request, bounded; it reads as what `Apply` would take, and never as a debug print.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;

use serde_json::{Map, Value};
use sha2::{Digest, Sha256};
use trocar_model::{ConnectOptions, Entry, Execution, PortId, Refusal, Request, Target, Which};

use super::Gcm;
use super::answer::{Answer, ExecuteOptions, Executed};
use super::journal::Asked;
use super::requests::Hash;
use crate::system_file::words::{spelled, spelled_options};

/// Longest request that is written whole, bytes.
const MOST: usize = 4096;

/// Writes the line of a request.
pub(super) fn write(asked: &Asked, answer: &Answer) {
    let outcome = match answer {
        Ok(done) => format!("revision {}", done.revision),
        Err(refusal) => refused(refusal),
    };
    log::info!(target: "audit", "{} asked {}: {outcome}", asked.identity, asked.text);
}

impl Gcm {
    /// Puts on record what somebody asked for that is no change of the system, and what became of it.
    pub fn put_on_record(&self, identity: &str, text: String, outcome: Result<(), &Refusal>) {
        let answer = outcome.map(|()| Executed::default()).map_err(Refusal::clone);
        let said = outcome.map_or_else(refused, |()| "done".to_owned());
        log::info!(target: "audit", "{identity} asked {text}: {said}");
        let asked = Asked { identity: identity.to_owned(), text, ..Asked::default() };
        self.inner.ledger.enter(|_| (Entry::Noted, Some((asked, answer))));
    }
}

/// Returns a request as it is put on record.
pub(super) fn asked_by(options: &ExecuteOptions, requests: &[Request]) -> Asked {
    let ExecuteOptions { identity, request_id, .. } = options;
    let hash = if request_id.is_empty() { Hash::default() } else { hash(requests) };
    Asked { identity: identity.clone(), request_id: request_id.clone(), hash, text: asked(requests) }
}

/// Returns the hash of requests in their own JSON; those that differ only in the order of keys are the same.
fn hash(requests: &[Request]) -> Hash {
    hash_of(|hashing| {
        // Neither the hash nor JSON of plain data fails.
        let _ = serde_json::to_writer(hashing, &requests.iter().map(request).collect::<Vec<_>>());
    })
}

/// Returns the hash of what is written.
pub(super) fn hash_of(write: impl FnOnce(&mut Hashing)) -> Hash {
    let mut hashing = Hashing(Sha256::new());
    write(&mut hashing);
    hashing.0.finalize().into()
}

pub(super) struct Hashing(Sha256);

impl io::Write for Hashing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn refused(refusal: &Refusal) -> String {
    format!("refused: {} {refusal}", refusal.reason())
}

/// Returns requests in their own JSON, cut where they are long.
pub(super) fn asked(requests: &[Request]) -> String {
    let mut text = Cut::default();
    let written = match requests {
        [one] => serde_json::to_writer(&mut text, &request(one)),
        all => serde_json::to_writer(&mut text, &all.iter().map(request).collect::<Vec<_>>()),
    };
    let mut text = text.into_string();
    if written.is_err() {
        text.push_str(&format!("… (more than {MOST} bytes)"));
    }
    text
}

/// The first [`MOST`] bytes: a request of some MB costs no more than the part that is shown.
#[derive(Default)]
struct Cut(Vec<u8>);

impl Cut {
    fn into_string(self) -> String {
        String::from_utf8(self.0).unwrap_or_else(|cut| {
            let whole = cut.utf8_error().valid_up_to();
            String::from_utf8_lossy(&cut.as_bytes()[..whole]).into_owned()
        })
    }
}

impl io::Write for Cut {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let fits = bytes.len().min(MOST - self.0.len());
        self.0.extend_from_slice(&bytes[..fits]);
        // Nothing fits any more: the writer ends here.
        Ok(fits)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The fields of a request, by their names; configurations can be large and are not copied.
type Body<'a> = BTreeMap<&'static str, Cow<'a, Value>>;

fn request(request: &Request) -> BTreeMap<&'static str, Body<'_>> {
    let (name, body) = match request {
        Request::Create { id, class, config, execution } => {
            ("create", create(id.to_string(), class, config.as_ref(), execution))
        }
        Request::CreateIsolated { id, home, class, config, execution } => {
            let mut body = create(format!("{home}/{}", id.component), class, config.as_ref(), execution);
            body.insert("isolation", own("process"));
            ("create", body)
        }
        Request::Remove { id, force } => {
            ("remove", Body::from([("path", own(id.to_string())), ("force", own(*force))]))
        }
        Request::Forget { process } => ("forget", Body::from([("process", own(process.as_str()))])),
        Request::Configure { id, patch, execution } => {
            let mut body = Body::from([("path", own(id.to_string())), ("config", Cow::Borrowed(patch))]);
            body.extend(execution.as_ref().and_then(settings).map(|set| ("execution", own(set))));
            ("configure", body)
        }
        Request::Start { targets } => ("start", paths(targets)),
        Request::Stop { targets } => ("stop", paths(targets)),
        Request::Resume { targets } => ("resume", paths(targets)),
        Request::Reset { targets } => ("reset", paths(targets)),
        Request::Connect { client, server, options } => {
            let mut body = pair(client, server);
            body.extend(wire_options(options).map(|options| ("options", own(options))));
            ("connect", body)
        }
        Request::Disconnect { which: Which::Id(id) } => ("disconnect", Body::from([("id", own(id.0))])),
        Request::Disconnect { which: Which::Pair { client, server } } => ("disconnect", pair(client, server)),
    };
    BTreeMap::from([(name, body)])
}

fn own<'a>(value: impl Into<Value>) -> Cow<'a, Value> {
    Cow::Owned(value.into())
}

fn create<'a>(path: String, class: &str, config: Option<&'a Value>, execution: &Execution) -> Body<'a> {
    let mut body = Body::from([("path", own(path)), ("class", own(class))]);
    body.extend(config.map(|config| ("config", Cow::Borrowed(config))));
    body.extend(settings(execution).map(|set| ("execution", own(set))));
    body
}

fn pair<'a>(client: &PortId, server: &PortId) -> Body<'a> {
    Body::from([("client", own(client.to_string())), ("server", own(server.to_string()))])
}

fn paths<'a>(targets: &[Target]) -> Body<'a> {
    let text = |target: &Target| match target {
        Target::One(id) => id.to_string(),
        Target::Glob(pattern) => pattern.to_string(),
    };
    Body::from([("paths", own(targets.iter().map(text).collect::<Vec<_>>()))])
}

/// Returns the settings by the names of the system file; `None` when all is left to the class.
fn settings(execution: &Execution) -> Option<Value> {
    object(spelled(execution))
}

/// The same of a connection, with the one option that no file has.
fn wire_options(options: &ConnectOptions) -> Option<Value> {
    let replace = ("replace", options.replace.then_some(Value::Bool(true)));
    object(spelled_options(options).into_iter().chain([replace]))
}

fn object(all: impl IntoIterator<Item = (&'static str, Option<Value>)>) -> Option<Value> {
    let set = all.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?)));
    let set: Map<String, Value> = set.collect();
    (!set.is_empty()).then_some(Value::Object(set))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use serde_json::json;
    use trocar_model::{ComponentId, Queue};

    use super::*;

    #[test]
    fn a_request_is_written_as_its_own_json() {
        let id = ComponentId::parse("host/robot").unwrap();
        let execution = Execution { period_ns: Some(500_000), catch_up: Some(2), ..Execution::default() };
        let class = "eyerobot".into();
        let create = Request::Create { id, class, config: Some(json!({"limit": 3})), execution };
        assert_eq!(
            asked(std::slice::from_ref(&create)),
            r#"{"create":{"class":"eyerobot","config":{"limit":3},"execution":{"catch_up":2,"period_us":500.0},"path":"host/robot"}}"#
        );
        let stop = Request::Stop { targets: vec![Target::parse("host/**").unwrap()] };
        assert_eq!(asked(std::slice::from_ref(&stop)), r#"{"stop":{"paths":["host/**"]}}"#);
        let connect = Request::Connect {
            client: PortId::parse("host/a/in").unwrap(),
            server: PortId::parse("host/b/out").unwrap(),
            options: ConnectOptions {
                queue: Some(Queue::Fifo { depth: 4, drop_oldest: true }),
                max_age_ns: Some(1_500_000),
                replace: true,
                ..ConnectOptions::default()
            },
        };
        let want = r#"{"connect":{"client":"host/a/in","options":{"max_age_ms":1.5,"queue":{"drop_oldest":true,"fifo":4},"replace":true},"server":"host/b/out"}}"#;
        assert_eq!(asked(std::slice::from_ref(&connect)), want);
        assert!(asked(&[stop, connect]).starts_with(r#"[{"stop""#), "several are a list");
    }

    #[test]
    fn a_request_without_end_is_cut() {
        let id = ComponentId::parse("host/robot").unwrap();
        let patch = json!({"text": "é".repeat(1 << 20)});
        let line = asked(&[Request::Configure { id, patch, execution: None }]);
        assert!(
            line.len() < MOST + 50 && line.ends_with("é… (more than 4096 bytes)"),
            "{} bytes",
            line.len()
        );
    }
}
