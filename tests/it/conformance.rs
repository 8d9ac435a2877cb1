//! The conformance suite, for every way to connect two components of one process or of two, every language,
//! and one calling the other.
//!
//! Promise: a component cannot tell where its peer runs or what it is written in; what may happen is the
//! same.
//!
//! This suite plays a choice of the whole cross of ways and cases; `conformance_cross` plays the rest of it.
//!
//! - Cases that cannot see how client and server are connected are played once a language.
//! - Each other case is played in each deployment. For each reach of a call (queue, shared thread, the
//!   caller's thread, memory of two processes with and without the class of the server) it meets a client of
//!   each language, a server of each language, and linked classes where that can be. It also meets each of
//!   the four pairs of languages.
//! - Over all cases, every pair of values of deployment, client language, server language and origin (linked,
//!   or from a file) is played that can be. Processes of the built program have no linked classes: there is
//!   no such pair.
//!
//! The choice suffices for faults that two values together decide. A component meets the host at one
//! boundary, whose code depends on the language and on the reach; carriers and executors depend on the
//! deployment and see no language. A fault that needs one deployment, one language and one case at once is
//! left to the cross.

use std::collections::BTreeSet;
use std::process::Command;
use std::{env, fs};

use trocar_tests::conformance::choice;
use trocar_tests::conformance::matrix::{self, Situation};
use trocar_tests::conformance::{Lab, Language, Languages, OtherThread, Way};
use trocar_tests::{repository, skip};

#[macro_use]
mod lists;
#[macro_use]
pub(crate) mod making;

use making::{CASES, Class, Suite, WAYS};

ways! { modules (Gate) }

#[test]
fn every_outcome_of_every_kind_of_command_comes_about_or_has_its_reason_why_not() {
    let holes = matrix::holes();
    assert!(holes.is_empty(), "{}", holes.join("\n"));
}

#[test]
fn every_situation_has_its_case() {
    for situation in Situation::ALL {
        let case = situation.case();
        let listed = CASES.iter().any(|c| (c.topic, c.name) == ("matrix cases", case));
        assert!(listed, "{situation:?} is not played: {case} is not in the list");
    }
}

/// Cases that are written, as `cases topic/name`: the public functions of their files.
fn written() -> BTreeSet<String> {
    let folder = repository().join("tests/src/conformance/cases");
    let files = fs::read_dir(&folder).unwrap().map(|file| file.unwrap().path());
    let cases = files.flat_map(|file| {
        let text = fs::read_to_string(&file).unwrap();
        let topic = file.file_stem().unwrap().to_string_lossy().into_owned();
        let names = text.lines().filter_map(|line| line.strip_prefix("pub fn ")?.split_once('('));
        names.map(|(name, _)| format!("cases {topic}/{name}")).collect::<Vec<_>>()
    });
    cases.chain(Situation::ALL.map(|situation| format!("matrix cases/{}", situation.case()))).collect()
}

#[test]
fn every_case_that_is_written_is_in_one_class_of_the_list() {
    let mut listed: Vec<String> = CASES.iter().map(|c| format!("{}/{}", c.topic, c.name)).collect();
    listed.sort_unstable();
    let written: Vec<String> = written().into_iter().collect();
    assert_eq!(listed, written, "on the left is the list, on the right what is written");
}

/// The names of all tests of this program, as it lists them itself.
fn tests_there_are() -> BTreeSet<String> {
    let itself = env::current_exe().unwrap();
    let output = Command::new(itself).args(["--list", "--format", "terse"]).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let names: BTreeSet<String> =
        text.lines().filter_map(|line| line.strip_suffix(": test")).map(str::to_owned).collect();
    assert!(output.status.success() && !names.is_empty(), "{}: {text}", output.status);
    names
}

#[test]
fn each_case_is_a_test_of_each_way_in_one_of_the_two_suites() {
    let mut expected = BTreeSet::new();
    for row in WAYS {
        for case in CASES {
            let suite = match row.suite(case.class) {
                Suite::Gate => "conformance",
                Suite::Cross => "conformance_cross",
            };
            assert!(
                expected.insert(format!("{suite}::{}::{}", row.module, case.name)),
                "{} twice",
                case.name
            );
        }
    }
    // Tests of the suite itself stand in no module of a way.
    let of_a_way = |name: &String| match *name.split("::").collect::<Vec<_>>() {
        [suite, _, _] => ["conformance", "conformance_cross"].contains(&suite),
        _ => false,
    };
    let there: BTreeSet<String> = tests_there_are().into_iter().filter(of_a_way).collect();
    let apart: Vec<_> = there.symmetric_difference(&expected).collect();
    assert!(apart.is_empty(), "in one of the list and the program alone: {apart:#?}");
}

/// The ways in which this suite plays a class.
fn chosen(class: Class) -> Vec<Way> {
    WAYS.iter().filter(|row| row.suite(class) == Suite::Gate).map(|row| row.way).collect()
}

#[test]
fn every_pair_of_deployment_languages_and_origin_that_can_be_is_played() {
    let missing = choice::missing_pairs(&[chosen(Class::First), chosen(Class::Second)].concat());
    assert!(missing.is_empty(), "no way that this suite plays has:\n{}", missing.join("\n"));
}

#[test]
fn each_case_that_depends_on_the_way_meets_each_deployment_and_each_reach_with_each_language() {
    for class in [Class::First, Class::Second] {
        let missing = choice::missing_of_a_case(&chosen(class));
        assert!(missing.is_empty(), "no case of the class {class:?} meets:\n{}", missing.join("\n"));
    }
}

#[test]
fn each_case_that_is_independent_of_the_way_is_played_once_a_language() {
    let ways = chosen(Class::Independent);
    for language in [Language::Rust, Language::Cpp, Language::Linked] {
        let played = ways.iter().filter(|way| way.languages == Languages::from(language)).count();
        assert_eq!(played, 1, "{language:?}");
    }
    assert_eq!(ways.len(), 3);
}

#[test]
fn the_cross_has_every_deployment_that_there_is() {
    let played: BTreeSet<_> = WAYS.iter().map(|row| row.way.deployment.name()).collect();
    let there: BTreeSet<_> = choice::DEPLOYMENTS.iter().map(|deployment| deployment.name()).collect();
    assert_eq!(played, there);
}

#[test]
fn each_test_that_is_named_for_the_thread_sanitizer_exists_and_plays_linked_classes() {
    let file = repository().join("tests/tsan/gate.txt");
    let text = fs::read_to_string(&file).unwrap();
    let names: Vec<&str> = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).collect();
    let there = tests_there_are();
    let wrong = |name: &&&str| !there.contains(**name) || !name.contains("_linked::");
    let wrong: Vec<_> = names.iter().filter(wrong).collect();
    assert!(wrong.is_empty(), "{}: no tests of linked classes: {wrong:#?}", file.display());
    let once: BTreeSet<_> = names.iter().collect();
    assert!(!names.is_empty() && once.len() == names.len(), "a name stands there twice, or none does");
}

#[test]
fn where_client_and_server_differ_in_language_each_is_of_its_own() {
    let (rust, cpp) = (Language::Rust, Language::Cpp);
    for (client, server) in [(rust, cpp), (cpp, rust)] {
        let languages = Languages { client, server };
        if let Some(why) = languages.missing() {
            return skip(&why);
        }
        let lab = Lab::pair(&Way { deployment: &OtherThread, languages });
        let mut made: Vec<String> = lab.graph().components.values().map(|c| c.class.full_name()).collect();
        made.sort();
        let mut expected = [format!("{}/Client", client.plugin()), format!("{}/Server", server.plugin())];
        expected.sort();
        assert_eq!(made, expected);
    }
}

/// Everything of a class but where it comes from and what is said to people.
fn class_of(lab: &Lab, language: Language, name: &str) -> String {
    let full = format!("{}/{name}", language.plugin());
    let mut class = (*lab.class(&full)).clone();
    (class.plugin, class.version, class.hash, class.doc) = Default::default();
    let text = format!("{class:#?}");
    // Docs of ports and fields stand on lines of their own.
    text.lines().filter(|line| !line.trim_start().starts_with("doc: ")).collect::<Vec<_>>().join("\n")
}

#[test]
fn the_classes_are_the_same_in_every_language() {
    let linked = Lab::new(Language::Linked);
    for language in [Language::Rust, Language::Cpp] {
        if let Some(why) = language.missing() {
            return skip(&why);
        }
        let lab = Lab::new(language);
        for name in ["Server", "Client", "Through", "Arm", "Shelf", "Probe"] {
            let (own, other) = (class_of(&linked, Language::Linked, name), class_of(&lab, language, name));
            let differs = own.lines().zip(other.lines()).position(|(a, b)| a != b);
            if let Some(at) = differs {
                let around = |text: &str| {
                    text.lines().skip(at.saturating_sub(8)).take(12).collect::<Vec<_>>().join("\n")
                };
                panic!("{name} linked:\n{}\n{language:?}:\n{}", around(&own), around(&other));
            }
            assert_eq!(own.lines().count(), other.lines().count(), "{name} in {language:?}");
        }
    }
}
