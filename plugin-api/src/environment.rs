//! The environment this process was started with, without later changes by code in it: for programs that a
//! host or a component starts, which must not inherit what another component did.
//!
//! Invariant: the C library's own list is not read, which another thread may be changing.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::process::Command;

/// The file in which the kernel keeps it.
const STARTED_WITH: &str = "/proc/self/environ";

/// The variables at the start of this process; `None` where /proc is not to be read. Reads a file.
pub fn at_start() -> Option<Vec<(OsString, OsString)>> {
    std::fs::read(STARTED_WITH).ok().map(|bytes| parse(&bytes))
}

/// The value of one of them.
pub fn var_at_start(name: impl AsRef<OsStr>) -> Option<OsString> {
    match at_start() {
        Some(all) => all.into_iter().find(|(n, _)| n == name.as_ref()).map(|(_, value)| value),
        None => std::env::var_os(name),
    }
}

/// Lets a program be started with the environment of the start and nothing else.
pub fn give_to(program: &mut Command) {
    if let Some(all) = at_start() {
        program.env_clear().envs(all);
    }
}

fn parse(bytes: &[u8]) -> Vec<(OsString, OsString)> {
    let variables = bytes.split(|byte| *byte == 0).filter_map(|text| {
        // A name may begin with "=", as some shells have it.
        let equals = 1 + text.get(1..)?.iter().position(|byte| *byte == b'=')?;
        let (name, value) = (&text[..equals], &text[equals + 1..]);
        Some((OsStr::from_bytes(name).to_owned(), OsString::from_vec(value.to_vec())))
    });
    variables.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variables_are_told_from_values_with_signs_of_their_own_and_from_what_is_none() {
        let parsed = parse(b"A=1\0B=x=y\0EMPTY=\0nothing\0\0PATH=/bin:/usr/bin");
        let wanted = [("A", "1"), ("B", "x=y"), ("EMPTY", ""), ("PATH", "/bin:/usr/bin")];
        assert_eq!(parsed, wanted.map(|(name, value)| (name.into(), value.into())));
    }

    #[test]
    fn a_program_gets_what_this_process_was_started_with() {
        let mut program = Command::new("/usr/bin/env");
        program.env("TROCAR_TEST_SET_BEFORE", "1");
        give_to(&mut program);
        let said = program.output().map(|out| out.stdout).unwrap_or_default();
        let text = String::from_utf8_lossy(&said);
        assert!(!text.contains("TROCAR_TEST_SET_BEFORE"), "{text}");
        assert!(text.lines().any(|line| line.starts_with("PATH=")), "{text}");
        assert_eq!(var_at_start("PATH"), std::env::var_os("PATH"));
    }
}
