//! Random interleavings: by seed, control and calls at the same time, then the books are checked.
//!
//! Invariant: what is asked follows from the seed alone; a failure prints it, and `TROCAR_SEED=n` asks the same again.
//! `TROCAR_SEEDS=n` plays that many times as many seeds as usual.

mod books;
mod ops;
mod parts;
mod play;

use std::env;
use std::panic::{self, AssertUnwindSafe};

use super::{Lab, Language};
use crate::skip;
use books::{Growth, Resources};

/// Plays these seeds, shared out among processes, or only the one of `TROCAR_SEED`, here. `test`: the full name of the test
/// that asks.
///
/// # Panics
/// An invariant did not hold; the seed is printed.
pub fn interleave(language: Language, seeds: std::ops::Range<u64>, test: &str) {
    if let Some(why) = language.missing() {
        return skip(&why);
    }
    let number = |name: &str| {
        let text = env::var(name).ok()?;
        Some(text.parse::<u64>().unwrap_or_else(|e| panic!("{name}={text}: {e}")))
    };
    if let Some(one) = number("TROCAR_SEED") {
        return interleave_here(language, [one]);
    }
    let Some((part, parts)) = parts::part() else { return parts::share_out(test) };
    // A multiple keeps the ranges of the languages apart.
    let times = number("TROCAR_SEEDS").unwrap_or(1);
    interleave_here(language, (seeds.start * times..seeds.end * times).filter(|seed| seed % parts == part));
}

/// Plays these seeds in one host of this process.
fn interleave_here(language: Language, seeds: impl IntoIterator<Item = u64>) {
    let lab = Lab::new(language);
    lab.open_gate();
    // Taken after the first one, which makes what is made once and kept.
    let mut before = None;
    let mut growth = Growth::default();
    for seed in seeds {
        let played = panic::catch_unwind(AssertUnwindSafe(|| {
            play::play(&lab, seed);
            before.get_or_insert_with(Resources::now).await_again();
            growth.look();
        }));
        if let Err(why) = played {
            eprintln!("seed {seed}, {language:?}: TROCAR_SEED={seed} asks the same again");
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
    growth.judge(language);
}
