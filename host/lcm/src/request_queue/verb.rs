//! Finds the service a request names, without allocating, so that a real-time thread may call it.
//!
//! Invariant: one pass, no recursion, no allocation. A request that passes is an object whose brackets and
//! strings are closed; the rest of its grammar is checked where it is carried out, and the reply says what is
//! wrong.

/// Requests a component can make; `Watch` is here only for the reply that names its replacement.
pub const VERBS: [&str; 19] = [
    "Create",
    "Configure",
    "Start",
    "Stop",
    "Resume",
    "Reset",
    "Remove",
    "Connect",
    "Disconnect",
    "Apply",
    "GetState",
    "List",
    "Describe",
    "WaitFor",
    "Replace",
    "Move",
    "Load",
    "Unload",
    "Watch",
];

const UNKNOWN: &str = "a request for a service names no known verb: give \"verb\" one of Create, Configure, Start, Stop, \
                       Resume, Reset, Remove, Connect, Disconnect, Apply, GetState, List, Describe, WaitFor, Replace, \
                       Move, Load, Unload";
const BROKEN: &str = "a request for a service is not a JSON object: give {\"verb\": \"GetState\", \"path\": \"host/arm\"} or so";

/// Deepest nesting of a request.
const DEEPEST: u32 = 64;

/// The verb of a request.
///
/// # Errors
/// A sentence: no object, or no known verb.
pub(super) fn known(text: &[u8]) -> Result<&'static str, &'static str> {
    std::str::from_utf8(text).map_err(|_| BROKEN)?;
    let mut scan = Scan { text, at: 0 };
    if scan.next() != Some(b'{') {
        return Err(BROKEN);
    }
    // One bit for each open bracket, the innermost lowest: set for an object.
    let (mut kinds, mut depth) = (1u64, 1);
    let mut verb = None;
    while depth > 0 {
        match scan.next().ok_or(BROKEN)? {
            b'"' => {
                let key = scan.string().ok_or(BROKEN)?;
                if depth == 1 && scan.peek() == Some(b':') && key == b"verb" {
                    scan.next();
                    if scan.next() != Some(b'"') || verb.is_some() {
                        return Err(UNKNOWN);
                    }
                    let value = scan.string().ok_or(BROKEN)?;
                    verb = Some(VERBS.into_iter().find(|v| v.as_bytes() == value).ok_or(UNKNOWN)?);
                }
            }
            open @ (b'{' | b'[') => {
                if depth == DEEPEST {
                    return Err(BROKEN);
                }
                kinds = kinds << 1 | u64::from(open == b'{');
                depth += 1;
            }
            close @ (b'}' | b']') => {
                if (kinds & 1 == 1) != (close == b'}') {
                    return Err(BROKEN);
                }
                kinds >>= 1;
                depth -= 1;
            }
            _ => {}
        }
    }
    match scan.next() {
        None => verb.ok_or(UNKNOWN),
        Some(_) => Err(BROKEN),
    }
}

struct Scan<'a> {
    text: &'a [u8],
    at: usize,
}

impl<'a> Scan<'a> {
    /// The next byte that is no white space, not taken.
    fn peek(&mut self) -> Option<u8> {
        while self.text.get(self.at).is_some_and(u8::is_ascii_whitespace) {
            self.at += 1;
        }
        self.text.get(self.at).copied()
    }

    fn next(&mut self) -> Option<u8> {
        let byte = self.peek()?;
        self.at += 1;
        Some(byte)
    }

    /// The rest of a string behind its opening quote, with its escapes.
    fn string(&mut self) -> Option<&'a [u8]> {
        let from = self.at;
        loop {
            match self.text.get(self.at)? {
                b'"' => {
                    self.at += 1;
                    return Some(&self.text[from..self.at - 1]);
                }
                b'\\' => self.at += 2,
                _ => self.at += 1,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_verb_is_found_wherever_it_stands() {
        for text in [
            r#"{"verb":"Create","path":"host/a"}"#,
            r#" { "path" : "host/a" , "config" : {"verb":"none","x":[1,{"y":"}"}]} , "verb" : "Create" } "#,
            r#"{"path":"verb","name":"a \" b","verb":"Create"}"#,
        ] {
            assert_eq!(known(text.as_bytes()), Ok("Create"), "{text}");
        }
    }

    #[test]
    fn every_verb_is_in_the_sentence_that_lists_them() {
        for verb in VERBS {
            assert_eq!(known(format!("{{\"verb\":\"{verb}\"}}").as_bytes()), Ok(verb));
            assert!(verb == "Watch" || UNKNOWN.contains(verb), "{verb} is not named");
        }
    }

    #[test]
    fn what_names_no_known_verb_is_told_which_there_are() {
        for text in [
            "{}",
            r#"{"verb":"Destroy"}"#,
            r#"{"verb":1}"#,
            r#"{"verb":null}"#,
            r#"{"config":{"verb":"Create"}}"#,
            r#"{"x":"verb"}"#,
            r#"{"verb":"Create","verb":"Stop"}"#,
        ] {
            assert_eq!(known(text.as_bytes()), Err(UNKNOWN), "{text}");
        }
    }

    #[test]
    fn what_is_no_object_is_refused() {
        let deep = format!("{{\"verb\":\"Create\",\"a\":{}1{}}}", "[".repeat(100), "]".repeat(100));
        for text in [
            "",
            "Create",
            "[]",
            "\"Create\"",
            "{",
            r#"{"verb":"Create""#,
            r#"{"verb":"Create"}}"#,
            r#"{"verb":"Create"} x"#,
            r#"{"verb":"Create","a":[}]}"#,
            r#"{"verb":"Create"#,
            r#"{"a":"\"#,
            &deep,
        ] {
            assert_eq!(known(text.as_bytes()), Err(BROKEN), "{text}");
        }
        assert_eq!(known(b"{\"verb\":\"\xff\"}"), Err(BROKEN));
    }
}
