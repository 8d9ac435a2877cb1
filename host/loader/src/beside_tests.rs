//! The libraries a plugin brings, from hand-made search paths.
#![allow(clippy::unwrap_used)]

use super::*;

/// Tells whether a library with these search paths looks beside itself.
fn asked_for(rpaths: &[&'static str], runpaths: &[&'static str], inherited: bool) -> Result<bool, Fault> {
    let (rpaths, runpaths) = (rpaths.to_vec(), runpaths.to_vec());
    let elf = Elf { needed: vec!["libvendor.so.1"], rpaths, runpaths, ..Elf::default() };
    Ok(wants(&elf, None, inherited)?[0].is_beside)
}

#[test]
fn a_library_is_looked_for_beside_by_the_rules_of_the_dynamic_linker() {
    assert_eq!(asked_for(&[], &["$ORIGIN"], false), Ok(true));
    assert_eq!(asked_for(&["${ORIGIN}/"], &[], false), Ok(true));
    assert_eq!(asked_for(&["$ORIGIN:$ORIGIN"], &[""], false), Ok(false), "a DT_RUNPATH hides the DT_RPATH");
    assert_eq!(asked_for(&[], &[], true), Ok(true), "the DT_RPATH of who needs it counts");
    assert_eq!(asked_for(&[], &["$ORIGIN"], true), Ok(true));
    assert_eq!(asked_for(&[], &[], false), Ok(false));
}

#[test]
fn any_other_directory_is_refused_and_so_is_an_empty_one() {
    for path in ["/opt/vendor/lib", "$ORIGIN/lib", "$ORIGIN:/opt", "$ORIGIN/../lib", "lib", "$LIB"] {
        let last = path.split(':').next_back().unwrap();
        assert_eq!(asked_for(&[], &[path], false), Err(Fault::RunPath { path: last.into() }));
    }
    let working_directory = asked_for(&["$ORIGIN:"], &[], false).unwrap_err();
    assert!(working_directory.to_string().contains("working directory"), "{working_directory}");
}
