//! Reads typed values out of positioned JSON and words the refusals.
//!
//! Invariant: every refusal names the place of the value it is about, what was found and what is accepted.
//! One problem hides no other: the reader of a part notes it in [`Found`] and goes on with the next.

use std::cell::RefCell;
use std::collections::HashMap;

use trocar_model::nearest;

use super::problem::{Problem, join};
use super::scan::{Key, Kind, Node, line_column, parse};

/// Keys of this name are comments, anywhere.
pub(crate) const COMMENT: &str = "//";

/// A parsed text with the name people know it by.
#[derive(Clone, Debug)]
pub(super) struct Document {
    pub(super) file: String,
    pub(super) text: String,
    pub(super) root: Node,
}

impl Document {
    pub(super) fn parse(file: &str, text: String) -> Result<Self, Problem> {
        let root = parse(&text).map_err(|e| Problem {
            file: file.to_owned(),
            line: e.line,
            column: e.column,
            pointer: String::new(),
            what: format!("not JSON: {}", e.why),
            help: syntax_help(&text, e.line),
        })?;
        Ok(Self { file: file.to_owned(), text, root })
    }

    pub(super) fn problem(&self, at: usize, pointer: &str, what: String, help: String) -> Problem {
        let (line, column) = line_column(&self.text, at);
        Problem { file: self.file.clone(), line, column, pointer: pointer.to_owned(), what, help }
    }

    pub(super) fn cursor(&self) -> Cursor<'_> {
        Cursor { doc: self, node: &self.root, pointer: String::new() }
    }
}

fn syntax_help(text: &str, line: usize) -> String {
    let line = text.lines().nth(line.saturating_sub(1)).unwrap_or("");
    if text.starts_with('\u{feff}') {
        "save the file as UTF-8 without a byte order mark".to_owned()
    } else if line.trim_start().starts_with("//") || line.contains("/*") || line.trim_start().starts_with('#')
    {
        "JSON has no comments: write \"//\": \"…\" as a key of an object".to_owned()
    } else if text.trim().is_empty() {
        "the file is empty; `trocar schema system` prints what belongs in it".to_owned()
    } else {
        "correct the JSON at this place (strict JSON: double quotes, no trailing commas)".to_owned()
    }
}

/// Most problems that are listed: each costs a walk to its place.
pub(super) const MOST: usize = 100;

/// The problems of a document that were met, [`MOST`] at most.
#[derive(Debug, Default)]
pub(super) struct Found(RefCell<Vec<Problem>>);

impl Found {
    pub(super) fn note(&self, problem: Problem) {
        if !self.is_full() {
            self.0.borrow_mut().push(problem);
        }
    }

    /// Tells whether no more problems are listed: the rest is then read for nothing.
    pub(super) fn is_full(&self) -> bool {
        self.count() >= MOST
    }

    /// The value that was read; `None` where that is a problem.
    pub(super) fn take<T>(&self, read: Result<T, Problem>) -> Option<T> {
        read.map_err(|problem| self.note(problem)).ok()
    }

    /// The same of a part that may be left out; a problem counts as left out.
    pub(super) fn may<T>(&self, read: Option<Result<T, Problem>>) -> Option<T> {
        self.take(read.transpose()).flatten()
    }

    /// Returns the problems in the order of the file.
    pub(super) fn all(self) -> Vec<Problem> {
        let mut all = self.0.into_inner();
        all.sort_by_key(|problem| (problem.line, problem.column));
        all
    }

    /// Returns the number of problems. It rises where a part that was read meanwhile is wrong, as long as
    /// problems are listed.
    pub(super) fn count(&self) -> usize {
        self.0.borrow().len()
    }
}

/// One value of a document and the pointer to it.
#[derive(Clone, Debug)]
pub(super) struct Cursor<'a> {
    doc: &'a Document,
    pub(super) node: &'a Node,
    pub(super) pointer: String,
}

impl<'a> Cursor<'a> {
    pub(super) fn problem(&self, what: impl Into<String>, help: impl Into<String>) -> Problem {
        self.doc.problem(self.node.at, &self.pointer, what.into(), help.into())
    }

    /// A problem placed at a key instead of its value.
    pub(super) fn key_problem(&self, key: &Key, what: impl Into<String>, help: impl Into<String>) -> Problem {
        self.doc.problem(key.at, &join(&self.pointer, &key.text), what.into(), help.into())
    }

    fn wanted(&self, wanted: &str) -> Problem {
        self.problem(
            format!("expected {wanted}, found {}", self.node.describe()),
            format!("write {wanted} here"),
        )
    }

    /// The entries of a map whose keys the user chooses; duplicates are noted, comments left out.
    pub(super) fn entries(&self, what: &str, found: &Found) -> Vec<(&'a Key, Cursor<'a>)> {
        let Kind::Object(fields) = &self.node.kind else {
            found.note(self.wanted(&format!("{what} (an object)")));
            return Vec::new();
        };
        let mut entries: Vec<(&Key, Cursor<'_>)> = Vec::with_capacity(fields.len());
        let mut places = HashMap::with_capacity(fields.len());
        for (key, node) in fields.iter().filter(|(k, _)| k.text != COMMENT).take_while(|_| !found.is_full()) {
            let first = *places.entry(key.text.as_str()).or_insert(key.at);
            if first == key.at {
                entries.push((key, Cursor { doc: self.doc, node, pointer: join(&self.pointer, &key.text) }));
                continue;
            }
            let (line, column) = line_column(&self.doc.text, first);
            found.note(self.key_problem(
                key,
                format!("duplicate key {:?}: it is already at line {line}, column {column}", key.text),
                "keep one of the two",
            ));
        }
        entries
    }

    /// The fields of an object that has only these keys; others are noted.
    pub(super) fn fields(&self, what: &str, known: &[&str], found: &Found) -> Fields<'a> {
        let mut entries = self.entries(what, found);
        let mut meant = Vec::new();
        entries.retain(|(key, _)| {
            let is_known = known.contains(&key.text.as_str());
            if !is_known && !found.is_full() {
                meant.extend(nearest(&key.text, known.iter().copied()).map(str::to_owned));
                found.note(self.key_problem(
                    key,
                    format!("unknown key {:?} in {what}", key.text),
                    did_you_mean(&key.text, known.iter().copied()),
                ));
            }
            is_known
        });
        let is_object = matches!(self.node.kind, Kind::Object(_));
        Fields { parent: self.clone(), what: what.to_owned(), is_object, meant, entries }
    }

    pub(super) fn text(&self) -> Result<&'a str, Problem> {
        match &self.node.kind {
            Kind::Text(t) => Ok(t),
            _ => Err(self.wanted("a text in double quotes")),
        }
    }

    pub(super) fn flag(&self) -> Result<bool, Problem> {
        match &self.node.kind {
            Kind::Bool(b) => Ok(*b),
            _ => Err(self.wanted("true or false")),
        }
    }

    pub(super) fn list(&self) -> Result<Vec<Cursor<'a>>, Problem> {
        let Kind::List(items) = &self.node.kind else { return Err(self.wanted("a list")) };
        let item = |(i, node)| Cursor { doc: self.doc, node, pointer: format!("{}/{i}", self.pointer) };
        Ok(items.iter().enumerate().map(item).collect())
    }

    /// A number above 0 (`unit` is for the message).
    pub(super) fn positive(&self, unit: &str) -> Result<f64, Problem> {
        match &self.node.kind {
            Kind::Number(n) if n.as_f64().is_some_and(|n| n > 0.0 && n.is_finite()) => {
                Ok(n.as_f64().unwrap_or(0.0))
            }
            _ => Err(self.wanted(&format!("a number above 0 {unit}"))),
        }
    }

    /// A number from 0 (`unit` is for the message).
    pub(super) fn not_negative(&self, unit: &str) -> Result<f64, Problem> {
        match &self.node.kind {
            Kind::Number(n) if n.as_f64().is_some_and(|n| n >= 0.0 && n.is_finite()) => {
                Ok(n.as_f64().unwrap_or(0.0))
            }
            _ => Err(self.wanted(&format!("a number from 0 {unit}"))),
        }
    }

    pub(super) fn whole(&self, min: u64, max: u64, what: &str) -> Result<u64, Problem> {
        match &self.node.kind {
            Kind::Number(n) if n.as_u64().is_some_and(|n| (min..=max).contains(&n)) => {
                Ok(n.as_u64().unwrap_or(min))
            }
            _ => Err(self.wanted(&format!("{what}, a whole number from {min} to {max}"))),
        }
    }

    pub(super) fn one_of<T: Copy>(&self, choices: &[(&str, T)]) -> Result<T, Problem> {
        let text = self.text()?;
        choices.iter().find(|(name, _)| *name == text).map(|(_, value)| *value).ok_or_else(|| {
            self.problem(
                format!("{text:?} is not a choice here"),
                did_you_mean(text, choices.iter().map(|(n, _)| *n)),
            )
        })
    }

    /// A value that has its own parser, whose refusal becomes the problem.
    pub(super) fn parsed<T, E: std::fmt::Display>(
        &self,
        parse: impl FnOnce(&str) -> Result<T, E>,
        help: &str,
    ) -> Result<T, Problem> {
        parse(self.text()?).map_err(|e| self.problem(e.to_string(), help))
    }
}

/// The fields of one object.
pub(super) struct Fields<'a> {
    parent: Cursor<'a>,
    what: String,
    /// False: that was noted, and no field of it can be missed.
    is_object: bool,
    /// Keys that others, which are unknown, seem to mean.
    meant: Vec<String>,
    entries: Vec<(&'a Key, Cursor<'a>)>,
}

impl<'a> Fields<'a> {
    pub(super) fn get(&self, key: &str) -> Option<&Cursor<'a>> {
        self.entries.iter().find(|(k, _)| k.text == key).map(|(_, v)| v)
    }

    /// A field without which there is nothing to be done; noted where it is missing.
    pub(super) fn need(&self, key: &str, found: &Found) -> Option<&Cursor<'a>> {
        let there = self.get(key);
        if there.is_none() && self.is_object && !self.meant.iter().any(|meant| meant == key) {
            found.note(self.parent.problem(
                format!("{} has no {key:?}", self.what),
                format!("add {key:?} (see `trocar schema system`)"),
            ));
        }
        there
    }

    /// Notes the second of two keys that say the same thing.
    pub(super) fn not_both(&self, one: &str, other: &str, found: &Found) {
        if let (Some(_), Some(second)) = (self.get(one), self.get(other)) {
            found.note(
                second.problem(format!("{one:?} and {other:?} exclude each other"), "keep one of the two"),
            );
        }
    }
}

/// "did you mean …? known: …".
pub(super) fn did_you_mean<'k>(asked: &str, known: impl Iterator<Item = &'k str> + Clone) -> String {
    let list = known.clone().collect::<Vec<_>>().join(", ");
    match nearest(asked, known) {
        Some(near) => format!("did you mean {near:?}? accepted: {list}"),
        None => format!("accepted: {list}"),
    }
}
