//! Names and paths have one spelling, and a bad one is explained.

use proptest::prelude::*;
use trocar_model::*;

use crate::scene::*;

fn why(text: &str) -> String {
    match ComponentId::parse(text) {
        Err(Refusal::BadPath { why, .. }) => why,
        other => panic!("{text:?} parsed as {other:?}"),
    }
}

#[test]
fn a_bad_path_says_where_and_what_is_allowed() {
    assert_eq!(why("/host/robot"), "it begins with a slash; wanted process/component");
    assert_eq!(why("host//robot"), "a name is missing at character 6");
    assert_eq!(why("host/"), "a name is missing at character 6");
    assert_eq!(why("host"), "it has too few parts (1, not 2); wanted process/component");
    assert_eq!(why("host/robot/arm"), "it has too many parts (3, not 2); wanted process/component");
    assert_eq!(why("host/ro bot"), "character 8 is ' '; a name holds letters, digits, _ . -");
    assert_eq!(why("host/3d"), "character 6 is '3'; a name begins with a letter or _");
    assert_eq!(why("hôst/robot"), "character 2 is 'ô'; a name holds letters, digits, _ . -");
    assert!(
        why(&format!("host/{}", "x".repeat(64))).contains("at most 63"),
        "the longest name is 63 characters"
    );
    assert_eq!(why(""), "it is empty; wanted process/component");
}

#[test]
fn the_longest_name_is_accepted() {
    assert_eq!(name(&"x".repeat(63)).as_str().len(), 63);
}

#[test]
fn a_glob_matches_what_its_spelling_says() {
    let cases = [
        ("**", "host/robot", true),
        ("host/**", "host/robot", true),
        ("host/**", "gui/robot", false),
        ("host/*", "host/robot", true),
        ("*/robot", "gui/robot", true),
        ("*/robot", "gui/robot2", false),
        ("host/rob*", "host/robot", true),
        ("host/rob*", "host/rob", true),
        ("host/*b*t", "host/robot", true),
        ("host/*b*t", "host/robots", false),
        ("h*/**", "host/robot", true),
    ];
    for (pattern, path, want) in cases {
        assert_eq!(Pattern::parse(pattern).unwrap().matches(&id(path)), want, "{pattern} against {path}");
    }
}

#[test]
fn a_pattern_that_cannot_mean_components_is_refused() {
    for bad in ["*", "host/robot/*", "**/robot", "host/**x", "/host/*", "host/*/", "ho st/*"] {
        assert!(Target::parse(bad).is_err(), "{bad} should be refused");
    }
}

#[test]
fn a_text_with_a_star_is_a_glob_and_one_without_is_a_name() {
    assert!(matches!(target("host/*"), Target::Glob(_)));
    assert!(matches!(target("host/robot"), Target::One(_)));
}

proptest! {
    #[test]
    fn what_is_printed_is_read_back(parts in prop::collection::vec("[A-Za-z_][A-Za-z0-9_.-]{0,62}", 4)) {
        let path = parts.join("/");
        let member = MemberId::parse(&path).unwrap();
        prop_assert_eq!(member.to_string(), path);
        prop_assert_eq!(MemberId::parse(&member.to_string()).unwrap(), member.clone());
        prop_assert_eq!(PortId::parse(&member.port.to_string()).unwrap(), member.port.clone());
        let component = member.port.component;
        prop_assert_eq!(ComponentId::parse(&component.to_string()).unwrap(), component);
    }

    #[test]
    fn no_text_makes_a_parser_panic_and_what_is_read_prints_the_same(text in "[a-z/*. _0é-]{0,20}|\\PC{0,40}") {
        if let Ok(id) = ComponentId::parse(&text) {
            prop_assert_eq!(id.to_string(), text.clone());
        }
        if let Ok(target) = Target::parse(&text) {
            prop_assert_eq!(Target::parse(&target.to_string()).unwrap(), target);
        }
        let _ = MemberId::parse(&text);
    }

    #[test]
    fn a_component_matches_the_glob_cut_from_its_own_path(path in "[a-z]{1,8}/[a-z]{1,8}", cut in 0usize..8) {
        let (process, component) = path.split_once('/').unwrap();
        let cut = cut.min(component.len());
        let pattern = format!("{process}/{}*", &component[..cut]);
        prop_assert!(Pattern::parse(&pattern).unwrap().matches(&id(&path)), "{pattern}");
    }
}
