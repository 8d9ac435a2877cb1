//! The table that is printed, line by line as it comes: each figure beside a goal and a baseline.

use std::time::Instant;

/// What a figure is to be.
#[derive(Clone, Copy)]
pub(crate) enum Goal {
    None,
    /// At most so many ns.
    Ns(f64),
    /// At most so many times the baseline.
    Times(f64),
}

pub(crate) struct Table;

impl Table {
    pub(crate) fn title(&mut self, title: &str) {
        let head = "| what | median | goal | holds | beside | ratio |\n|---|---|---|---|---|---|\n";
        print!("\n### {title}\n\n{head}");
    }

    /// `ns` beside a baseline in ns.
    pub(crate) fn row(&mut self, what: &str, ns: f64, goal: Goal, beside: &str, baseline_ns: f64) {
        let (goal, holds) = match goal {
            Goal::None => (String::new(), ""),
            Goal::Ns(most) => (format!("≤ {}", duration(most)), yes(ns <= most)),
            Goal::Times(most) => (format!("≤ {most} ×"), yes(ns <= most * baseline_ns)),
        };
        let (ns_text, base) = (duration(ns), duration(baseline_ns));
        let ratio = ns / baseline_ns;
        println!("| {what} | {ns_text} | {goal} | {holds} | {beside}: {base} | {ratio:.2} |");
    }

    /// A count that is to be exactly something.
    pub(crate) fn count(&mut self, what: &str, is: &str, goal: &str, holds: bool, beside: &str) {
        let holds = if goal.is_empty() { "" } else { yes(holds) };
        println!("| {what} | {is} | {goal} | {holds} | {beside} | |");
    }

    /// What could not be measured, and what to do about it.
    pub(crate) fn missing(&mut self, what: &str, goal: &str, why: &str) {
        println!("| {what} | not measured | {goal} | | {why} | |");
    }
}

fn yes(holds: bool) -> &'static str {
    if holds { "yes" } else { "**no**" }
}

pub(crate) fn duration(ns: f64) -> String {
    match ns {
        n if n < 1e3 => format!("{n:.1} ns"),
        n if n < 1e6 => format!("{:.1} µs", n / 1e3),
        n => format!("{:.2} ms", n / 1e6),
    }
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Median time of some runs, ns.
pub(crate) fn timed(mut f: impl FnMut()) -> f64 {
    let once = |f: &mut dyn FnMut()| {
        let began = Instant::now();
        f();
        began.elapsed().as_nanos() as f64
    };
    median((0..7).map(|_| once(&mut f)).collect())
}
