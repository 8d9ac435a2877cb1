//! Reads what people type as JSON.
//!
//! Invariant: a key that occurs twice is refused, as in a system file; an error never repeats a huge
//! argument whole.

use serde_json::Value;

use super::failure::Failure;
use super::units::cut;

/// Longest piece of an argument an error repeats, characters.
const SHOWN: usize = 80;

/// clap's parser of a JSON object.
pub(super) fn json_object(text: &str) -> Result<Value, String> {
    match serde_json::from_str(text) {
        Ok(Value::Object(map)) => match twice(text) {
            None => Ok(Value::Object(map)),
            Some(why) => Err(why),
        },
        Ok(other) => Err(format!(
            "expected a JSON object like {{\"seed\": 7}}, found {}",
            cut(&other.to_string(), SHOWN)
        )),
        Err(e) => Err(format!("not JSON ({e}); mind the shell: quote it as '{{\"seed\": 7}}'")),
    }
}

/// Reads a JSON argument that may be anything.
pub(super) fn json_value(text: &str) -> Result<Value, Failure> {
    let value = serde_json::from_str(text).map_err(|e| {
        Failure::usage(
            format!("the argument {:?} is not JSON: {e}", cut(text, SHOWN)),
            "quote it for the shell: '{\"position\": [0, 0, 0.01, 0, 0]}', '30', '\"enable\"'",
        )
    })?;
    match twice(text) {
        None => Ok(value),
        Some(why) => Err(Failure::usage(why, "which of the two is meant? leave the other out")),
    }
}

/// Returns the place of a key that occurs twice.
fn twice(text: &str) -> Option<String> {
    trocar::system_file::duplicate_key("the argument", text).map(|problem| problem.to_string())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_key_that_stands_twice_is_refused() {
        let object = json_object(r#"{"seed": 1, "seed": 2}"#).unwrap_err();
        assert!(object.contains("seed"), "{object}");
        let nested = json_value(r#"{"a": [{"b": 1, "b": 2}]}"#).unwrap_err();
        assert!(nested.message.contains('b'), "{nested:?}");
        assert_eq!(json_value("30").unwrap(), 30);
    }

    #[test]
    fn a_huge_argument_is_not_repeated_whole() {
        let huge = "x".repeat(100_000);
        assert!(json_value(&huge).unwrap_err().message.len() < 300);
        assert!(json_object(&format!("{huge:?}")).unwrap_err().len() < 300);
    }
}
