//! Outer tests of the model, by public names only; one file per promise.
#![allow(clippy::unwrap_used, clippy::result_large_err)]

mod adapting;
mod agreeing;
mod between;
mod configuring;
mod connecting;
mod creating;
mod executing;
mod framing;
mod interpolating;
mod invariants;
mod paths;
mod phasing;
mod refusals;
mod removing;
mod restoring;
mod running;
mod scene;
mod settling;
mod tagging;
mod types;
mod units;
mod values;
mod wanting;
