//! Depth from the phantom's stereo pairs beside their true disparity (B4).
//!
//! The tool is left out: the depth of its tip and its distance from the retina are tests of
//! `plugins/stereo-depth`, over twenty scenes.
//!
//! Invariant: both matchers have the pairs of one camera, and a map is held against the truth of its own
//! pair.

use serde_json::Value;
use trocar_tests::eventually;

use super::plan::Plan;
use super::rig::{Rig, world};
use super::verdicts::{Unit, Verdicts};
use crate::lab::as_number;

/// Pairs that are looked at.
const MAPS: f64 = 20.0;
/// Largest share of disparities that are off by more than 1 px.
const WRONG: f64 = 0.05;
/// Matchers, the least share of the pixels that they tell a disparity of, and the longest time for one map:
/// depth at 15 Hz, ns.
const MATCHERS: [(&str, f64, Option<f64>); 2] = [("bm", 0.9, Some(1e9 / 15.0)), ("sgm", 0.95, None)];

pub(super) fn measure(verdicts: &mut Verdicts) {
    let rig = Rig::up(world(), Plan::of_depth());
    verdicts.title("Disparity of the textured retina, 1024x768, beside its truth (B4)");
    for (matcher, least, longest_ns) in MATCHERS {
        let ledger = format!("host/{matcher}-ledger");
        let seen = eventually(&format!("{matcher} has made maps"), || {
            let seen = rig.call(&ledger, "ledger/figures", Value::Null);
            if as_number(&seen["maps"]) >= MAPS { Ok(seen) } else { Err(seen.to_string()) }
        });
        let of = |key: &str| as_number(&seen[key]);
        let wrong = of("wrong") / of("known");
        verdicts.at_most(
            &format!("{matcher}: of its disparities wrong by more than 1 px"),
            wrong,
            WRONG,
            0.0,
            Unit::Share,
        );
        let what = format!("{matcher}: of the pixels whose truth is known with a disparity");
        verdicts.at_least(&what, of("known") / of("pixels"), least, Unit::Share);
        let work = rig.work(&format!("host/{matcher}"));
        let what = format!("{matcher}: time of a map, mean");
        match longest_ns {
            Some(most) => verdicts.at_most(&what, work.ns / work.steps, most, 0.0, Unit::Ns),
            None => verdicts.tell(&what, work.ns / work.steps, None, Unit::Ns),
        }
        verdicts.tell(
            &format!("{matcher}: deviation of the others, RMS, 1/1000 px"),
            1e3 * of("rms"),
            None,
            Unit::Count,
        );
    }
    rig.end();
}
