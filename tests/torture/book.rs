//! What a row found: one line per claim, each with what was allowed and what was seen.
//!
//! Invariant: a line that does not hold makes its row fail; a row without a single line has shown nothing, and fails.

/// Everything one row claims.
pub(crate) struct Book {
    pub(crate) row: &'static str,
    pub(crate) fault: &'static str,
    pub(crate) lines: Vec<Line>,
    /// What of this row was left out, and why.
    pub(crate) not_run: Vec<String>,
    /// How long it took, s.
    pub(crate) took_s: f64,
}

/// One claim.
pub(crate) struct Line {
    pub(crate) what: String,
    /// How often it was tried.
    pub(crate) count: usize,
    /// What is allowed, in words.
    pub(crate) bound: String,
    /// What was seen, in words.
    pub(crate) seen: String,
    /// Of the control run, in words.
    pub(crate) control: String,
    pub(crate) holds: bool,
    /// It is judged beside a control run, so what the machine takes away from one and not from the other is in it.
    pub(crate) beside_control: bool,
}

impl Line {
    pub(crate) fn words(&self) -> String {
        let Line { what, bound, seen, control, .. } = self;
        format!("{what}: {seen}; allowed {bound}, control {control}")
    }
}

impl Book {
    pub(crate) fn new(row: &'static str, fault: &'static str) -> Book {
        Book { row, fault, lines: Vec::new(), not_run: Vec::new(), took_s: 0.0 }
    }

    pub(crate) fn holds(&self) -> bool {
        !self.lines.is_empty() && self.lines.iter().all(|line| line.holds)
    }

    /// It fails, and only in what is judged beside a control run.
    pub(crate) fn fails_in_time_only(&self) -> bool {
        !self.lines.is_empty() && !self.holds() && self.failing().all(|line| line.beside_control)
    }

    pub(crate) fn failing(&self) -> impl Iterator<Item = &Line> {
        self.lines.iter().filter(|line| !line.holds)
    }

    /// Each time in ms is within `bound_ms` and the lateness, in ms, that the machine itself showed at that moment.
    pub(crate) fn times(&mut self, what: &str, seen: &[Timed], bound_ms: f64) {
        let ms = sorted(seen.iter().map(|t| t.ms));
        let late = sorted(seen.iter().map(|t| t.late_ms));
        self.line(Line {
            what: what.to_owned(),
            count: seen.len(),
            bound: format!("≤ {bound_ms} ms"),
            seen: spread(&ms),
            control: format!("+{:.1} ms", late.last().copied().unwrap_or(0.0)),
            holds: !seen.is_empty() && seen.iter().all(|t| t.ms <= bound_ms + t.late_ms),
            beside_control: true,
        });
    }

    /// A number that is to be at most this.
    pub(crate) fn at_most(&mut self, what: &str, tried: usize, seen: u64, most: u64) {
        self.line(Line {
            what: what.to_owned(),
            count: tried,
            bound: if most == 0 { "0".into() } else { format!("≤ {most}") },
            seen: seen.to_string(),
            control: String::new(),
            holds: seen <= most,
            beside_control: false,
        });
    }

    /// A number without which the claims beside it would show nothing.
    pub(crate) fn at_least(&mut self, what: &str, tried: usize, seen: u64, least: u64) {
        self.line(Line {
            what: what.to_owned(),
            count: tried,
            bound: format!("≥ {least}"),
            seen: seen.to_string(),
            control: String::new(),
            holds: seen >= least,
            beside_control: false,
        });
    }

    /// A number that is to be at most that of the control run, and what is allowed beyond it.
    pub(crate) fn beside(
        &mut self,
        what: &str,
        tried: usize,
        seen: f64,
        control: f64,
        allowed: f64,
        unit: &str,
    ) {
        self.line(Line {
            what: what.to_owned(),
            count: tried,
            bound: format!("control + {allowed} {unit}"),
            seen: format!("{seen:.1} {unit}"),
            control: format!("{control:.1} {unit}"),
            holds: seen <= control + allowed,
            beside_control: true,
        });
    }

    /// Something that is so, or the reason why it is not. Claimed again, it is the same claim, tried more often.
    pub(crate) fn check(&mut self, what: &str, tried: usize, is: Result<(), String>) {
        if let Some(known) = self.lines.iter_mut().find(|line| line.what == what && line.bound == "holds") {
            known.count += tried;
            if let Err(why) = is {
                eprintln!("  FAILS {what}: {why}");
                (known.holds, known.seen) = (false, why);
            }
            return;
        }
        let (seen, holds) = match is {
            Ok(()) => ("yes".to_owned(), true),
            Err(why) => (why, false),
        };
        let (bound, control) = ("holds".into(), String::new());
        self.line(Line {
            what: what.to_owned(),
            count: tried,
            bound,
            seen,
            control,
            holds,
            beside_control: false,
        });
    }

    /// Something of this row that is not run, or not as it should be.
    pub(crate) fn leaves_out(&mut self, why: &str) {
        self.not_run.push(why.to_owned());
    }

    pub(crate) fn line(&mut self, line: Line) {
        let verdict = if line.holds { "holds" } else { "FAILS" };
        eprintln!(
            "  {verdict} {}: {} × {} (allowed {} {})",
            line.what, line.count, line.seen, line.bound, line.control
        );
        self.lines.push(line);
    }
}

/// How long something took, and how late the machine was meanwhile.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timed {
    pub(crate) ms: f64,
    pub(crate) late_ms: f64,
}

fn sorted(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values
}

fn spread(ms: &[f64]) -> String {
    match ms {
        [] => "never".into(),
        [one] => format!("{one:.1} ms"),
        many => format!("p50 {:.1}, max {:.1} ms", many[many.len() / 2], many[many.len() - 1]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_may_be_late_by_what_the_machine_was_late_at_that_moment_and_no_more() {
        let mut book = Book::new("x", "y");
        assert!(!book.holds(), "nothing was shown");
        book.times("a", &[Timed { ms: 25.0, late_ms: 1.5 }], 24.0);
        assert!(book.holds());
        book.times("b", &[Timed { ms: 25.0, late_ms: 0.5 }, Timed { ms: 1.0, late_ms: 9.0 }], 24.0);
        assert!(!book.holds(), "the lateness of another moment does not count");
    }

    #[test]
    fn what_is_counted_is_never_put_down_to_the_machine() {
        let mut book = Book::new("x", "y");
        assert!(!book.fails_in_time_only(), "nothing is no failure in time: nothing was shown");
        book.beside("periods", 1, 4.0, 2.0, 1.0, "periods");
        assert!(book.fails_in_time_only());
        book.at_most("lost", 1, 1, 0);
        assert!(!book.fails_in_time_only());
    }

    #[test]
    fn a_claim_that_was_never_tried_does_not_hold() {
        let mut book = Book::new("x", "y");
        book.times("a", &[], 1.0);
        assert!(!book.holds());
    }

    #[test]
    fn what_must_have_happened_and_did_not_makes_its_row_fail() {
        let mut book = Book::new("x", "y");
        book.at_least("a", 1, 1, 1);
        assert!(book.holds());
        book.at_least("b", 1, 0, 1);
        assert!(!book.holds());
    }

    #[test]
    fn a_claim_that_failed_once_does_not_hold_again() {
        let mut book = Book::new("x", "y");
        book.check("a", 1, Ok(()));
        book.check("a", 1, Err("why".into()));
        book.check("a", 1, Ok(()));
        assert_eq!((book.holds(), book.lines.len(), book.lines[0].count), (false, 1, 3));
    }
}
