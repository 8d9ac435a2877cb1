//! The plugin guide and its reference show no Rust that is not compiled: each block stands in a source of
//! this repository.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

const PAGES: [&str; 2] = ["docs/PLUGIN_GUIDE.md", "docs/PLUGIN_REFERENCE.md"];

/// Compiled files that the pages may quote.
const SOURCES: [&str; 9] = [
    "plugins/filters/src/low_pass.rs",
    "plugins/filters/src/low_pass/tests.rs",
    "plugins/example/src/server.rs",
    "sdk/rust/tests/guide_examples.rs",
    "sdk/rust/tests/guide_devices.rs",
    "sdk/rust/tests/guide_members.rs",
    "sdk/rust/tests/guide_motion.rs",
    "sdk/rust/tests/guide_simulated.rs",
    "tests/it/plugin_guide/embedded.rs",
];

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn text(path: &str) -> String {
    let path = repository().join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The fenced blocks of one language.
fn blocks<'a>(markdown: &'a str, language: &str) -> Vec<&'a str> {
    let fence = format!("```{language}\n");
    markdown.split(&fence).skip(1).map(|rest| rest.split("\n```").next().unwrap()).collect()
}

#[test]
fn every_rust_block_of_the_pages_is_a_piece_of_a_compiled_file() {
    let sources: Vec<String> = SOURCES.iter().map(|path| text(path)).collect();
    for page in PAGES {
        let page_text = text(page);
        let found = blocks(&page_text, "rust");
        assert!(!found.is_empty(), "{page} shows no Rust");
        for block in found {
            assert!(
                sources.iter().any(|s| s.contains(block)),
                "this block of {page} is in none of {SOURCES:?}; copy the present source:\n{block}"
            );
        }
    }
}

#[test]
fn the_sample_component_fits_on_one_screen() {
    let sample = text("plugins/filters/src/low_pass.rs");
    let lines = sample.lines().filter(|l| !l.trim().is_empty()).count();
    assert!(lines < 40, "the sample has {lines} lines: the SDK asks too much of authors");
}

#[test]
fn the_template_has_all_its_places_and_only_known_ones() {
    let files = ["sdk/templates/filter/Cargo.toml", "sdk/templates/filter/src/lib.rs"].map(text).concat();
    let known = ["name", "crate", "Name", "sdk"];
    let used: Vec<&str> = files.split("{{").skip(1).map(|rest| rest.split("}}").next().unwrap()).collect();
    for place in known {
        assert!(used.contains(&place), "the template does not use the place {place}");
    }
    for place in used {
        assert!(known.contains(&place), "the template has an unknown place {place}");
    }
}
