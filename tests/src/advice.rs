//! The help of a refusal, and following it.
//!
//! Invariant: a command is taken from the help itself: one that is not in it, or does not work, fails its
//! test.

use serde_json::Value;

use crate::{Failure, Output, Trocar};

/// Commands that only look, which any help may name.
const LOOKS: [&str; 7] = [
    "trocar ls",
    "trocar describe",
    "trocar plugin ls",
    "trocar logs",
    "trocar create --help",
    "trocar connect --help",
    "trocar schema",
];

/// The words of a refusal.
#[derive(Clone, Debug)]
pub struct Told {
    pub reason: String,
    pub message: String,
    pub help: String,
    pub values: Value,
}

impl Told {
    /// Over gRPC.
    #[must_use]
    pub fn by(refused: &Failure) -> Self {
        let find = |kind: &str| {
            let is_it = |d: &&Value| d["@type"].as_str().is_some_and(|t| t.ends_with(kind));
            refused.details.iter().find(is_it).cloned().unwrap_or_default()
        };
        let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
        Self {
            reason: refused.reason.clone(),
            message: refused.message.clone(),
            help: text(&find("google.rpc.Help")["links"][0]["description"]),
            values: find("google.rpc.ErrorInfo")["metadata"].clone(),
        }
    }

    /// By `trocar --json`.
    #[must_use]
    #[track_caller]
    pub fn on_the_terminal(refused: &Output) -> Self {
        let told = refused.json();
        let text = |key: &str| told[key].as_str().unwrap_or_default().to_owned();
        Self {
            reason: text("reason"),
            message: text("message"),
            help: text("help"),
            values: told["metadata"].clone(),
        }
    }

    /// A value of its metadata.
    ///
    /// # Panics
    /// When there is none of that name.
    #[must_use]
    #[track_caller]
    pub fn value(&self, key: &str) -> &str {
        self.values[key].as_str().unwrap_or_else(|| panic!("it tells no {key}: {self:#?}"))
    }

    /// The command of its help that begins so, its words in capitals replaced.
    ///
    /// # Panics
    /// When its help names no such command.
    #[must_use]
    #[track_caller]
    pub fn command(&self, begin: &str, words: &[(&str, &str)]) -> String {
        let all = in_backticks(&self.help);
        let found = all.iter().find(|c| c.starts_with(begin));
        let found = found.unwrap_or_else(|| panic!("no command `{begin}…` in the help: {self:#?}"));
        let put = |word: &str| {
            let value = words.iter().find(|(name, _)| *name == word);
            value.map_or_else(|| word.to_owned(), |(_, value)| (*value).to_owned())
        };
        found.split(' ').map(put).collect::<Vec<_>>().join(" ")
    }

    /// Types that command, which must succeed.
    #[track_caller]
    pub fn typed(&self, trocar: &Trocar, begin: &str, words: &[(&str, &str)]) -> Output {
        trocar.types(&self.command(begin, words)).ends_with(0)
    }

    /// Types every command of its help that only looks; each must succeed.
    #[track_caller]
    pub fn looked(&self, trocar: &Trocar) {
        let is_whole =
            |c: &str| !c.split(' ').any(|w| w.len() > 1 && w.chars().all(|c| c.is_ascii_uppercase()));
        for command in in_backticks(&self.help) {
            if LOOKS.iter().any(|look| command.starts_with(look)) && is_whole(&command) {
                trocar.types(&command).ends_with(0);
            }
        }
    }
}

/// The texts between backticks.
fn in_backticks(text: &str) -> Vec<String> {
    text.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}
