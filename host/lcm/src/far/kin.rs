//! Checks whether the code of a server's class is in the process of its client, too.
//!
//! Invariant: nothing is loaded for it. An isolated process keeps out the code from which it was isolated; a
//! process that has the code already trusts it with its own components.

use std::os::unix::fs::MetadataExt;

use trocar_model::ClassInfo;

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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use trocar_model::{Ports, Safety};

    use super::super::super::boundary::fake::class;
    use super::*;

    #[test]
    fn the_same_class_of_another_file_is_other_code() {
        let linked = class(Ports::default(), Safety::None);
        let of_file = ClassInfo { hash: "ab".into(), ..linked.clone() };
        let of_other = ClassInfo { hash: "cd".into(), ..linked.clone() };
        let codes = [&linked, &of_file, &of_other].map(|class| code_of(class).unwrap());
        assert!(codes[0].contains("of program"), "{codes:?}");
        assert!(codes[0] != codes[1] && codes[1] != codes[2], "{codes:?}");
        assert_eq!(codes[1], "fakes/fake ab");
    }
}
