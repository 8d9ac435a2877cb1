//! End of a subcommand: exit code, reason code, one clear sentence, help; the same content for people
//! and for scripts.
//!
//! Invariant: this file alone prints failures; with `--json` stdout holds exactly one JSON object about it.

use std::collections::BTreeMap;

use serde_json::json;
use trocar_model::Refusal;

pub(super) use super::exit::Exit;
use super::{out, style};
use trocar::system_file::Problem;

/// Result of a subcommand.
pub(super) type Done = Result<Exit, Failure>;

/// Why a subcommand did not succeed.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Failure {
    pub(super) exit: Exit,
    /// gRPC status code by name, e.g. "NOT_FOUND".
    pub(super) code: String,
    /// Reason code of the error table, or one of the program's own: USAGE, SYSTEM_FILE, IO, NO_GCM …
    pub(super) reason: String,
    pub(super) message: String,
    pub(super) help: String,
    pub(super) metadata: BTreeMap<String, String>,
}

const STANDS_STILL: &str = "its process stands still or gets no processor: `ps -C trocar -o pid,stat,args` shows it (a T in STAT is stopped, \
                            `kill -CONT PID` lets it go on)";

impl Failure {
    fn new(
        exit: Exit,
        code: &str,
        reason: &str,
        message: impl Into<String>,
        help: impl Into<String>,
    ) -> Self {
        Self {
            exit,
            code: code.to_owned(),
            reason: reason.to_owned(),
            message: message.into(),
            help: help.into(),
            metadata: BTreeMap::new(),
        }
    }

    /// Wrong flags or arguments.
    pub(super) fn usage(message: impl Into<String>, help: impl Into<String>) -> Self {
        Self::new(Exit::Usage, "INVALID_ARGUMENT", "USAGE", message, help)
    }

    /// Something of this machine: a file, a directory, a port.
    pub(super) fn local(reason: &str, message: impl Into<String>, help: impl Into<String>) -> Self {
        Self::new(Exit::Refused, "FAILED_PRECONDITION", reason, message, help)
    }

    /// Something that is not there, found out without asking.
    pub(super) fn refused(reason: &str, message: impl Into<String>, help: impl Into<String>) -> Self {
        Self::new(Exit::Refused, "NOT_FOUND", reason, message, help)
    }

    /// Failure of a call when no GCM answers at `addr`.
    pub(super) fn no_gcm(addr: &str, why: &str) -> Self {
        let help = if addr.contains("https://") {
            "see that it runs with --listen-tls at that address, and that both certificates are of one authority and valid: \
             `trocar ca ls`"
        } else {
            "start one (`trocar demo`, `trocar run FILE`, `trocar host`), or name its address: --gcm ADDR or TROCAR_GCM"
        };
        Self::new(Exit::NoGcm, "UNAVAILABLE", "NO_GCM", format!("no GCM answers at {addr}: {why}"), help)
    }

    /// Something listens at `addr` and says nothing, as a process does that was stopped.
    pub(super) fn silent(addr: &str) -> Self {
        Self::new(
            Exit::NoGcm,
            "UNAVAILABLE",
            "NO_GCM",
            format!("the GCM at {addr} does not answer: it takes connections, and has said nothing for 10 s"),
            STANDS_STILL,
        )
    }

    /// A call was given a time here, and has no answer by then.
    pub(super) fn late(addr: &str) -> Self {
        Self::new(
            Exit::TimedOut,
            "DEADLINE_EXCEEDED",
            "NO_ANSWER",
            format!("the GCM at {addr} did not answer in the time that it was given"),
            STANDS_STILL,
        )
    }

    /// A failure from a gRPC answer.
    pub(super) fn answered(
        code: &str,
        reason: &str,
        message: String,
        help: String,
        metadata: BTreeMap<String, String>,
    ) -> Self {
        let exit = if code == "DEADLINE_EXCEEDED" { Exit::TimedOut } else { Exit::Refused };
        Self { metadata, ..Self::new(exit, code, reason, message, help) }
    }

    /// Led back to its place in a system file.
    pub(super) fn at(mut self, place: &Problem) -> Self {
        self.message = format!("{}:{}:{}: {}", place.file, place.line, place.column, self.message);
        self.help.clone_from(&place.help);
        let (line, column) = (place.line.to_string(), place.column.to_string());
        for (key, value) in
            [("file", &place.file), ("line", &line), ("column", &column), ("pointer", &place.pointer)]
        {
            self.metadata.insert(key.to_owned(), value.clone());
        }
        self
    }

    /// Prints it: a sentence and a "help:" line on stderr, or one JSON object on stdout.
    pub(super) fn print(&self, json: bool) {
        if json {
            out::line(&out::json(&self.to_json().to_string()));
            return;
        }
        let (red, green, reset) = style::error_colours();
        let message = out::paragraph(self.message.trim_end());
        eprintln!("{red}error:{reset} {message}");
        if !self.help.is_empty() {
            eprintln!(" {green}help:{reset} {}", out::paragraph(&self.help));
        }
    }

    pub(super) fn to_json(&self) -> serde_json::Value {
        json!({
            "code": self.code,
            "reason": self.reason,
            "message": self.message,
            "help": self.help,
            "metadata": self.metadata,
        })
    }
}

impl From<&Refusal> for Failure {
    fn from(refusal: &Refusal) -> Self {
        let code = refusal.code().name();
        Self::answered(code, refusal.reason(), refusal.to_string(), refusal.help(), refusal.metadata())
    }
}

impl From<Refusal> for Failure {
    fn from(refusal: Refusal) -> Self {
        Self::from(&refusal)
    }
}

impl From<Problem> for Failure {
    fn from(problem: Problem) -> Self {
        let mut failure = Self::new(
            Exit::Refused,
            "INVALID_ARGUMENT",
            "SYSTEM_FILE",
            problem.to_string(),
            problem.help.clone(),
        );
        failure.metadata = BTreeMap::from([
            ("file".to_owned(), problem.file),
            ("line".to_owned(), problem.line.to_string()),
            ("column".to_owned(), problem.column.to_string()),
            ("pointer".to_owned(), problem.pointer),
        ]);
        failure
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_keeps_its_reason_and_exit_code() {
        let failure = Failure::from(Refusal::RevisionConflict { expected: 3, actual: 4 });
        assert_eq!((failure.exit, failure.reason.as_str()), (Exit::Refused, "REVISION_CONFLICT"));
        assert!(!failure.help.is_empty(), "a refusal without help leaves a person alone");
    }

    #[test]
    fn json_has_the_five_keys_a_script_needs() {
        let json = Failure::no_gcm("127.0.0.1:50551", "connection refused").to_json();
        let keys: Vec<&String> = json.as_object().map(|o| o.keys().collect()).unwrap_or_default();
        assert_eq!(keys, ["code", "help", "message", "metadata", "reason"]);
    }

    #[test]
    fn a_timeout_has_its_own_exit_code() {
        let failure = Failure::answered(
            "DEADLINE_EXCEEDED",
            "LCM_TIMEOUT",
            String::new(),
            String::new(),
            BTreeMap::new(),
        );
        assert_eq!(failure.exit as i32, 4);
    }
}
