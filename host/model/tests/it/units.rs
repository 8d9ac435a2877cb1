//! Units: every spelling of one unit is that unit, every other one is another, and nonsense gets a
//! suggestion.

use proptest::prelude::*;
use serde_json::json;
use trocar_model::*;

use crate::scene::*;

fn why(text: &str) -> String {
    Unit::parse(text).unwrap_err().to_string()
}

#[test]
fn spellings_of_one_unit_are_the_same() {
    let same = [
        ("N*m", "Nm"),
        ("N.m", "m·N"),
        ("mN*m", "mNm"),
        ("m/s^2", "m/s²"),
        ("m/s^2", "m*s^-2"),
        ("rad/s/s", "rad/s^2"),
        ("Hz", "1/s"),
        ("kHz", "1/ms"),
        ("us", "µs"),
        ("µm", "μm"),
        ("m|rad", "rad|m"),
        ("N|N.m", "Nm|N"),
        ("1", ""),
        ("kg", "kg"),
        ("N*mm", "mN*m"),
        ("mm^2", "um*m"),
        ("°", "deg"),
        ("D", "1/m"),
        ("%", "%"),
    ];
    for (a, b) in same {
        assert!(
            Unit::same(a, b),
            "{a} and {b} should be the same: {:?} {:?}",
            Unit::parse(a),
            Unit::parse(b)
        );
    }
}

#[test]
fn what_counts_differently_is_not_the_same() {
    let other = [
        ("N", "mN"),
        ("m", "mm"),
        ("rad", "deg"),
        ("Nm", "J"),
        ("m", ""),
        ("rad", "1"),
        ("m|rad", "m"),
        ("m/s", "m/s^2"),
        ("min", "ms"),
        ("T", "t"),
        ("px", "count"),
        ("B", "bit"),
        ("%", "1"),
        ("K", "degC"),
    ];
    for (a, b) in other {
        assert!(!Unit::same(a, b), "{a} and {b} should differ");
    }
}

#[test]
fn every_unit_of_the_design_is_known() {
    let all = "m mm µm nm rad mrad deg s ms us ns Hz kHz N mN Nm N*m V mV A mA px B KB K Pa m/s rad/s m/s^2 rad/s^2 N/m \
        N*s/m 1/m 1 m|rad N|N.m m/s|rad/s m/s^2|rad/s^2 Bd count % dB px/mm W mW J mmHg mL min rpm";
    for unit in all.split_whitespace().filter(|u| *u != "KB") {
        assert!(Unit::parse(unit).is_ok(), "{}", why(unit));
    }
}

#[test]
fn an_unknown_unit_is_refused_with_what_was_probably_meant() {
    let cases = [
        ("newton", "`newton` is no unit; did you mean `N`?"),
        ("Newtons", "did you mean `N`?"),
        ("seconds", "did you mean `s`?"),
        ("hz", "did you mean `Hz`?"),
        ("pixels", "did you mean `px`?"),
        ("m/s2", "`s2` is no unit; did you mean `s^2`?"),
        ("degree", "did you mean `deg`?"),
        ("kdeg", "`kdeg` is no unit"),
        ("zorkmid", "known are SI units"),
        ("m/", "a symbol is missing"),
        ("*", "a symbol is missing"),
        ("m^", "no power"),
        ("m^0", "no power"),
        ("m^999999999999", "no power"),
        ("m/s*rad", "ambiguous"),
        ("m|", "a symbol is missing"),
        (" m", "is no unit"),
    ];
    for (text, want) in cases {
        assert!(why(text).contains(want), "{} should contain {want:?}", why(text));
    }
    assert!(why(&"m*".repeat(100)).contains("longer than 64 bytes"));
}

#[test]
fn a_class_with_an_unknown_unit_is_refused_with_its_place() {
    let mut class = robot();
    assert_eq!(class.check_units(), Ok(()));
    class.ports.outputs.push(output("bad", PortType::Plain(force("newton"))));
    let found = class.check_units().unwrap_err();
    assert!(found.starts_with("output bad: field f of Force: unit \"newton\""), "{found}");
    let mut class = robot();
    class.config_schema = json!({"properties": {"arm": {"properties": {"reach": {"unit": "meters"}}}}});
    assert!(class.check_units().unwrap_err().starts_with("setting arm.reach: "), "{:?}", class.check_units());
    let mut class = robot();
    class.ports.provided[1].commands[1].arg.as_mut().unwrap().unit = "cmm".into();
    assert!(
        class.check_units().unwrap_err().starts_with("command arm/servo_jp: "),
        "{:?}",
        class.check_units()
    );
}

proptest! {
    #[test]
    fn no_text_makes_parse_panic_and_the_canonical_form_of_a_good_one_is_the_same_unit(text in "[a-zA-Zµ²°%^*/.|0-9-]{0,12}") {
        if let Ok(unit) = Unit::parse(&text) {
            prop_assert!(Unit::same(&text, &text));
            prop_assert_eq!(Unit::parse(&text).unwrap().to_string(), unit.to_string());
        }
    }

    #[test]
    fn any_text_at_all_is_answered(text in ".{0,80}") {
        // Only that it answers: most of these are no units.
        let _ = Unit::parse(&text);
    }

    #[test]
    fn the_order_of_factors_does_not_matter(
        mut factors in prop::collection::vec(prop::sample::select(vec!["N", "m", "mm", "rad", "s^-2", "V", "kHz"]), 1..5),
    ) {
        let one = factors.join("*");
        factors.reverse();
        prop_assert!(Unit::same(&one, &factors.join(".")));
    }
}
