//! What is printed at the end: one table for people, or one object for programs.
//!
//! Invariant: every row appears, run or not, and whatever a row left out is named.

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::book::{Book, Line};
use crate::run::{Row, Run};

/// The name of a test as libtest prints it, and as `--exact` takes it.
pub(crate) fn line(book: &Book) -> String {
    format!("test torture::{} ... {}", book.row, if book.holds() { "ok" } else { "FAILED" })
}

pub(crate) fn table(run: &Run, books: &[Book], left: &[&Row]) -> String {
    let mut text = String::from("\n| row | fault | claim | count | bound | seen | control | verdict |\n");
    text.push_str("|---|---|---|---|---|---|---|---|\n");
    for book in books {
        for line in &book.lines {
            let verdict = match book.verdict(line) {
                "FAILS" => "**FAILS**",
                verdict => verdict,
            };
            let Line { what, count, bound, seen, control, .. } = line;
            let (row, fault, seen) = (book.row, book.fault, cell(seen));
            let _ = writeln!(
                text,
                "| {row} | {fault} | {what} | {count} | {bound} | {seen} | {control} | {verdict} |"
            );
        }
        if book.lines.is_empty() {
            let nothing = "nothing was shown";
            let _ = writeln!(text, "| {} | {} | | 0 | | {nothing} | | **FAILS** |", book.row, book.fault);
        }
    }
    let failed: Vec<&str> = books.iter().filter(|book| !book.holds()).map(|book| book.row).collect();
    let _ = writeln!(text);
    for why in not_run(books, left) {
        let _ = writeln!(text, "not run: {why}");
    }
    let seconds: f64 = books.iter().map(|book| book.took_s).sum();
    let how = if run.full { "full counts" } else { "short counts" };
    let how = if run.gate { format!("{how}, durations not judged") } else { how.to_owned() };
    let _ = writeln!(text, "seed {}, {how}, {seconds:.0} s", run.seed);
    for book in books {
        // Once more where it is seen, and whole: the table is long, and its cells are short.
        for line in book.failing() {
            let _ = writeln!(text, "torture::{}: {}", book.row, flat(&line.words()));
        }
    }
    // As libtest says it, since `tests/run` counts by that.
    let (word, held) = (if failed.is_empty() { "ok" } else { "FAILED" }, books.len() - failed.len());
    let _ = writeln!(text, "test result: {word}. {held} passed; {} failed; 0 ignored", failed.len());
    text
}

pub(crate) fn json(run: &Run, books: &[Book], left: &[&Row]) -> Value {
    let line = |line: &Line| {
        json!({
            "claim": line.what, "count": line.count, "bound": line.bound, "seen": line.seen,
            "control": line.control, "holds": line.holds, "of_time": line.of_time,
        })
    };
    let row = |book: &Book| {
        let claims: Vec<Value> = book.lines.iter().map(line).collect();
        json!({
            "row": book.row, "fault": book.fault, "holds": book.holds(), "took_s": book.took_s, "claims": claims,
        })
    };
    let rows: Vec<Value> = books.iter().map(row).collect();
    json!({ "seed": run.seed, "full": run.full, "gate": run.gate, "rows": rows, "not_run": not_run(books, left) })
}

fn not_run(books: &[Book], left: &[&Row]) -> Vec<String> {
    let parts = books.iter().flat_map(|book| book.not_run.iter().map(|why| format!("{}: {why}", book.row)));
    let rows = left.iter().map(|row| format!("{}: {}", row.name, row.fault));
    rows.chain(parts).collect()
}

/// Text in one line, as a cell and a reason are.
fn flat(text: &str) -> String {
    text.replace('\n', " ").replace('|', "/")
}

/// Text that stays in its cell.
fn cell(text: &str) -> String {
    let flat = flat(text);
    if flat.chars().count() <= 300 { flat } else { flat.chars().take(300).chain(['…']).collect() }
}
