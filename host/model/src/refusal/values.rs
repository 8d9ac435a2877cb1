//! The fields of a refusal as JSON, for another process.
//!
//! Invariant: what is taken is what was put, but for a word of another build's.

use serde_json::{Value, json};

use crate::{ComponentId, MemberId, Name, PortId, ProcessState, State, Tag, Verb, Violation};

/// A value that another process can be told as JSON.
pub(super) trait Travels: Sized {
    fn put(&self) -> Value;
    fn take(value: &Value) -> Option<Self>;
}

impl Travels for String {
    fn put(&self) -> Value {
        json!(self)
    }
    fn take(value: &Value) -> Option<Self> {
        value.as_str().map(str::to_owned)
    }
}

impl Travels for bool {
    fn put(&self) -> Value {
        json!(self)
    }
    fn take(value: &Value) -> Option<Self> {
        value.as_bool()
    }
}

impl<T: Travels> Travels for Vec<T> {
    fn put(&self) -> Value {
        self.iter().map(Travels::put).collect()
    }
    fn take(value: &Value) -> Option<Self> {
        value.as_array()?.iter().map(T::take).collect()
    }
}

macro_rules! numbers {
    ($($ty:ty),*) => {$(
        impl Travels for $ty {
            fn put(&self) -> Value {
                json!(self)
            }
            fn take(value: &Value) -> Option<Self> {
                value.as_u64()?.try_into().ok()
            }
        }
    )*};
}
numbers!(u32, u64, usize);

macro_rules! names {
    ($($ty:ty),*) => {$(
        impl Travels for $ty {
            fn put(&self) -> Value {
                json!(self.to_string())
            }
            fn take(value: &Value) -> Option<Self> {
                <$ty>::parse(value.as_str()?).ok()
            }
        }
    )*};
}
names!(Name, ComponentId, PortId, MemberId);

macro_rules! words {
    ($($ty:ty),*) => {$(
        impl Travels for $ty {
            fn put(&self) -> Value {
                json!(self.to_string())
            }
            fn take(value: &Value) -> Option<Self> {
                <$ty>::ALL.into_iter().find(|known| value.as_str() == Some(&known.to_string()))
            }
        }
    )*};
}
words!(State, Verb, ProcessState);

impl Travels for Tag {
    fn put(&self) -> Value {
        json!(self.name())
    }
    fn take(value: &Value) -> Option<Self> {
        Tag::parse(value.as_str()?)
    }
}

/// Words the refusals use for entries of a component and for kinds of ends.
const WORDS: [&str; 19] = [
    "create",
    "configure",
    "describe",
    "start",
    "step",
    "stop",
    "resume",
    "reset",
    "make_safe",
    "destroy",
    "call",
    "handle",
    "run",
    "show its state",
    "show an output",
    "an input",
    "an output",
    "a required interface",
    "a provided interface",
];

impl Travels for &'static str {
    fn put(&self) -> Value {
        json!(self)
    }
    fn take(value: &Value) -> Option<Self> {
        let text = value.as_str()?;
        Some(WORDS.into_iter().find(|word| *word == text).unwrap_or("a call"))
    }
}

impl Travels for Violation {
    fn put(&self) -> Value {
        json!([self.pointer, self.message])
    }
    fn take(value: &Value) -> Option<Self> {
        Some(Violation { pointer: String::take(value.get(0)?)?, message: String::take(value.get(1)?)? })
    }
}

#[cfg(test)]
mod tests {
    use crate::StopReason;

    use super::*;

    #[test]
    fn stop_reasons_survive() {
        let state = State::Stopped(StopReason::Interlock);
        assert_eq!(State::take(&state.put()), Some(state));
    }
}
