//! A record as lines for people.
//!
//! Invariant: one line per change, by the words of plans; an entry without changes is one line.

use prost_types::Timestamp;
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

/// Returns a time of day in UTC, by ISO 8601, to the millisecond.
pub fn time(wall_ns: u64) -> String {
    let (seconds, ms) = (wall_ns / 1_000_000_000, wall_ns / 1_000_000 % 1000);
    let text = Timestamp { seconds: seconds.cast_signed(), nanos: (ms as i32) * 1_000_000 }.to_string();
    // Whole seconds have no fraction there.
    if ms == 0 { text.replace('Z', ".000Z") } else { text }
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
