//! The pairs that a choice of ways covers: deployment, language of each end, and where the classes come from.
//!
//! Invariant: the pairs that are asked for are those of [`possible`], and never those of the ways somebody
//! wrote down.

use std::collections::BTreeSet;

use super::{
    BuiltProcesses, Deployment, ExecIn, ExecOut, Language, Languages, OtherMachine, OtherProcess,
    OtherProcessOfCalledBack, OtherProcessOfFreeClient, OtherProcessOfFreeServer, OtherProcessOfPassive,
    OtherProcessOnGrids, OtherProcessOnTurnedGrids, OtherThread, Passive, SameStream, SharedMemory, Way,
};

/// Every deployment of the suite.
pub const DEPLOYMENTS: [&dyn Deployment; 15] = [
    &OtherThread,
    &SameStream,
    &ExecIn,
    &ExecOut,
    &Passive,
    &SharedMemory,
    &OtherProcess,
    &OtherMachine,
    &BuiltProcesses,
    &OtherProcessOnGrids,
    &OtherProcessOnTurnedGrids,
    &OtherProcessOfFreeClient,
    &OtherProcessOfFreeServer,
    &OtherProcessOfCalledBack,
    &OtherProcessOfPassive,
];

/// All ways there can be. A way is linked as a whole or not at all, so its ends are both Rust then; linked
/// classes beside those of a file are the promise of the suite `embedding`. The built program has no linked
/// classes, so processes of it are never linked: such a way is no way, and not one that is missing.
#[must_use]
pub fn possible() -> Vec<Way> {
    let (rust, cpp) = (Language::Rust, Language::Cpp);
    let files = [(rust, rust), (rust, cpp), (cpp, rust), (cpp, cpp)];
    let files = files.map(|(client, server)| Languages { client, server });
    let linked = Languages::from(Language::Linked);
    let ways = |deployment: &'static dyn Deployment| {
        let linked = (!deployment.built_processes()).then_some(linked);
        files.into_iter().chain(linked).map(move |languages| Way { deployment, languages })
    };
    DEPLOYMENTS.into_iter().flat_map(ways).collect()
}

/// The values of a way: deployment, client, server, origin of the classes.
fn values(way: &Way) -> [String; 4] {
    let Languages { client, server } = way.languages;
    [way.deployment.name().to_owned(), client_in(client), server_in(server), origin(client)]
}

fn client_in(language: Language) -> String {
    format!("a client in {}", written(language))
}

fn server_in(language: Language) -> String {
    format!("a server in {}", written(language))
}

fn written(language: Language) -> &'static str {
    if language == Language::Cpp { "C++" } else { "Rust" }
}

fn origin(language: Language) -> String {
    if language == Language::Linked { "linked classes" } else { "classes of a file" }.to_owned()
}

/// Every two values of a way.
fn pairs(way: &Way) -> Vec<String> {
    let values = values(way);
    let others = |at: usize| values[at + 1..].iter().map(move |other| (at, other));
    let pairs = (0..values.len()).flat_map(others);
    pairs.map(|(at, other)| format!("{} with {other}", values[at])).collect()
}

/// Everything that decides about one case: the deployment, the two languages, and either end beside the reach
/// of a call.
fn of_a_case(way: &Way) -> Vec<String> {
    let [deployment, client, server, origin] = values(way);
    let languages = format!("{client} with {server}");
    let by_reach = [client, server, origin].map(|value| format!("a call by {:?} with {value}", way.reach()));
    [deployment, languages].into_iter().chain(by_reach).collect()
}

/// Values that `of` finds in possible ways and not in the chosen ones.
fn missing(chosen: &[Way], of: fn(&Way) -> Vec<String>) -> Vec<String> {
    let in_them = |ways: &[Way]| ways.iter().flat_map(of).collect::<BTreeSet<_>>();
    in_them(&possible()).difference(&in_them(chosen)).cloned().collect()
}

/// Pairs of values that can be and that none of these ways has.
#[must_use]
pub fn missing_pairs(chosen: &[Way]) -> Vec<String> {
    missing(chosen, pairs)
}

/// Values and pairs that a case which is played in these ways alone does not meet.
#[must_use]
pub fn missing_of_a_case(chosen: &[Way]) -> Vec<String> {
    missing(chosen, of_a_case)
}
