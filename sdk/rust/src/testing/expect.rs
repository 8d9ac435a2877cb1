//! Expectations in sentences: the expected values, the actual ones, and the latest events.
//!
//! Invariant: an expectation takes what it looked at, like `outputs`, `events` and `calls` do.

use super::bench::Bench;
use crate::call::Value;
use crate::class::Class;
use crate::payload::Payload;
use core::fmt::Debug;

impl<C: Class> Bench<C> {
    /// Fails the test unless the output wrote exactly these values since the last asking.
    #[track_caller]
    pub fn expect_outputs<T: Payload + PartialEq + Debug>(&mut self, output: &str, expected: &[T]) {
        let came = self.outputs::<T>(output);
        self.compare("output", output, expected, &came);
    }

    /// Fails the test unless the event came exactly with these values since the last asking.
    #[track_caller]
    pub fn expect_events<T: Value + PartialEq + Debug>(&mut self, event: &str, expected: &[T]) {
        let came = self.events::<T>(event);
        self.compare("event", event, expected, &came);
    }

    /// Fails the test unless the function was called exactly with these arguments since the last asking.
    #[track_caller]
    pub fn expect_calls<A: Value + PartialEq + Debug>(&mut self, function: &str, expected: &[A]) {
        let came = self.calls::<A>(function);
        self.compare("function", function, expected, &came);
    }

    /// Fails the test unless a line of this level with `part` in it was logged since the last asking. Takes
    /// them all.
    #[track_caller]
    pub fn expect_log(&mut self, level: log::Level, part: &str) {
        let came = self.logs();
        if came.iter().any(|line| line.level == level && line.message.contains(part)) {
            return;
        }
        let told: Vec<String> = came.iter().map(|l| format!("\n  {} {}", l.level, l.message)).collect();
        let told = if told.is_empty() { " nothing".to_string() } else { told.concat() };
        panic!(
            "no line of level {level} with \"{part}\"; logged was{told}{}",
            self.history.text(&self.shape)
        );
    }

    /// Fails the test, with your sentence and the latest events, unless `holds`.
    #[track_caller]
    pub fn expect(&self, holds: bool, what: &str) {
        assert!(holds, "{what}{}", self.history.text(&self.shape));
    }

    #[track_caller]
    fn compare<T: PartialEq + Debug>(&self, what: &str, name: &str, expected: &[T], came: &[T]) {
        if expected == came {
            return;
        }
        let differs = expected.iter().zip(came).position(|(a, b)| a != b);
        let told = match differs {
            Some(at) => format!("value {at} is {:?} instead of {:?}", came[at], expected[at]),
            None if came.len() > expected.len() => format!("then came {:?}", came[expected.len()]),
            None => format!("{:?} and what follows did not come", expected[came.len()]),
        };
        let history = self.history.text(&self.shape);
        panic!("{what} `{name}`: expected {} values, {} came; {told}{history}", expected.len(), came.len());
    }
}
