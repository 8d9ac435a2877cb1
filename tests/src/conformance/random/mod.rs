//! Random interleavings: by seed, control and calls at the same time, then the books are checked.
//!
//! Invariant: what is asked follows from the seed alone; a failure prints it, and `TROCAR_SEED=n` asks the same again.

mod books;
mod ops;
mod play;

use std::env;
use std::panic::{self, AssertUnwindSafe};

use super::{Lab, Language};
use crate::skip;
use books::Resources;

/// Plays these seeds in one host, or only the one of `TROCAR_SEED`.
///
/// # Panics
/// An invariant did not hold; the seed is printed.
pub fn interleave(language: Language, seeds: std::ops::Range<u64>) {
    if let Some(why) = language.missing() {
        return skip(&why);
    }
    let seeds: Vec<u64> = match env::var("TROCAR_SEED") {
        Ok(one) => vec![one.parse().unwrap_or_else(|e| panic!("TROCAR_SEED={one}: {e}"))],
        Err(_) => seeds.collect(),
    };
    let lab = Lab::new(language);
    lab.open_gate();
    // Taken after the first one, which makes what is made once and kept.
    let mut before = None;
    for seed in seeds {
        let played = panic::catch_unwind(AssertUnwindSafe(|| {
            play::play(&lab, seed);
            before.get_or_insert_with(Resources::now).await_again();
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
}
