//! A thousand random interleavings of changes and calls for each language, by seed.
//!
//! Promise: whatever is asked in whatever order, every call has one outcome, counts add up, desired is observed, and
//! nothing is left behind. `TROCAR_SEED=n` plays one seed alone, `TROCAR_SEEDS=5` five times as many.

use trocar_tests::conformance::{Language, random};

/// One test for each language, which knows its own name: it plays its seeds in several processes.
macro_rules! interleavings {
    ($($name:ident: $language:ident, $seeds:expr;)+) => {$(
        #[test]
        fn $name() {
            let test = concat!("conformance_random::", stringify!($name));
            random::interleave(Language::$language, $seeds, test);
        }
    )+};
}

interleavings! {
    interleavings_of_linked_classes_leave_the_books_in_order: Linked, 1..1001;
    interleavings_of_rust_plugins_leave_the_books_in_order: Rust, 1001..2001;
    interleavings_of_cpp_plugins_leave_the_books_in_order: Cpp, 2001..3001;
}
