//! A thousand random interleavings of changes and calls, by seed.
//!
//! Promise: whatever is asked in whatever order, every call has one outcome, counts add up, desired is observed, and
//! nothing is left behind. `TROCAR_SEED=n` plays one seed alone, `TROCAR_SEEDS=5` five times as many.

use trocar_tests::conformance::{Language, random};

#[test]
fn interleavings_of_linked_classes_leave_the_books_in_order() {
    random::interleave(Language::Linked, 1..501);
}

#[test]
fn interleavings_of_rust_plugins_leave_the_books_in_order() {
    random::interleave(Language::Rust, 501..751);
}

#[test]
fn interleavings_of_cpp_plugins_leave_the_books_in_order() {
    random::interleave(Language::Cpp, 751..1001);
}
