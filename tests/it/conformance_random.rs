//! Two hundred random interleavings of changes and calls for each language, by seed; and as many between two
//! processes.
//!
//! Promise: whatever is asked in whatever order, every call has one outcome, counts add up, desired is
//! observed, and nothing is left behind. `TROCAR_SEED=n` plays one seed alone, `TROCAR_SEEDS=5` five times as
//! many, as `./tests/run --all` does.

use trocar_tests::conformance::random::{self, Servers};
use trocar_tests::conformance::{Language, Languages};

const CPP_CALLS_RUST: Languages = Languages { client: Language::Cpp, server: Language::Rust };

/// One test for each language, which knows its own name: it plays its seeds in several processes.
macro_rules! interleavings {
    ($($name:ident: $languages:expr, $servers:ident, $seeds:expr;)+) => {$(
        #[test]
        fn $name() {
            let test = concat!("conformance_random::", stringify!($name));
            random::interleave($languages, Servers::$servers, $seeds, test);
        }
    )+};
}

interleavings! {
    interleavings_of_linked_classes_leave_the_books_in_order: Language::Linked, Near, 1..201;
    interleavings_of_rust_plugins_leave_the_books_in_order: Language::Rust, Near, 201..401;
    interleavings_of_cpp_plugins_leave_the_books_in_order: Language::Cpp, Near, 401..601;
    interleavings_of_rust_plugins_in_two_processes_leave_the_books_in_order: Language::Rust, Remote, 601..701;
    interleavings_of_cpp_plugins_that_call_rust_in_two_processes_leave_the_books_in_order: CPP_CALLS_RUST, Remote, 701..801;
}
