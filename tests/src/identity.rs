//! Identities of hosts, for tests and benchmarks whose processes are as on several machines.

use std::path::Path;

use trocar_net::{Authority, Role, Wish};

/// Issues the identity of a host, for a day, into this file.
///
/// # Panics
/// The authority refuses, or the file cannot be written.
pub fn issue_host(authority: &mut Authority, name: &str, processes: &[&str], file: &Path) {
    let wish = Wish {
        name: name.into(),
        role: Role::Host,
        processes: processes.iter().map(|process| (*process).into()).collect(),
        addresses: Vec::new(),
        days: 1,
    };
    authority.issue(&wish, file).unwrap_or_else(|e| panic!("no identity for {name}: {e}"));
}
