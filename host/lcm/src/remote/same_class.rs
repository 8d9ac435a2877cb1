//! Checks whether the code of a server's class is in the process of its client, too: then the client sees its
//! rows.
//!
//! Invariant: nothing is loaded for it. An isolated process keeps out the code from which it was isolated; a
//! process that has the code already trusts it with its own components.

use std::os::fd::OwnedFd;
use std::os::unix::fs::MetadataExt;
use std::sync::Arc;

use trocar_model::ClassInfo;

use super::super::core::ShownRows;
use super::half::Half;
use super::terms::of_rows;

/// Identifies the code of a class: the same text in two processes means the same code. `None` if it is
/// unknown.
pub(super) fn code_of(class: &ClassInfo) -> Option<String> {
    let name = class.full_name();
    if !class.hash.is_empty() {
        return Some(format!("{name} {}", class.hash));
    }
    // Linked into the program: the same where both run the very same file.
    let program = std::fs::metadata("/proc/self/exe").ok()?;
    let (place, size) = ((program.dev(), program.ino()), program.size());
    let written = (program.mtime(), program.mtime_nsec());
    Some(format!("{name} of program {place:?} {size} {written:?}"))
}

/// The rows of a half's component and their file, for a client whose process has this code of its class;
/// `None` for any other client, or if the rows cannot be had: then the client asks.
pub(super) fn rows_for(half: &Half, code: Option<String>) -> Option<(Arc<ShownRows>, OwnedFd)> {
    let server = &half.here.instance;
    let reads = half.terms(true).is_ok_and(|(_, terms)| terms.works_reads_out());
    if !reads || code.is_none() || code != code_of(&server.info) {
        return None;
    }
    let make = || {
        let (bytes, agreed) = of_rows(&server.info);
        ShownRows::create(bytes, agreed)
    };
    let rows = server.shown_rows().map_or_else(make, Ok).and_then(|rows| Ok((rows.clone(), rows.fd()?)));
    let stem = "its rows cannot be shown to other processes, so that their steps cannot call reads of it with an argument";
    rows.inspect_err(|e| server.warn_about(stem, &format!(": {e}"))).ok()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use trocar_model::{Ports, Safety};

    use super::super::super::boundary::puppet::class;
    use super::*;

    #[test]
    fn the_same_class_of_another_file_is_other_code() {
        let linked = class(Ports::default(), Safety::None);
        let of_file = ClassInfo { hash: "ab".into(), ..linked.clone() };
        let of_other = ClassInfo { hash: "cd".into(), ..linked.clone() };
        let codes = [&linked, &of_file, &of_other].map(|class| code_of(class).unwrap());
        assert!(codes[0].contains("of program"), "{codes:?}");
        assert!(codes[0] != codes[1] && codes[1] != codes[2], "{codes:?}");
        assert_eq!(codes[1], "puppets/puppet ab");
    }
}
