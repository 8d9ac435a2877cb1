//! EyeSAW under its full load, held against its gates: `bench
//! eyesaw[/load|/spectra|/scan|/depth|/stop|/recording]`.
//!
//! Invariant: the built programs and plugins run as users start them; what decides is counted inside of them,
//! and each bound is widened by what bare threads on the same machine showed.

mod bare;
mod control;
mod depth;
mod disk;
mod load;
mod plan;
mod recording;
mod rig;
mod scan;
mod spectra;
mod stop;
mod verdicts;

pub(crate) use verdicts::Verdicts;

/// How much of it there is to be.
#[derive(Clone, Copy)]
pub(crate) struct Amount {
    /// Length of a run under load.
    pub(crate) seconds: u64,
    /// Processes killed.
    pub(crate) kills: usize,
}

/// One subject.
pub(crate) fn measure(subject: &str, verdicts: &mut Verdicts, amount: Amount) {
    match subject {
        "eyesaw/load" => load::measure(verdicts, amount.seconds),
        "eyesaw/spectra" => spectra::measure(verdicts, amount.seconds),
        "eyesaw/scan" => scan::measure(verdicts),
        "eyesaw/recording" => recording::measure(verdicts, amount.seconds),
        "eyesaw/depth" => depth::measure(verdicts),
        _ => stop::measure(verdicts, amount.kills),
    }
}
