//! The page of errors, one example per refusal.

use std::fmt::Write as _;

use crate::Refusal;

/// `docs/errors.md`.
pub fn errors_markdown() -> String {
    let mut out = String::from(
        "# Errors\n\n\
         Generated from the refusals of `trocar-model`; a test compares (`TROCAR_BLESS=1 cargo test -p trocar-model` \
         writes it anew).\n\n\
         Every refusal reaches the caller as a gRPC status with the code below. Its sentence says what was asked, what \
         is wrong and what exists. Its details are an `ErrorInfo` (reason, domain `trocar.v1`, the values as metadata) \
         and, where a field is to blame, a `BadRequest`.\n\n\
         | reason | code | metadata |\n|---|---|---|\n",
    );
    let all = Refusal::examples();
    for r in &all {
        let keys: Vec<String> = r.metadata().into_keys().map(|k| format!("`{k}`")).collect();
        // Writing to a String cannot fail.
        let _ = writeln!(
            out,
            "| [{0}](#{1}) | {2} | {3} |",
            r.reason(),
            r.reason().to_lowercase(),
            r.code().name(),
            keys.join(" ")
        );
    }
    for r in &all {
        let _ = write!(out, "\n## {}\n\n> {r}\n\n{}\n", r.reason(), r.help());
    }
    out
}
