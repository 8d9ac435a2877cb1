//! A record as lines for people.
//!
//! Invariant: one line per change, by the words of plans; an entry without changes is one line.

use trocar_model::{Entry, Plan};

use crate::gcm::{Record, plan_lines};

/// Returns what was decided, as lines for people.
pub fn lines(record: &Record) -> Vec<String> {
    let mut said = match &record.entry {
        Entry::Changed { changes, .. } => {
            return plan_lines(&Plan { changes: changes.clone(), skipped: Vec::new() });
        }
        Entry::Stopped { targets, .. } => {
            let targets: Vec<String> = targets.iter().map(ToString::to_string).collect();
            vec![format!("- stop {}", targets.join(", "))]
        }
        Entry::Cut { connections, .. } => {
            connections.iter().map(|id| format!("- connection {} is gone", id.0)).collect()
        }
        Entry::Came { process, incarnation } => {
            vec![format!("+ process {process} came (epoch {})", incarnation.epoch)]
        }
        Entry::Brought { process, components, connections, .. } => {
            let brought = components.iter().map(|(id, c)| {
                format!("+ process {process} brought {id} ({}, {})", c.class.full_name(), c.state)
            });
            let connected = connections.iter().map(|c| {
                format!("+ process {process} brought {} → {} (connection {})", c.server, c.client, c.id.0)
            });
            brought.chain(connected).collect()
        }
        Entry::Gone { process, epoch: 0, .. } => vec![format!("- process {process} is gone")],
        Entry::Gone { process, epoch, .. } => vec![format!("- process {process} is gone (epoch {epoch})")],
        Entry::Failed { component } => vec![format!("- {component} failed")],
        Entry::Noted => Vec::new(),
    };
    if let Some(Ok(done)) = &record.answer {
        said.extend(plan_lines(&done.plan));
    }
    said
}

/// Returns the revision that a record leads to; `None`: it leads to none.
pub fn revision(record: &Record) -> Option<u64> {
    match &record.entry {
        Entry::Changed { revision, .. }
        | Entry::Stopped { revision, .. }
        | Entry::Cut { revision, .. }
        | Entry::Brought { revision, .. }
        | Entry::Gone { revision, .. } => Some(*revision),
        Entry::Came { .. } | Entry::Failed { .. } | Entry::Noted => None,
    }
}

/// Returns a time of day in UTC, by ISO 8601, to the millisecond.
pub fn time(wall_ns: u64) -> String {
    let ms = wall_ns / 1_000_000;
    let (s, ms) = (ms / 1000, ms % 1000);
    let (year, month, day) = date(s / 86_400);
    let (hour, minute, second) = (s / 3600 % 24, s / 60 % 60, s % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}Z")
}

/// Year, month and day of a day counted from 1970-01-01, in the calendar that repeats every 400 years.
fn date(days: u64) -> (u64, u64, u64) {
    // Counted from 0000-03-01, so that the leap day is the last of a year.
    let days = days + 719_468;
    let (era, day) = (days / 146_097, days % 146_097);
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let (month, next) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    (era * 400 + year + next, month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar() {
        let days = [(0, "1970-01-01"), (59, "1970-03-01"), (11_016, "2000-02-29"), (20_454, "2026-01-01")];
        for (day, said) in days {
            assert_eq!(time(day * 86_400_000_000_000), format!("{said}T00:00:00.000Z"));
        }
        assert_eq!(time(1_709_210_096_789_000_000), "2024-02-29T12:34:56.789Z");
    }
}
