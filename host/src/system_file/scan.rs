//! Strict JSON with a position for every value and key, so that an error can say line and column.
//!
//! Invariant: `serde_json` has accepted the whole text before the scanner walks it; the scanner only adds
//! positions and keeps what `serde_json` would hide (duplicate keys, order).

use serde_json::{Map, Number, Value};

/// One JSON value and the byte offset where it begins.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Node {
    pub(crate) at: usize,
    pub(crate) kind: Kind,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Kind {
    Null,
    Bool(bool),
    Number(Number),
    Text(String),
    List(Vec<Node>),
    /// In the order of the text, duplicates kept.
    Object(Vec<(Key, Node)>),
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Key {
    pub(crate) at: usize,
    pub(crate) text: String,
}

/// Text that is not JSON: line and column from 1, and why.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SyntaxError {
    pub(crate) line: usize,
    pub(crate) column: usize,
    pub(crate) why: String,
}

/// Parses a whole text.
///
/// # Errors
/// The first syntax error, with its place.
pub(crate) fn parse(text: &str) -> Result<Node, SyntaxError> {
    serde_json::from_str::<Value>(text).map_err(|e| {
        let (line, column) = (e.line().max(1), e.column().max(1));
        let whole = e.to_string();
        let why = whole.rsplit_once(" at line ").map_or(whole.as_str(), |(why, _)| why).to_owned();
        SyntaxError { line, column, why }
    })?;
    let mut scanner = Scanner { text, at: 0 };
    scanner.value().ok_or_else(|| {
        let (line, column) = line_column(text, scanner.at);
        SyntaxError { line, column, why: "unexpected text".to_owned() }
    })
}

/// Line and column (in characters) from 1 of a byte offset.
pub(crate) fn line_column(text: &str, at: usize) -> (usize, usize) {
    let before = text.get(..at).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().map_or(0, |l| l.chars().count()) + 1;
    (line, column)
}

impl Node {
    /// Describes the value in words.
    pub(crate) fn describe(&self) -> String {
        match &self.kind {
            Kind::Null => "null".to_owned(),
            Kind::Bool(b) => b.to_string(),
            Kind::Number(n) => format!("the number {n}"),
            Kind::Text(t) => format!("the text {t:?}"),
            Kind::List(_) => "a list".to_owned(),
            Kind::Object(_) => "an object".to_owned(),
        }
    }

    /// The plain JSON value, without the comments (keys named `//`). Of duplicate keys the last wins.
    pub(crate) fn to_value(&self) -> Value {
        match &self.kind {
            Kind::Null => Value::Null,
            Kind::Bool(b) => Value::Bool(*b),
            Kind::Number(n) => Value::Number(n.clone()),
            Kind::Text(t) => Value::String(t.clone()),
            Kind::List(items) => Value::Array(items.iter().map(Node::to_value).collect()),
            Kind::Object(fields) => Value::Object(
                fields
                    .iter()
                    .filter(|(k, _)| k.text != super::COMMENT)
                    .map(|(k, v)| (k.text.clone(), v.to_value()))
                    .collect::<Map<_, _>>(),
            ),
        }
    }

    /// The value behind a JSON pointer (RFC 6901), or the nearest value above it that exists.
    pub(crate) fn nearest_to(&self, pointer: &str) -> &Node {
        let mut node = self;
        for part in pointer.split('/').skip(1) {
            let part = part.replace("~1", "/").replace("~0", "~");
            let next = match &node.kind {
                Kind::Object(fields) => fields.iter().find(|(k, _)| k.text == part).map(|(_, v)| v),
                Kind::List(items) => part.parse::<usize>().ok().and_then(|i| items.get(i)),
                _ => None,
            };
            match next {
                Some(next) => node = next,
                None => break,
            }
        }
        node
    }
}

/// Walks text that is known to be JSON; `None` would mean that it is not.
struct Scanner<'a> {
    text: &'a str,
    at: usize,
}

impl Scanner<'_> {
    fn peek(&mut self) -> Option<u8> {
        let bytes = self.text.as_bytes();
        while bytes.get(self.at).is_some_and(u8::is_ascii_whitespace) {
            self.at += 1;
        }
        bytes.get(self.at).copied()
    }

    /// True when the next byte is `b`, which is then behind us.
    fn take(&mut self, b: u8) -> bool {
        let hit = self.peek() == Some(b);
        self.at += usize::from(hit);
        hit
    }

    fn value(&mut self) -> Option<Node> {
        let first = self.peek()?;
        let at = self.at;
        let kind = match first {
            b'{' => self.object()?,
            b'[' => self.list()?,
            b'"' => Kind::Text(self.string()?),
            _ => self.word()?,
        };
        Some(Node { at, kind })
    }

    fn object(&mut self) -> Option<Kind> {
        self.take(b'{');
        let mut fields = Vec::new();
        if self.take(b'}') {
            return Some(Kind::Object(fields));
        }
        loop {
            self.peek()?;
            let at = self.at;
            let text = self.string()?;
            if !self.take(b':') {
                return None;
            }
            fields.push((Key { at, text }, self.value()?));
            if self.take(b'}') {
                return Some(Kind::Object(fields));
            }
            if !self.take(b',') {
                return None;
            }
        }
    }

    fn list(&mut self) -> Option<Kind> {
        self.take(b'[');
        let mut items = Vec::new();
        if self.take(b']') {
            return Some(Kind::List(items));
        }
        loop {
            items.push(self.value()?);
            if self.take(b']') {
                return Some(Kind::List(items));
            }
            if !self.take(b',') {
                return None;
            }
        }
    }

    fn string(&mut self) -> Option<String> {
        let start = self.at;
        let bytes = self.text.as_bytes();
        let mut end = start + 1;
        while *bytes.get(end)? != b'"' {
            end += if bytes[end] == b'\\' { 2 } else { 1 };
        }
        self.at = end + 1;
        serde_json::from_str(self.text.get(start..=end)?).ok()
    }

    fn word(&mut self) -> Option<Kind> {
        let rest = self.text.get(self.at..)?;
        let len = rest
            .find(|c: char| c == ',' || c == ']' || c == '}' || c.is_ascii_whitespace())
            .unwrap_or(rest.len());
        let word = rest.get(..len)?;
        self.at += len;
        match word {
            "null" => Some(Kind::Null),
            "true" => Some(Kind::Bool(true)),
            "false" => Some(Kind::Bool(false)),
            number => serde_json::from_str(number).ok().map(Kind::Number),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_value_and_key_knows_where_it_begins() {
        let text = "{\n  \"a\": [1, {\"b\": \"é\\\"\"}]\n}";
        let root = parse(text).unwrap();
        let Kind::Object(fields) = &root.kind else { panic!("not an object: {root:?}") };
        assert_eq!(line_column(text, fields[0].0.at), (2, 3));
        assert_eq!(line_column(text, root.nearest_to("/a/1/b").at), (2, 18));
        assert_eq!(root.to_value(), serde_json::from_str::<Value>(text).unwrap());
    }

    #[test]
    fn a_syntax_error_has_line_column_and_reason() {
        let e = parse("{\n  \"a\": 1,\n}").unwrap_err();
        assert_eq!((e.line, e.why.as_str()), (3, "trailing comma"));
    }

    #[test]
    fn deep_nesting_is_a_syntax_error_not_a_crash() {
        let text = "[".repeat(100_000);
        assert!(parse(&text).unwrap_err().why.contains("recursion limit"));
    }

    #[test]
    fn a_pointer_into_nothing_gives_the_nearest_parent() {
        let root = parse("{\"a/b\": {\"c\": 1}}").unwrap();
        assert_eq!(root.nearest_to("/a~1b/zzz").at, root.nearest_to("/a~1b").at);
    }
}
