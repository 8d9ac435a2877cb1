//! The answers of the ELF reader on hand-made bytes that no compiler makes.
#![allow(clippy::unwrap_used)]

use super::*;

fn note(owner: &[u8], kind: u32, desc: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    for n in [owner.len() as u32, desc.len() as u32, kind] {
        out.extend(n.to_le_bytes());
    }
    for part in [owner, desc] {
        out.extend(part);
        out.resize(out.len().next_multiple_of(4), 0);
    }
    out
}

#[test]
fn the_manifest_is_found_behind_other_notes() {
    let mut bytes = note(b"GNU\0", 3, b"12345");
    bytes.extend(note(b"TROCAR\0", 2, b"not a manifest"));
    bytes.extend(note(b"TROCAR\0", 1, b"{}"));
    let mut found = Vec::new();
    collect_notes(&bytes, &mut found);
    assert_eq!(found, [b"{}"]);
}

#[test]
fn a_note_that_leaves_its_segment_ends_the_search() {
    let mut bytes = note(b"TROCAR\0", 1, b"{}");
    bytes[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
    let mut found = Vec::new();
    collect_notes(&bytes, &mut found);
    assert!(found.is_empty());
}

#[test]
fn the_own_machine_has_a_name_and_unknown_ones_keep_their_number() {
    assert_ne!(own_machine(), "unknown");
    let mut bytes = [0u8; 64];
    bytes[..7].copy_from_slice(b"\x7fELF\x02\x01\x01");
    bytes[18..20].copy_from_slice(&999u16.to_le_bytes());
    let fault = Elf::parse(&bytes).unwrap_err();
    assert!(matches!(fault, Fault::WrongMachine { built_for, .. } if built_for == "machine 999"));
}

#[test]
fn a_32_bit_library_is_named_as_such() {
    let mut bytes = [0u8; 64];
    bytes[..7].copy_from_slice(b"\x7fELF\x01\x01\x01");
    bytes[18] = 3;
    let fault = Elf::parse(&bytes).unwrap_err();
    assert!(fault.to_string().contains("built for 32-bit x86"), "{fault}");
}

#[test]
fn an_elf_file_with_nothing_in_it_is_damaged() {
    let mut bytes = [0u8; 64];
    bytes[..7].copy_from_slice(b"\x7fELF\x02\x01\x01");
    bytes[16] = 3;
    bytes[18..20].copy_from_slice(&OWN_MACHINE.to_le_bytes());
    bytes[20] = 1;
    assert!(matches!(Elf::parse(&bytes), Err(Fault::Malformed { .. })));
}

#[test]
fn constants_of_the_cpp_library_are_told_from_the_plugins_own() {
    for std in [
        "_ZZNSt8__detail18__to_chars_10_implIjEEvPcjT_E8__digits",
        "_ZNSt12_GLOBAL_E",
        "_ZSt4cout",
        "_ZGVZNSt6chrono3fooEvE1x",
        "_ZN9__gnu_cxx5__ops1xE",
    ] {
        assert!(is_of_std(std), "{std}");
    }
    for own in ["_ZN4Mine5countE", "_ZZ4namevE1x", "_ZGVZN4Mine3getEvE1x", "St", ""] {
        assert!(!is_of_std(own), "{own}");
    }
}
