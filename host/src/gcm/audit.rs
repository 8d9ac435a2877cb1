//! The audit line: who asked for what, in the request's own JSON, and what came of it.
//!
//! Invariant: one line per request, bounded; it reads as what `Apply` would take, and never as a debug print.

use serde_json::{Map, Value, json};
use trocar_model::{ConnectOptions, Execution, Queue, Refusal, Request, Target, Which};

use super::requests::Answer;
use crate::system_file::words::spelled;

/// Longest request that is written whole, bytes.
const MOST: usize = 4096;

pub(super) fn write(identity: &str, requests: &[Request], answer: &Answer) {
    let outcome = match answer {
        Ok(done) => format!("revision {}", done.revision),
        Err(refusal) => refused(refusal),
    };
    log::info!(target: "audit", "{identity} asked {}: {outcome}", asked(requests));
}

fn refused(refusal: &Refusal) -> String {
    format!("refused: {} {refusal}", refusal.reason())
}

fn asked(requests: &[Request]) -> String {
    let mut text = match requests {
        [one] => request(one).to_string(),
        all => Value::Array(all.iter().map(request).collect()).to_string(),
    };
    if text.len() > MOST {
        let (whole, mut end) = (text.len(), MOST);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        text.truncate(end);
        text.push_str(&format!("… ({whole} bytes)"));
    }
    text
}

fn request(request: &Request) -> Value {
    match request {
        Request::Create { id, class, config, execution } => {
            let body = create(id.to_string(), class, config.as_ref(), execution);
            json!({ "create": body })
        }
        Request::CreateApart { id, home, class, config, execution } => {
            let path = format!("{home}/{}", id.component);
            let mut body = create(path, class, config.as_ref(), execution);
            body.insert("isolation".into(), "process".into());
            json!({ "create": body })
        }
        Request::Remove { id, force } => json!({ "remove": { "path": id.to_string(), "force": force } }),
        Request::Forget { process } => json!({ "forget": { "process": process.as_str() } }),
        Request::Configure { id, patch, execution } => {
            let mut body = Map::new();
            body.insert("path".into(), id.to_string().into());
            body.insert("config".into(), patch.clone());
            put(&mut body, "execution", execution.as_ref().and_then(settings));
            json!({ "configure": body })
        }
        Request::Start { targets } => json!({ "start": paths(targets) }),
        Request::Stop { targets } => json!({ "stop": paths(targets) }),
        Request::Resume { targets } => json!({ "resume": paths(targets) }),
        Request::Reset { targets } => json!({ "reset": paths(targets) }),
        Request::Connect { client, server, options } => {
            let mut body = Map::new();
            body.insert("client".into(), client.to_string().into());
            body.insert("server".into(), server.to_string().into());
            put(&mut body, "options", wire_options(options));
            json!({ "connect": body })
        }
        Request::Disconnect { which: Which::Id(id) } => json!({ "disconnect": { "id": id.0 } }),
        Request::Disconnect { which: Which::Pair { client, server } } => {
            json!({ "disconnect": { "client": client.to_string(), "server": server.to_string() } })
        }
    }
}

fn create(path: String, class: &str, config: Option<&Value>, execution: &Execution) -> Map<String, Value> {
    let mut body = Map::new();
    body.insert("path".into(), path.into());
    body.insert("class".into(), class.into());
    put(&mut body, "config", config.cloned());
    put(&mut body, "execution", settings(execution));
    body
}

fn put(body: &mut Map<String, Value>, key: &str, value: Option<Value>) {
    if let Some(value) = value {
        body.insert(key.to_owned(), value);
    }
}

fn paths(targets: &[Target]) -> Value {
    let text = |target: &Target| match target {
        Target::One(id) => id.to_string(),
        Target::Glob(pattern) => pattern.to_string(),
    };
    json!({ "paths": targets.iter().map(text).collect::<Vec<_>>() })
}

/// What is set, by the names of the system file; nothing when all is left to the class.
fn settings(execution: &Execution) -> Option<Value> {
    let set = spelled(execution).into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?)));
    let set: Map<String, Value> = set.collect();
    (!set.is_empty()).then_some(Value::Object(set))
}

fn wire_options(options: &ConnectOptions) -> Option<Value> {
    let mut body = Map::new();
    let queue = options.queue.map(|queue| match queue {
        Queue::Latest => json!("latest"),
        Queue::Fifo { depth, drop_oldest } => json!({ "fifo": depth, "drop_oldest": drop_oldest }),
    });
    let ms = |ns: Option<u64>| ns.map(|ns| json!(ns as f64 / 1e6));
    put(&mut body, "queue", queue);
    put(&mut body, "max_age_ms", ms(options.max_age_ns));
    put(&mut body, "deadline_ms", ms(options.deadline_ns));
    put(&mut body, "mailbox", options.mailbox.map(Value::from));
    put(&mut body, "adapt", options.adapt.then_some(Value::Bool(true)));
    put(&mut body, "delay", options.delay.then_some(Value::Bool(true)));
    put(&mut body, "replace", options.replace.then_some(Value::Bool(true)));
    put(&mut body, "carrier", (!options.carrier.is_empty()).then(|| options.carrier.as_str().into()));
    (!body.is_empty()).then_some(Value::Object(body))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use trocar_model::{ComponentId, PortId};

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
            options: ConnectOptions { max_age_ns: Some(1_500_000), ..ConnectOptions::default() },
        };
        let want = r#"{"connect":{"client":"host/a/in","options":{"max_age_ms":1.5},"server":"host/b/out"}}"#;
        assert_eq!(asked(std::slice::from_ref(&connect)), want);
        assert!(asked(&[stop, connect]).starts_with(r#"[{"stop""#), "several are a list");
    }

    #[test]
    fn a_request_without_end_is_cut() {
        let id = ComponentId::parse("host/robot").unwrap();
        let patch = json!({"text": "é".repeat(1 << 20)});
        let line = asked(&[Request::Configure { id, patch, execution: None }]);
        assert!(line.len() < MOST + 50 && line.ends_with(" bytes)"), "{} bytes", line.len());
    }
}
