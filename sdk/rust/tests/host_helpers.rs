//! Slices of a frame on several threads, and dynamic component services, as an author writes them.
#![allow(clippy::unwrap_used)]

mod little_host;

use little_host::LittleHost;
use std::sync::atomic::{AtomicU32, Ordering};
use trocar_sdk::serde_json::{Value, json};
use trocar_sdk::{ServiceReply, prelude::*};

/// Adds row numbers to pixels, and asks for services.
#[derive(Component)]
#[component(model = "stream", provides("ctl"))]
struct Worker {
    #[host]
    host: Host,
    #[state]
    tokens: [u64; 2],
    #[state]
    answered: Stamp,
}

#[provides("ctl")]
impl Worker {
    /// Works on as many rows and answers the sum.
    #[command]
    fn rows(&mut self, rows: f64) -> Result<f64> {
        let stride = 5;
        // One item short: the last row is not whole.
        let mut pixels = vec![1u64; (rows as usize * stride).saturating_sub(1)];
        let calls = AtomicU32::new(0);
        self.host.par_rows(&mut pixels, stride, |rows, part| {
            calls.fetch_add(1, Ordering::Relaxed);
            for (row, pixels) in rows.clone().zip(part.chunks_mut(stride)) {
                pixels.iter_mut().for_each(|p| *p += row as u64);
            }
            assert_eq!(part.len().div_ceil(stride), rows.len());
        })?;
        assert!(calls.into_inner() as usize <= 4 * self.host.threads());
        Ok(pixels.iter().sum::<u64>() as f64)
    }

    #[command]
    fn fail(&mut self, slice: f64) -> Result<f64> {
        let done = AtomicU32::new(0);
        self.host.parallel(8, |i| {
            assert!(i != slice as u32, "cannot do this one");
            done.fetch_add(1, Ordering::Relaxed);
        })?;
        Ok(f64::from(done.into_inner()))
    }

    #[command]
    fn ask(&mut self) -> Result {
        let services = self.host.services();
        let token = |t: Result<u64, Outcome>| t.map_err(|o| o.to_string());
        self.tokens[0] = token(services.create("host/f", "low_pass", json!({"cutoff_hz": 20}))).unwrap();
        self.tokens[1] = token(services.connect("host/f/raw", "host/s/value"))?;
        token(services.stop(self.host.instance_name()))?;
        token(services.wait_for("host/f", &["READY", "ACTIVE"], 0.5))?;
        token(services.create("host/g", "low_pass", Value::Null))?;
        assert_eq!(services.ask("List", json!([1])), Err(Outcome::InvalidArgument));
        Ok(())
    }
}

impl Component for Worker {
    fn answered(&mut self, reply: ServiceReply) -> Result {
        self.answered = Stamp::from_ns(reply.token);
        if reply.ok { Ok(()) } else { Err(format!("{}: {}", reply.reason, reply.message).into()) }
    }
}

/// Rows 0 to 9 of five pixels, the last one short.
fn expected() -> f64 {
    (0..10).map(|row| (1 + row) * if row == 9 { 4 } else { 5 }).sum::<u32>().into()
}

#[test]
fn rows_are_worked_on_once_each_with_one_thread_and_with_several() {
    let mut host = LittleHost::<Worker>::new();
    assert_eq!(host.command(0, 10.0), Ok(expected()));
    host.asked.threads = 3;
    assert_eq!(host.command(0, 10.0), Ok(expected()));
    assert_eq!(host.command(0, 1.0), Ok(4.0), "fewer rows than threads");
    assert_eq!(host.command(0, 0.0), Ok(0.0), "no rows at all");
}

#[test]
fn a_panic_in_a_slice_is_an_error_that_names_the_slice() {
    let mut host = LittleHost::<Worker>::new();
    for threads in [0, 3] {
        host.asked.threads = threads;
        assert_eq!(host.command(1, 99.0), Ok(8.0));
        let (status, why) = host.command(1, 5.0).unwrap_err();
        assert_eq!(status, trocar_plugin_api::abi::STATUS_FAILED);
        assert!(why.contains("slice 5") && why.contains("cannot do this one"), "{why}");
    }
}

#[test]
fn services_are_asked_for_in_the_words_of_the_proto() {
    let mut host = LittleHost::<Worker>::new();
    host.command(2, 0.0).unwrap();
    let asked: Vec<Value> =
        host.asked.services.iter().map(|(_, text)| serde_json::from_str(text).unwrap()).collect();
    assert_eq!(
        asked,
        [
            json!({"verb": "Create", "path": "host/f", "class": "low_pass", "config": {"cutoff_hz": 20}}),
            json!({"verb": "Connect", "client": "host/f/raw", "server": "host/s/value"}),
            json!({"verb": "Stop", "path": "it"}),
            json!({"verb": "WaitFor", "path": "host/f", "deadline": "0.500s",
                   "states": ["COMPONENT_STATE_READY", "COMPONENT_STATE_ACTIVE"]}),
            json!({"verb": "Create", "path": "host/g", "class": "low_pass"}),
        ]
    );
    let tokens: Vec<u64> = host.asked.services.iter().map(|(token, _)| *token).collect();
    assert_eq!(tokens[..2], host.state().tokens, "asking gives the token of the reply");
    assert!(tokens.windows(2).all(|w| w[0] < w[1]), "each asking has a token of its own");
}

#[test]
fn replies_come_read() {
    let reply = ServiceReply::parse(3, r#"{"ok": true, "response": {"revision": 4}}"#);
    assert_eq!((reply.token, reply.ok, &reply.response["revision"]), (3, true, &json!(4)));
    let refused = ServiceReply::parse(
        4,
        r#"{"ok": false, "code": "NOT_FOUND", "reason": "CLASS_NOT_FOUND", "message": "no class x", "help": "load it"}"#,
    );
    assert!(!refused.ok && refused.response.is_null());
    assert_eq!((refused.reason.as_str(), refused.help.as_str()), ("CLASS_NOT_FOUND", "load it"));
    for broken in ["", "[]", "{", "{\"ok\": 1}"] {
        assert!(!ServiceReply::parse(5, broken).ok, "{broken}");
    }
}

#[test]
fn the_component_gets_its_reply_and_may_refuse_it() {
    let mut host = LittleHost::<Worker>::new();
    assert_eq!(host.reply(9, r#"{"ok": true}"#), 0);
    assert_eq!(host.state().answered.ns(), 9);
    assert_ne!(host.reply(9, "nonsense"), 0);
}
