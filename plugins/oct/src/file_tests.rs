//! Raw files on the bench: what they give, and every way they can be wrong.
#![allow(clippy::unwrap_used)]

use super::*;
use std::path::PathBuf;
use tempfile::TempDir;
use trocar_sdk::testing::{Bench, assert_implements, contracts};

/// Three frames of two lines of 64 pixels; every count names its line.
fn file(dir: &TempDir, bytes: usize) -> PathBuf {
    let path = dir.path().join("raw.u16");
    let all: Vec<u8> = (0..768usize).flat_map(|at| (at as u16 / 64 / 2 * 10).to_le_bytes()).collect();
    std::fs::write(&path, &all[..bytes]).unwrap();
    path
}

fn config(path: &std::path::Path, more: &str) -> String {
    let path = trocar_sdk::serde_json::json!(path);
    format!(r#"{{"path": {path}, "samples": 64, "ascans": 2{more}}}"#)
}

#[test]
fn lines_come_in_their_order_and_begin_again() {
    let dir = TempDir::new().unwrap();
    let mut bench = Bench::<OctFile>::new(config(&file(&dir, 768), ""));
    assert_eq!(bench.state().lines, 6);
    bench.step(2);
    let frames = bench.frames::<SpectraHeader>("spectra");
    assert_eq!(
        frames.iter().map(|f| (f.0.index, f.0.lines, f.1.len())).collect::<Vec<_>>(),
        [(0, 4, 512), (4, 4, 512)]
    );
    let first = |bytes: &[u8], line: usize| u16::from_ne_bytes([bytes[128 * line], bytes[128 * line + 1]]);
    let lines: Vec<u16> = frames.iter().flat_map(|f| (0..4).map(|l| first(&f.1, l))).collect();
    assert_eq!(lines, [0, 0, 10, 10, 20, 20, 0, 0]);
    bench.assert_no_alloc(|bench| bench.step(10));
}

#[test]
fn without_repeat_nothing_comes_after_the_last_line_and_nothing_counts_as_lost() {
    let dir = TempDir::new().unwrap();
    let mut bench = Bench::<OctFile>::new(config(&file(&dir, 768), r#", "repeat": false"#));
    bench.step(50);
    let lines: Vec<_> =
        bench.frames::<SpectraHeader>("spectra").iter().map(|f| (f.0.index, f.0.lines)).collect();
    assert_eq!((lines, bench.state().lost), (vec![(0, 4), (4, 2)], 0));
}

#[test]
fn every_wrong_length_is_refused_with_what_is_there_and_what_a_frame_takes() {
    let dir = TempDir::new().unwrap();
    for bytes in [1, 2, 127, 128, 255, 257, 511, 767] {
        let path = file(&dir, bytes);
        let refused = Bench::<OctFile>::created().configure(config(&path, "")).unwrap_err().reason;
        let wanted = format!(
            "{bytes} B are no frames of 2 lines of 64 u16, 256 B each ({} B are left over)",
            bytes % 256
        );
        assert!(refused.starts_with("path: ") && refused.contains(&wanted), "{refused}");
    }
    for bytes in [256, 512, 768] {
        let path = file(&dir, bytes);
        assert_eq!(Bench::<OctFile>::ready(config(&path, "")).state().lines, bytes as u64 / 128);
    }
}

#[test]
fn a_missing_file_a_folder_and_counts_beyond_their_bits_are_refused() {
    let dir = TempDir::new().unwrap();
    let refused = |path: &std::path::Path, more: &str| {
        Bench::<OctFile>::created().configure(config(path, more)).unwrap_err().reason
    };
    assert!(refused(&dir.path().join("no"), "").contains("cannot be read"));
    assert!(refused(dir.path(), "").contains("is no regular file"));
    assert!(refused(&file(&dir, 0), "").ends_with("raw.u16: is empty; name a file of raw spectra"));
    let path = file(&dir, 768);
    let said = refused(&path, r#", "bits": 4"#);
    assert!(said.contains("count 256 is 20, more than 4 bits hold"), "{said}");
    assert_eq!(
        Bench::<OctFile>::created().configure("{}").unwrap_err().reason,
        "path: is required and has no default"
    );
}

#[test]
fn the_file_fulfils_the_contract_of_spectrometers() {
    assert_implements::<OctFile>(&contracts::SPECTROMETER);
}
