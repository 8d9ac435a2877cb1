//! One run: its seed, how much of it there is to be, and how a row is carried out.
//!
//! Invariant: what a row draws depends on the seed and its own name only, so a row can be run again alone.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

use crate::book::{Book, Line};
use crate::clock::{Since, Witness};

/// How often a row is tried on a machine that does something else, too.
const ATTEMPTS: usize = 3;
/// A machine that is late by more is no place to judge, ms.
const UNQUIET: f64 = 80.0;

/// What a row is: its name, what is done in it, and how.
pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) fault: &'static str,
    pub(crate) when: When,
    /// An error is something the row could not even look at.
    pub(crate) run: fn(&Run, &mut Book) -> Result<(), String>,
}

/// In which selections a row is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum When {
    /// In all of them: what it claims besides durations holds on any machine, and it leaves room for what
    /// else runs.
    Gate,
    /// In the short selection and in full: all it claims are durations.
    Times,
    /// Only in full, or by name.
    Full,
}

pub(crate) struct Run {
    pub(crate) seed: u64,
    pub(crate) full: bool,
    /// Nothing is judged that a machine which does something else, too, may take longer for.
    pub(crate) gate: bool,
}

impl Default for Run {
    fn default() -> Run {
        Run { seed: fastrand::u64(..) >> 16, full: false, gate: false }
    }
}

impl Run {
    /// Whether a row is part of it where none is named.
    pub(crate) fn has(&self, row: &Row) -> bool {
        match row.when {
            When::Gate => true,
            When::Times => !self.gate,
            When::Full => self.full && !self.gate,
        }
    }

    /// How often something is done: in the short selection, and in full.
    pub(crate) fn times(&self, short: u64, full: u64) -> u64 {
        if self.full { full } else { short }
    }

    /// The moments of a row.
    pub(crate) fn random(&self, row: &Book) -> fastrand::Rng {
        let mut hasher = DefaultHasher::new();
        row.row.hash(&mut hasher);
        fastrand::Rng::with_seed(self.seed ^ hasher.finish())
    }

    /// Carries a row out; once more when it failed while the machine itself stood still, and when it failed
    /// only in what is counted beside a control run: then both runs are judged together. Either is told.
    pub(crate) fn row(&self, row: &Row) -> Book {
        let (mut attempt, mut counted, mut before) = (1, None::<Book>, Vec::<String>::new());
        loop {
            let witness = Witness::start();
            let mut book = self.attempt(row);
            let late_ms = witness.late_since(Since::Ever);
            if late_ms > UNQUIET {
                book.leaves_out(&format!(
                    "attempt {attempt}: the machine itself was late by {late_ms:.0} ms"
                ));
            }
            // The gate judges nothing that depends on how quiet the machine is.
            let stood_still = late_ms > UNQUIET && attempt < ATTEMPTS && !self.gate;
            if let Some(earlier) = counted.as_ref().filter(|_| book.holds() || !stood_still) {
                book.with_counts_of(earlier);
            }
            let again: Option<String> = match book.holds() {
                true => None,
                false if stood_still => Some(format!("the machine itself was late by {late_ms:.0} ms")),
                false if book.fails_in_counts_only() && counted.is_none() => {
                    Some(book.failing().map(Line::words).collect::<Vec<_>>().join("; "))
                }
                false => None,
            };
            let Some(why) = again else {
                for why in before {
                    book.leaves_out(&why);
                }
                return book;
            };
            eprintln!("  once more: {why}");
            before.push(format!("attempt {attempt}, done again: {why}"));
            if !stood_still {
                counted = Some(book);
            }
            attempt += 1;
        }
    }

    fn attempt(&self, row: &Row) -> Book {
        eprintln!("== {}: {}", row.name, row.fault);
        let began = Instant::now();
        let mut book = Book::new(row.name, row.fault);
        book.judges_times = !self.gate;
        let ended = catch_unwind(AssertUnwindSafe(|| (row.run)(self, &mut book)));
        match ended {
            Ok(Ok(())) => {}
            Ok(Err(why)) => book.check("the row could be run", 1, Err(why)),
            Err(_) => book.check("the row could be run", 1, Err("it panicked, see above".into())),
        }
        book.took_s = began.elapsed().as_secs_f64();
        book
    }
}
