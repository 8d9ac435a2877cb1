//! What a row found: one line per claim, each with what was allowed and what was seen.
//!
//! Invariant: a line that does not hold makes its row fail; a row without a single line has shown nothing,
//! and fails.

/// Everything one row claims.
pub(crate) struct Book {
    pub(crate) row: &'static str,
    pub(crate) fault: &'static str,
    pub(crate) lines: Vec<Line>,
    /// What of this row was left out, and why.
    pub(crate) not_run: Vec<String>,
    /// How long it took, s.
    pub(crate) took_s: f64,
    /// False: claims about durations are told, and not judged.
    pub(crate) judges_times: bool,
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
    /// It depends on how long something took, and so on what else the machine did.
    pub(crate) of_time: bool,
    /// Where something was counted here and in a control run of the same length.
    pub(crate) counts: Option<Counts>,
}

/// Counts of this run and of the control run, and what is allowed beyond that. Two runs are judged together:
/// the machine takes from either, and the least hiccup is much of a small count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Counts {
    pub(crate) seen: u64,
    pub(crate) control: u64,
    pub(crate) allowed: u64,
}

impl Counts {
    fn holds(self) -> bool {
        self.seen <= self.control + self.allowed
    }

    fn and(self, other: Counts) -> Counts {
        Counts {
            seen: self.seen + other.seen,
            control: self.control + other.control,
            allowed: self.allowed + other.allowed,
        }
    }
}

impl Line {
    fn set_counts(&mut self, counts: Counts) {
        let Counts { seen, control, allowed } = counts;
        (self.seen, self.control) = (seen.to_string(), control.to_string());
        self.bound = format!("control + {allowed}");
        (self.holds, self.counts) = (counts.holds(), Some(counts));
    }

    pub(crate) fn words(&self) -> String {
        let Line { what, bound, seen, control, .. } = self;
        format!("{what}: {seen}; allowed {bound}, control {control}")
    }
}

impl Book {
    pub(crate) fn new(row: &'static str, fault: &'static str) -> Book {
        Book { row, fault, lines: Vec::new(), not_run: Vec::new(), took_s: 0.0, judges_times: true }
    }

    /// Whether a claim counts.
    pub(crate) fn judges(&self, line: &Line) -> bool {
        self.judges_times || !line.of_time
    }

    pub(crate) fn holds(&self) -> bool {
        self.lines.iter().any(|line| self.judges(line)) && self.failing().next().is_none()
    }

    /// It fails, and only in what was counted beside a control run.
    pub(crate) fn fails_in_counts_only(&self) -> bool {
        !self.lines.is_empty() && !self.holds() && self.failing().all(|line| line.counts.is_some())
    }

    /// Judges what both runs counted together, all of an earlier run that was counted and not what failed
    /// alone. A claim that this run did not make fails.
    pub(crate) fn with_counts_of(&mut self, before: &Book) {
        for line in &before.lines {
            let Some(earlier) = line.counts else { continue };
            let Some(again) = self.lines.iter_mut().find(|again| again.what == line.what) else {
                let why = Err(format!("it was done again, and {} was not counted then", line.what));
                self.check("the same is counted again", 1, why);
                continue;
            };
            let Some(both) = again.counts.map(|counts| counts.and(earlier)) else { continue };
            again.set_counts(both);
            again.count += line.count;
            again.seen.push_str(" in two runs");
            eprintln!(
                "  {} both runs together: {}",
                if again.holds { "holds" } else { "FAILS" },
                again.words()
            );
        }
    }

    pub(crate) fn failing(&self) -> impl Iterator<Item = &Line> {
        self.lines.iter().filter(|line| !line.holds && self.judges(line))
    }

    /// Each time in ms is within `bound_ms` and the lateness, in ms, that the machine itself showed at that
    /// moment.
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
            of_time: true,
            counts: None,
        });
    }

    /// A number that is to be at most this.
    pub(crate) fn at_most(&mut self, what: &str, tried: usize, seen: u64, most: u64) {
        self.bounded(what, tried, seen, most, false);
    }

    /// The same of what a machine that does something else, too, makes more of: a queue runs full, a deadline
    /// goes by.
    pub(crate) fn at_most_in_time(&mut self, what: &str, tried: usize, seen: u64, most: u64) {
        self.bounded(what, tried, seen, most, true);
    }

    fn bounded(&mut self, what: &str, tried: usize, seen: u64, most: u64, of_time: bool) {
        self.line(Line {
            what: what.to_owned(),
            count: tried,
            bound: if most == 0 { "0".into() } else { format!("≤ {most}") },
            seen: seen.to_string(),
            control: String::new(),
            holds: seen <= most,
            of_time,
            counts: None,
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
            of_time: false,
            counts: None,
        });
    }

    /// What is counted here and in a control run of the same length.
    pub(crate) fn counts(&mut self, what: &str, tried: usize, counts: Counts) {
        let (empty, holds) = (String::new(), counts.holds());
        let (bound, seen, control) = (empty.clone(), empty.clone(), empty);
        let mut line = Line {
            what: what.to_owned(),
            count: tried,
            bound,
            seen,
            control,
            holds,
            of_time: true,
            counts: None,
        };
        line.set_counts(counts);
        self.line(line);
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
            of_time: true,
            counts: None,
        });
    }

    /// Something that is so, or the reason why it is not. Claimed again, it is the same claim, tried more
    /// often.
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
            of_time: false,
            counts: None,
        });
    }

    /// Something of this row that is not run, or not as it should be.
    pub(crate) fn leaves_out(&mut self, why: &str) {
        self.not_run.push(why.to_owned());
    }

    /// The verdict on a claim, in a word.
    pub(crate) fn verdict(&self, line: &Line) -> &'static str {
        match (line.holds, self.judges(line)) {
            (true, _) => "holds",
            (false, true) => "FAILS",
            (false, false) => "not judged here",
        }
    }

    pub(crate) fn line(&mut self, line: Line) {
        let verdict = self.verdict(&line);
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

    fn counted(seen: u64, control: u64) -> Book {
        let mut book = Book::new("x", "y");
        book.counts("periods", 1, Counts { seen, control, allowed: 1 });
        book
    }

    #[test]
    fn only_what_is_counted_beside_a_control_run_is_counted_again() {
        assert!(!Book::new("x", "y").fails_in_counts_only(), "nothing was shown");
        assert!(!counted(3, 2).fails_in_counts_only(), "it holds");
        let mut book = counted(4, 2);
        assert!(book.fails_in_counts_only());
        book.times("late", &[Timed { ms: 2.0, late_ms: 0.0 }], 1.0);
        assert!(!book.fails_in_counts_only(), "a time that is too long is that at once");
        let mut book = counted(4, 2);
        book.at_most("lost", 1, 1, 0);
        assert!(!book.fails_in_counts_only());
    }

    #[test]
    fn two_runs_are_judged_together_so_a_good_one_makes_up_for_no_bad_one() {
        for (first, second, holds) in [
            ((4, 2), (2, 2), true),
            ((4, 2), (1, 0), false),
            ((4, 2), (3, 2), false),
            ((9, 2), (0, 0), false),
        ] {
            let mut again = counted(second.0, second.1);
            again.with_counts_of(&counted(first.0, first.1));
            assert_eq!(again.holds(), holds, "{first:?} and {second:?}: {}", again.lines[0].words());
            assert_eq!(again.lines[0].count, 2);
        }
        let mut other = Book::new("x", "y");
        other.at_most("lost", 1, 0, 0);
        other.with_counts_of(&counted(4, 2));
        assert!(!other.holds(), "the claim was not made again");
    }

    #[test]
    fn a_claim_that_was_never_tried_does_not_hold() {
        let mut book = Book::new("x", "y");
        book.times("a", &[], 1.0);
        assert!(!book.holds());
    }

    #[test]
    fn a_gate_judges_all_but_durations_and_shows_them() {
        let mut book = Book::new("x", "y");
        book.judges_times = false;
        book.times("late", &[Timed { ms: 2.0, late_ms: 0.0 }], 1.0);
        assert!(!book.holds(), "nothing was shown that is judged");
        book.at_most("lost", 1, 0, 0);
        book.at_most_in_time("missed", 1, 1, 0);
        book.beside("cost", 1, 2.0, 1.0, 0.5, "ms");
        book.counts("skipped", 1, Counts { seen: 3, control: 1, allowed: 1 });
        assert!(book.holds());
        assert_eq!(book.lines.iter().filter(|line| book.verdict(line) == "not judged here").count(), 4);
        book.at_most("torn", 1, 1, 0);
        assert!(!book.holds());
        assert_eq!(book.failing().map(|line| line.what.as_str()).collect::<Vec<_>>(), ["torn"]);
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
