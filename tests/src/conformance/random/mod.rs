//! Random interleavings: by seed, control and calls at the same time, then the books are checked; in one
//! process and in two.
//!
//! Invariant: what is asked follows from the seed alone; a failure prints it, and `TROCAR_SEED=n` asks the
//! same again. `TROCAR_SEEDS=n` plays that many times as many seeds as usual.

mod books;
mod ops;
mod parts;
mod play;

use std::env;
use std::panic::{self, AssertUnwindSafe};

use super::{Lab, Languages};
use crate::skip;
use books::{Growth, Resources, await_shared_memory, shared_memory};

/// Where servers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Servers {
    /// In the clients' process.
    Near,
    /// In another one; whoever shares the thread of one of them is there, too.
    Remote,
}

/// Plays these seeds, shared out among processes, or only the one of `TROCAR_SEED`, here. `test`: the full
/// name of the test that asks.
///
/// # Panics
/// An invariant did not hold; the seed is printed.
pub fn interleave(
    languages: impl Into<Languages>,
    servers: Servers,
    seeds: std::ops::Range<u64>,
    test: &str,
) {
    let languages = languages.into();
    if let Some(why) = languages.missing() {
        return skip(&why);
    }
    let number = |name: &str| {
        let text = env::var(name).ok()?;
        Some(text.parse::<u64>().unwrap_or_else(|e| panic!("{name}={text}: {e}")))
    };
    if let Some(one) = number("TROCAR_SEED") {
        return interleave_here(languages, servers, [one]);
    }
    let Some((part, parts)) = parts::part() else { return parts::share_out(test) };
    // A multiple keeps the ranges of the languages apart.
    let times = number("TROCAR_SEEDS").unwrap_or(1);
    interleave_here(
        languages,
        servers,
        (seeds.start * times..seeds.end * times).filter(|seed| seed % parts == part),
    );
}

/// Plays these seeds in one host of this process.
fn interleave_here(languages: Languages, servers: Servers, seeds: impl IntoIterator<Item = u64>) {
    let lab = match servers {
        Servers::Near => Lab::new(languages),
        Servers::Remote => Lab::parted(languages),
    };
    lab.open_gate();
    let memory = shared_memory();
    // Taken after the first one, which makes what is made once and kept.
    let mut before = None;
    let mut growth = Growth::default();
    for seed in seeds {
        let played = panic::catch_unwind(AssertUnwindSafe(|| {
            play::play(&lab, seed);
            before.get_or_insert_with(Resources::now).await_again();
            await_shared_memory(memory);
            growth.look();
        }));
        if let Err(why) = played {
            eprintln!(
                "seed {seed}, {languages:?}, servers {servers:?}: TROCAR_SEED={seed} asks the same again"
            );
            eprintln!("{}", ops::draw(seed).told());
            for (id, c) in &lab.graph().components {
                let (model, e) = (c.execution.model, &c.execution);
                eprintln!(
                    "{id} {} {} {model:?} {:?}{:?} {}",
                    c.state, c.health, e.stream_of, e.inside, c.fault
                );
            }
            for c in lab.graph().connections.values() {
                eprintln!("{} ← {}", c.client, c.server);
            }
            panic::resume_unwind(why);
        }
    }
    growth.judge(&format!("{:?} {servers:?}", languages.client));
}
