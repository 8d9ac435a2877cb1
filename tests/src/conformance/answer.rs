//! What the fixture's client is asked to do, and what it answered, as values.
//!
//! Invariant: positions of functions and outcomes are those of the fixture classes.

use serde_json::{Value, json};
use trocar_sdk::Outcome;

/// Functions of the client, in the order of its class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Function {
    Poke,
    Write,
    WriteLatest,
    WriteNewest,
    Take,
    Twice,
    Value,
    Scaled,
    Refuse,
    Crash,
    Hold,
    Burst,
    Publish,
    PublishFrames,
}

impl Function {
    /// The command's name, of the server's interface `ctl`.
    #[must_use]
    pub fn command(self) -> &'static str {
        const NAMES: [&str; 14] = [
            "poke",
            "write",
            "write_latest",
            "write_newest",
            "take",
            "twice",
            "value",
            "scaled",
            "refuse",
            "crash",
            "hold",
            "burst",
            "publish",
            "publish_frames",
        ];
        NAMES[self as usize]
    }

    /// Answered from the published row.
    #[must_use]
    pub fn reads(self) -> bool {
        matches!(self, Function::Value | Function::Scaled)
    }
}

/// Calls the client is to make.
#[derive(Clone, Copy, Debug)]
pub struct Call {
    pub what: Function,
    pub wait: bool,
    pub threads: u32,
    pub times: u32,
    pub arg: f64,
    pub deadline_ns: u64,
}

impl Call {
    /// One `send`, in the client's own thread.
    #[must_use]
    pub fn send(what: Function, arg: f64) -> Call {
        Call { what, wait: false, threads: 0, times: 1, arg, deadline_ns: 0 }
    }

    /// One `call`, in the client's own thread.
    #[must_use]
    #[expect(clippy::self_named_constructors, reason = "a call and a send are the two ways to ask")]
    pub fn call(what: Function, arg: f64) -> Call {
        Call { wait: true, ..Call::send(what, arg) }
    }

    /// From so many threads of the client's own at once.
    #[must_use]
    pub fn from_threads(self, threads: u32) -> Call {
        Call { threads, ..self }
    }

    #[must_use]
    pub fn times(self, times: u32) -> Call {
        Call { times, ..self }
    }

    #[must_use]
    pub fn within_ms(self, ms: u64) -> Call {
        Call { deadline_ns: ms * 1_000_000, ..self }
    }

    pub(super) fn json(&self) -> Value {
        json!({
            "what": self.what as u32, "how": u32::from(self.wait), "threads": self.threads, "times": self.times,
            "arg": self.arg, "deadline_ns": self.deadline_ns,
        })
    }
}

/// What calls came to.
#[derive(Clone, Debug)]
pub struct Answer {
    /// How often each outcome came; none that never came.
    pub outcomes: Vec<(Outcome, u64)>,
    pub may_still_run: u64,
    pub value: f64,
    pub text: String,
}

/// In the order of the fixture's counts.
const OUTCOMES: [Outcome; 12] = [
    Outcome::Queued,
    Outcome::Executed,
    Outcome::Unbound,
    Outcome::QueueFull,
    Outcome::WouldBlock,
    Outcome::Disabled,
    Outcome::InvalidArgument,
    Outcome::Failed,
    Outcome::Deadline,
    Outcome::PeerLost,
    Outcome::NotActive,
    Outcome::Exhausted,
];

impl Answer {
    pub(super) fn of(tally: &Value) -> Answer {
        let counts = tally["counts"].as_array().cloned().unwrap_or_default();
        let outcomes = OUTCOMES.into_iter().zip(counts.iter().map(whole)).filter(|(_, n)| *n > 0).collect();
        Answer {
            outcomes,
            may_still_run: whole(&tally["may_still_run"]),
            value: tally["value"].as_f64().unwrap_or(f64::NAN),
            text: tally["text"].as_str().unwrap_or_default().to_owned(),
        }
    }

    /// How many calls there were.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.outcomes.iter().map(|(_, n)| n).sum()
    }

    /// How often `outcome` came.
    #[must_use]
    pub fn count(&self, outcome: Outcome) -> u64 {
        self.outcomes.iter().find(|(o, _)| *o == outcome).map_or(0, |(_, n)| *n)
    }

    /// Leaves out so many of an outcome; without effect where there are not as many.
    pub(super) fn take(&mut self, outcome: Outcome, n: u64) {
        if let Some((_, count)) = self.outcomes.iter_mut().find(|(o, count)| *o == outcome && *count >= n) {
            *count -= n;
        }
        self.outcomes.retain(|(_, count)| *count > 0);
    }

    /// The one outcome there was.
    ///
    /// # Panics
    /// There were several, or none.
    #[must_use]
    pub fn only(&self) -> Outcome {
        match self.outcomes.as_slice() {
            [(outcome, _)] => *outcome,
            other => panic!("one outcome was expected, these came: {other:?} ({})", self.text),
        }
    }
}

/// What an input gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Samples {
    pub count: u64,
    pub gaps: u64,
    pub first: f64,
    pub last: f64,
    pub stale: u64,
    pub fresh: u64,
}

impl Samples {
    pub(super) fn of(value: &Value) -> Samples {
        let real = |name: &str| value[name].as_f64().unwrap_or(f64::NAN);
        let count = |name: &str| whole(&value[name]);
        Samples {
            count: count("count"),
            gaps: count("gaps"),
            first: real("first"),
            last: real("last"),
            stale: count("stale"),
            fresh: count("fresh"),
        }
    }
}

/// A whole number of a state row.
///
/// # Panics
/// It is none: the row has no such field.
pub(super) fn whole(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no whole number"))
}
