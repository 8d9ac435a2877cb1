//! Real grpcurl against a served address, with no proto file: it learns everything from reflection.
//!
//! Invariant: an error is read from what grpcurl prints and from its exit code (64 + the gRPC code), as a
//! script would.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::fmt;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::thread;

use serde_json::{Deserializer, Value};

use crate::{Built, eventually};

/// Generous: a watchdog, not a measurement. The server caps unary calls at 60 s.
const WATCHDOG_S: u32 = 90;

/// Methods that may be asked twice: they change nothing, or the second time no more than the first.
const REPEATABLE: [&str; 6] = [
    "GcmService/Configure",
    "GcmService/Describe",
    "GcmService/GetState",
    "GcmService/List",
    "InteractService/Read",
    "PluginService/ListPlugins",
];

/// grpcurl, aimed at one address.
#[derive(Clone)]
pub struct Grpcurl {
    address: String,
    /// File of the identity it shows; none: plain text.
    identity: Option<PathBuf>,
}

/// What grpcurl printed about an error.
#[derive(Clone, Debug)]
pub struct Failure {
    /// The gRPC status code by name, `NOT_FOUND`.
    pub code: &'static str,
    /// `ErrorInfo.reason`, empty without details.
    pub reason: String,
    pub domain: String,
    pub message: String,
    /// Every detail, as JSON with its `@type`.
    pub details: Vec<Value>,
    pub exit_code: i32,
}

impl Grpcurl {
    #[must_use]
    pub fn new(address: &str) -> Self {
        Self { address: address.to_owned(), identity: None }
    }

    /// Shows the identity in this file, by TLS.
    #[must_use]
    pub fn showing(address: &str, identity: &Path) -> Self {
        Self { address: address.to_owned(), identity: Some(identity.to_owned()) }
    }

    /// Its flags for the way: plain text, or which files to show and to believe.
    fn way(&self) -> Vec<OsString> {
        let Some(file) = &self.identity else { return vec!["-plaintext".into()] };
        ["-cacert", "-cert", "-key"].into_iter().flat_map(|what| [what.into(), file.into()]).collect()
    }

    /// One unary call, e.g. `("GcmService/Create", json!({…}))`; the package name is put before it.
    ///
    /// # Errors
    /// The status the server answered.
    pub fn call(&self, method: &str, body: Value) -> Result<Value, Failure> {
        let output = self.run(&["-format-error", "-emit-defaults"], Some(&body), &[&full_name(method)]);
        if output.status.success() {
            let text = String::from_utf8_lossy(&output.stdout);
            return Ok(serde_json::from_str(&text)
                .unwrap_or_else(|e| panic!("{method} answered what is not one JSON value ({e}):\n{text}")));
        }
        Err(Failure::read(method, &body, &output))
    }

    /// A call that must succeed, by processes that are heard.
    ///
    /// # Panics
    /// With the whole refusal otherwise.
    #[track_caller]
    pub fn ok(&self, method: &str, body: Value) -> Value {
        let shown = body.to_string();
        let answer = match REPEATABLE.contains(&method) {
            true => Self::when_heard(|| self.call(method, body.clone())),
            false => self.call(method, body),
        };
        answer.unwrap_or_else(|refused| panic!("{method} {shown} was refused: {refused}"))
    }

    /// Asks again while a process is thought lost, as it may be for a moment on a busy machine.
    #[track_caller]
    fn when_heard(mut ask: impl FnMut() -> Result<Value, Failure>) -> Result<Value, Failure> {
        eventually("the processes are heard", || match ask() {
            Err(lost) if lost.reason == "PROCESS_LOST" => Err(lost),
            answer => Ok(answer),
        })
    }

    /// A call that must be refused.
    ///
    /// # Panics
    /// With the answer otherwise.
    pub fn refused(&self, method: &str, body: Value) -> Failure {
        let shown = body.to_string();
        match self.call(method, body) {
            Err(failure) => failure,
            Ok(answer) => panic!("{method} {shown} was not refused but answered {answer}"),
        }
    }

    /// The refusal by processes that are heard.
    ///
    /// # Panics
    /// With the answer otherwise, or when one stays lost.
    #[track_caller]
    pub fn refused_when_heard(&self, method: &str, body: &Value) -> Failure {
        match Self::when_heard(|| self.call(method, body.clone())) {
            Err(refused) => refused,
            Ok(answer) => panic!("{method} {body} was not refused but answered {answer}"),
        }
    }

    /// What a person sees on the terminal: standard output and error of the plain command.
    #[must_use]
    pub fn printed(&self, method: &str, body: &Value) -> String {
        let output = self.run(&[], Some(body), &[&full_name(method)]);
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
    }

    /// `grpcurl ADDR list [SYMBOL]` or `describe SYMBOL`.
    #[must_use]
    pub fn ask_reflection(&self, verb: &[&str]) -> String {
        let output = self.run(&[], None, verb);
        assert!(output.status.success(), "grpcurl {verb:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    /// Starts a server stream.
    #[must_use]
    pub fn stream(&self, method: &str, body: &Value) -> Stream {
        let mut child = Command::new(Built::grpcurl())
            .args(self.way())
            .args(["-emit-defaults", "-d", &body.to_string(), &self.address, &full_name(method)])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .unwrap_or_else(|e| panic!("cannot start grpcurl: {e}"));
        let (to, items) = channel();
        let Some(out) = child.stdout.take() else { panic!("grpcurl has no standard output") };
        thread::spawn(move || {
            for value in Deserializer::from_reader(BufReader::new(out)).into_iter::<Value>() {
                let Ok(value) = value else { return };
                if to.send(value).is_err() {
                    return;
                }
            }
        });
        Stream { child, items, method: method.to_owned(), passed_over: 0, last: VecDeque::new() }
    }

    fn run(&self, options: &[&str], body: Option<&Value>, verb: &[&str]) -> std::process::Output {
        let mut command = Command::new(Built::grpcurl());
        command.args(self.way()).args(["-max-time", &WATCHDOG_S.to_string()]).args(options);
        if let Some(body) = body {
            command.args(["-d", &body.to_string()]);
        }
        command.arg(&self.address).args(verb).stdin(Stdio::null());
        command.output().unwrap_or_else(|e| panic!("cannot start grpcurl: {e}"))
    }
}

impl Failure {
    fn read(method: &str, body: &Value, output: &std::process::Output) -> Self {
        let text = String::from_utf8_lossy(&output.stderr);
        if let Some(why) = text.trim_start().strip_prefix("Failed to dial target host ") {
            // Nobody listened, or not any more: the one who asked may have been late.
            return Self {
                code: "UNAVAILABLE",
                reason: String::new(),
                domain: String::new(),
                message: why.trim().to_owned(),
                details: Vec::new(),
                exit_code: output.status.code().unwrap_or(-1),
            };
        }
        let status: Value = serde_json::from_str(&text).unwrap_or_else(|_| {
            panic!("grpcurl {method} {body} ended with {} and no gRPC status:\n{text}", output.status)
        });
        let exit_code = output.status.code().unwrap_or(-1);
        let number = status["code"].as_i64().unwrap_or(-1);
        assert_eq!(i64::from(exit_code), 64 + number, "grpcurl's exit code is 64 + the gRPC code: {text}");
        let details = status["details"].as_array().cloned().unwrap_or_default();
        let info =
            details.iter().find(|d| d["@type"].as_str().is_some_and(|t| t.ends_with("google.rpc.ErrorInfo")));
        let field = |name: &str| info.and_then(|i| i[name].as_str()).unwrap_or_default().to_owned();
        Self {
            code: code_name(number),
            reason: field("reason"),
            domain: field("domain"),
            message: status["message"].as_str().unwrap_or_default().to_owned(),
            exit_code,
            details,
        }
    }

    /// The field paths of `google.rpc.BadRequest`.
    #[must_use]
    pub fn violated_fields(&self) -> Vec<String> {
        let violations = self.details.iter().filter_map(|d| d["fieldViolations"].as_array()).flatten();
        violations.filter_map(|v| v["field"].as_str().map(str::to_owned)).collect()
    }

    /// A value of `ErrorInfo.metadata`.
    #[must_use]
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.details.iter().find_map(|d| d["metadata"][key].as_str())
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} [{}] {}", self.code, self.reason, self.message)
    }
}

/// A running server stream; ended when dropped.
pub struct Stream {
    child: Child,
    items: Receiver<Value>,
    method: String,
    passed_over: u64,
    /// The last few of them.
    last: VecDeque<Value>,
}

/// Items passed over that a failure shows.
const SHOWN: usize = 5;

impl Stream {
    /// Waits for an item `wanted` says yes to, and passes over the others.
    ///
    /// # Panics
    /// When the stream ends, or as [`eventually`] does; each item that comes is progress. The last items are
    /// shown.
    #[track_caller]
    pub fn until(&mut self, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let found =
            eventually(&format!("{}: {what}", self.method), || self.look(&wanted).ok_or_else(|| self.seen()));
        found
            .unwrap_or_else(|| panic!("{} has ended while waiting for: {what}\n{}", self.method, self.seen()))
    }

    /// Waits until the server ends it, whatever it still says.
    ///
    /// # Panics
    /// As [`eventually`] does; each item that comes is progress.
    #[track_caller]
    pub fn ended(&mut self, why: &str) {
        eventually(&format!("{} ends: {why}", self.method), || {
            self.look(&|_| false).ok_or_else(|| self.seen())
        });
    }

    /// Takes what is there up to a wanted item: that item, or `None` inside when the stream has ended.
    fn look(&mut self, wanted: &impl Fn(&Value) -> bool) -> Option<Option<Value>> {
        loop {
            match self.items.try_recv() {
                Ok(item) if wanted(&item) => return Some(Some(item)),
                Ok(item) => self.pass_over(item),
                Err(TryRecvError::Disconnected) => return Some(None),
                Err(TryRecvError::Empty) => return None,
            }
        }
    }

    fn pass_over(&mut self, item: Value) {
        self.passed_over += 1;
        self.last.push_back(item);
        if self.last.len() > SHOWN {
            self.last.pop_front();
        }
    }

    fn seen(&self) -> String {
        format!("{} items were passed over, the last ones: {:#?}", self.passed_over, self.last)
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn full_name(method: &str) -> String {
    if method.contains('.') { method.to_owned() } else { format!("trocar.v1.{method}") }
}

fn code_name(number: i64) -> &'static str {
    const NAMES: [&str; 17] = [
        "OK",
        "CANCELLED",
        "UNKNOWN",
        "INVALID_ARGUMENT",
        "DEADLINE_EXCEEDED",
        "NOT_FOUND",
        "ALREADY_EXISTS",
        "PERMISSION_DENIED",
        "RESOURCE_EXHAUSTED",
        "FAILED_PRECONDITION",
        "ABORTED",
        "OUT_OF_RANGE",
        "UNIMPLEMENTED",
        "INTERNAL",
        "UNAVAILABLE",
        "DATA_LOSS",
        "UNAUTHENTICATED",
    ];
    usize::try_from(number).ok().and_then(|n| NAMES.get(n)).copied().unwrap_or("NO_CODE")
}
