//! What was seen beside what is allowed, line by line as it comes; and how it all ends.
//!
//! Invariant: a claim is widened by what a control run on the same machine showed, at most to twice its
//! bound, and by nothing else; one that is no finite number does not hold.

use crate::table::duration;

/// How a figure is written.
#[derive(Clone, Copy)]
pub(super) enum Unit {
    Count,
    Ns,
    Micrometre,
    PerSecond,
    Share,
}

impl Unit {
    fn write(self, value: f64) -> String {
        match self {
            Unit::Count => format!("{value:.0}"),
            Unit::Ns => duration(value),
            Unit::Micrometre => format!("{:.2} µm", value * 1e6),
            Unit::PerSecond => format!("{value:.0} /s"),
            Unit::Share => format!("{:.2} %", 100.0 * value),
        }
    }
}

/// The largest; not a number when there is none, or when one of them is none.
pub(super) fn largest(all: impl Iterator<Item = f64>) -> f64 {
    let larger = |a: f64, b: f64| if a.is_nan() || a > b { a } else { b };
    all.reduce(larger).unwrap_or(f64::NAN)
}

/// The smallest, as [`largest`].
pub(super) fn smallest(all: impl Iterator<Item = f64>) -> f64 {
    -largest(all.map(|n| -n))
}

/// All claims of one run.
#[derive(Default)]
pub(crate) struct Verdicts {
    held: usize,
    missed: Vec<String>,
}

impl Verdicts {
    pub(super) fn title(&mut self, title: &str) {
        print!("\n### {title}\n\n| what | seen | bound | control | holds |\n|---|---|---|---|---|\n");
    }

    /// At most `most`, and what the control adds to it: no more than that again, unless nothing is allowed by
    /// itself.
    pub(super) fn at_most(&mut self, what: &str, seen: f64, most: f64, control: f64, unit: Unit) {
        let control = if most > 0.0 { control.min(most) } else { control };
        let bound = format!("≤ {}", unit.write(most));
        let more = if control > 0.0 { format!("+{}", unit.write(control)) } else { String::new() };
        self.line(what, &unit.write(seen), &bound, &more, seen.is_finite() && seen <= most + control);
    }

    /// At least `least`.
    pub(super) fn at_least(&mut self, what: &str, seen: f64, least: f64, unit: Unit) {
        let holds = seen.is_finite() && seen >= least;
        self.line(what, &unit.write(seen), &format!("≥ {}", unit.write(least)), "", holds);
    }

    /// A figure that is told and not judged.
    pub(super) fn tell(&mut self, what: &str, seen: f64, control: Option<f64>, unit: Unit) {
        let control = control.map(|control| unit.write(control)).unwrap_or_default();
        println!("| {what} | {} | | {control} | |", unit.write(seen));
    }

    fn line(&mut self, what: &str, seen: &str, bound: &str, control: &str, holds: bool) {
        println!("| {what} | {seen} | {bound} | {control} | {} |", if holds { "yes" } else { "**no**" });
        match holds {
            true => self.held += 1,
            false => self.missed.push(format!("{what}: {seen}; allowed {bound} {control}")),
        }
    }

    /// As libtest ends, since `tests/run` counts by that; whether all holds, and there was something to hold.
    pub(crate) fn end(self) -> bool {
        println!();
        for missed in &self.missed {
            println!("test eyesaw: {missed} ... FAILED");
        }
        let all = self.missed.is_empty() && self.held > 0;
        let word = if all { "ok" } else { "FAILED" };
        println!("test result: {word}. {} passed; {} failed; 0 ignored", self.held, self.missed.len());
        all
    }
}
