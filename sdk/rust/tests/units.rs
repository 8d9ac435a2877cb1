//! Every unit that compiles is one for the host, and nothing else is: two readers, one grammar.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use trocar_model::Unit;
use trocar_plugin_api::units;

#[track_caller]
fn agree(text: &str) {
    let (here, there) = (units::check(text), Unit::parse(text));
    assert_eq!(here.is_ok(), there.is_ok(), "{text:?}: the derive says {here:?}, the host {there:?}");
}

#[test]
fn both_know_the_same_short_symbols() {
    let letters: Vec<char> = ('a'..='z').chain('A'..='Z').chain("°µμΩ%1".chars()).collect();
    for a in &letters {
        agree(&a.to_string());
        for b in &letters {
            agree(&format!("{a}{b}"));
            for prefix in ["k", "m", "n", "µ", "h"] {
                agree(&format!("{prefix}{a}{b}"));
            }
        }
    }
}

#[test]
fn both_know_the_same_long_symbols_with_and_without_a_prefix() {
    let long = [
        "mmHg", "degC", "°C", "voxel", "count", "sample", "frame", "line", "step", "cycle", "dBm", "rpm",
        "ppm", "mol", "rad", "Ohm", "bar", "bit", "newton", "meter", "pixel", "radian", "byte", "degF",
        "turn", "psi", "inch", "foot",
    ];
    for symbol in long {
        agree(symbol);
        for prefix in ["T", "G", "M", "k", "h", "da", "d", "c", "m", "u", "µ", "μ", "n", "p", "f", "a"] {
            agree(&format!("{prefix}{symbol}"));
        }
    }
}

proptest! {
    #[test]
    fn both_read_the_same_products(text in "((m|N|rad|kg|px|1|%|Nm|deg|xx|)(\\^-?[0-9]{0,2}|\\^\\(2\\)|²|⁻¹|2)?[*./·|]?){0,6}") {
        agree(&text);
    }

    #[test]
    fn both_refuse_the_same_nonsense(text in "\\PC{0,12}") {
        agree(&text);
    }
}
