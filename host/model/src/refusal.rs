//! Why a request is refused: values, not sentences; sentences, codes and help are made from them in one
//! place.
//!
//! A refusal is one row in the file of its group, with a place in [docs/errors.md] made of its example:
//!
//! ```text
//! /// The name is held by a process that answers.
//! ProcessExists { process: Name, endpoint: String, pid: u32 } => {
//!     code: AlreadyExists, reason: "PROCESS_EXISTS",
//!     sentence: format!("the name `{process}` is taken by a process that answers (pid {pid})"),
//!     help: format!("Use the one that runs, or end it first (`kill {pid}`)."),
//!     metadata: put("process", process).put("endpoint", endpoint).put("pid", pid),
//!     example: ProcessExists { process: name("host"), endpoint: "127.0.0.1:50551".into(), pid: 4242 },
//! }
//! ```
//!
//! Sentence, help, metadata and, where fields of the request are to blame, `violations: […]` before the
//! example are Rust expressions that see the fields by name. The names they use are imported below.
//!
//! Invariant: the sentence says what was asked, what is wrong and what exists; doing what the help says
//! helps, and its commands in backticks can be typed (`host/cli/tests/cli_surface.rs`,
//! `tests/it/control_plane/helps.rs`). Reasons and metadata keys only grow; clients match on them.
//!
//! [docs/errors.md]: ../../../docs/errors.md

mod code;
mod examples;
mod help;
mod metadata;
mod page;
mod text;
mod values;

// Macros are seen below their definition only: the table, then the rows in the order of the page.
#[macro_use]
mod table;
#[macro_use]
mod naming;
#[macro_use]
mod connecting;
#[macro_use]
mod changing;
#[macro_use]
mod calling;

use std::collections::BTreeMap;
use std::{fmt, iter};

use serde_json::Value;

pub use code::Code;
pub use page::errors_markdown;
pub use text::brief;
pub(crate) use text::{ADAPTABLE, duration, scattered};

use crate::{
    ComponentId, MemberId, Name, PortId, ProcessState, State, StopReason, Tag, Verb, Violation, allowed,
};
use help::{activate, argument_help, by_hand};
use metadata::{Metadata, ends, put};
use text::{choices, clauses, is_are, list, route, unless_empty, unless_none, without_file};
use values::Travels;

// Each group hands its rows on to the next one, and the last one all of them to the table.
naming! { connecting changing calling refusals; }

impl std::error::Error for Refusal {}

impl Refusal {
    /// A process that does not answer, of which nothing more is known.
    pub fn lost(process: Name) -> Refusal {
        Refusal::ProcessLost { process, state: ProcessState::Lost, last_exit: String::new() }
    }
}
