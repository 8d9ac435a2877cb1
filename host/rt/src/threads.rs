//! The threads of this process as the kernel lists them.
//!
//! Invariant: a thread is identified by its number and its begin: numbers are given again.

use std::collections::BTreeSet;
use std::fs;

/// Most times the list is read after the first time.
const LISTS: usize = 16;

/// Lists the threads of this process, by kernel id. The kernel counts its way through them, so its list
/// leaves one out for each that ends before the reader's place meanwhile. The next list lacks that one, so
/// two lists that are the same are whole.
pub fn list() -> BTreeSet<i32> {
    let listed = || -> BTreeSet<i32> {
        let tasks = fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
        tasks.filter_map(|t| t.file_name().to_str()?.parse().ok()).collect()
    };
    let mut last = listed();
    let mut all = last.clone();
    for _ in 0..LISTS {
        let next = listed();
        if next == last {
            return next;
        }
        all.extend(&next);
        last = next;
    }
    // Too many threads come and go: better one ended thread too many, whose name is empty, than one running
    // thread too few.
    all
}

/// Returns the time a thread of this process began, ticks since boot, so that a number given again can be
/// told apart; 0 when it is gone.
pub fn began(tid: i32) -> u64 {
    let text = word(tid, "stat");
    // The name before the last parenthesis may hold anything; the 20th word after it is the time.
    let after = text.rfind(')').map_or("", |at| &text[at + 1..]);
    after.split_ascii_whitespace().nth(19).and_then(|word| word.parse().ok()).unwrap_or(0)
}

/// Returns the name of a thread of this process; empty when it is gone.
pub fn name(tid: i32) -> String {
    word(tid, "comm").trim_end().to_owned()
}

fn word(tid: i32, what: &str) -> String {
    fs::read_to_string(format!("/proc/self/task/{tid}/{what}")).unwrap_or_default()
}
