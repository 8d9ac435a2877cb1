//! The values of a refusal by name, for programs that match on them.
//!
//! Invariant: keys only grow, and all that is said fits the header it travels in.

use std::collections::BTreeMap;
use std::fmt::Display;

use super::text::{brief, near};

/// Entries of a list, and fields, that are named.
pub(super) const MOST: usize = 100;

/// Metadata as a row makes it: [`put`] or [`ends`], then what else there is.
#[derive(Default)]
pub(super) struct Metadata(pub(super) BTreeMap<String, String>);

pub(super) fn put(key: &str, value: impl Display) -> Metadata {
    Metadata::default().put(key, value)
}

/// The two ends of a connection.
pub(super) fn ends(client: impl Display, server: impl Display) -> Metadata {
    Metadata::default().ends(client, server)
}

impl Metadata {
    pub(super) fn put(mut self, key: &str, value: impl Display) -> Metadata {
        self.0.insert(key.to_owned(), brief(&value.to_string()).into_owned());
        self
    }

    pub(super) fn put_unless_empty(self, key: &str, value: &str) -> Metadata {
        if value.is_empty() { self } else { self.put(key, value) }
    }

    /// The first [`MOST`]: an answer must fit the header it travels in.
    pub(super) fn list<T: Display>(mut self, key: &str, items: &[T]) -> Metadata {
        let items: Vec<String> = items.iter().take(MOST).map(ToString::to_string).collect();
        if !items.is_empty() {
            self.0.insert(key.to_owned(), items.join(","));
        }
        self
    }

    /// The names there are, and the nearest of them to what was asked for.
    pub(super) fn known<T: Display>(self, wanted: &str, known: &[T]) -> Metadata {
        let names = self.list("known", known);
        match near(wanted, known) {
            Some(nearest) => names.put("nearest", nearest),
            None => names,
        }
    }

    pub(super) fn ends(self, client: impl Display, server: impl Display) -> Metadata {
        self.put("client", client).put("server", server)
    }
}
