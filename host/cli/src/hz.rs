//! `trocar hz PATH…`: how often outputs and events come, and how evenly, seen from outside.
//!
//! Invariant: rates come from the sender's own numbers and stamps, so samples lost on the way here do not
//! change them. Periods are taken only between neighbours that were both seen, and their number is printed.

use std::collections::BTreeMap;
use std::time::Duration;

use clap::Args;
use serde::Serialize;

use super::failure::{Done, Exit, Failure};
use super::session::Session;
use super::view::ItemView;
use super::{out, units};

/// Most samples per second that a host looks for on behalf of this command.
const LOOKS_HZ: f64 = 1000.0;

/// Measures rate and jitter of outputs and events: `trocar hz host/robot/measured_cp`.
#[derive(Args, Debug)]
pub(super) struct HzArgs {
    /// process/component/output, or process/component/interface/event.
    #[arg(value_name = "PATH", required = true)]
    paths: Vec<String>,
    /// Over which each line is taken.
    #[arg(long, default_value = "1s", value_name = "TIME", value_parser = units::parse_time)]
    window: u64,
    /// End after this many windows.
    #[arg(long, short = 'n', value_name = "N")]
    count: Option<u64>,
}

/// Samples of one window, and of the time since the last one seen before it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
struct Line {
    path: String,
    /// Rate by the sender's numbers and stamps; 0 = there was no earlier sample to compare with.
    rate_hz: f64,
    /// Number of samples sent up to the last one seen: since the last one of the windows before, or since
    /// the first one.
    sent: u64,
    /// Number of these that were seen.
    seen: u64,
    /// Periods between neighbours that were both seen.
    periods: u64,
    period_avg_ns: f64,
    period_std_ns: f64,
    period_min_ns: u64,
    period_max_ns: u64,
}

/// Samples of one path seen so far.
#[derive(Clone, Debug, Default)]
struct Seen {
    /// Number and stamp, ns. The last sample of the window before begins the next window, and is not
    /// counted in it again.
    first: Option<(u64, u64)>,
    last: Option<(u64, u64)>,
    seen: u64,
    /// True: `first` was seen in a window before.
    goes_on: bool,
    periods: Vec<u64>,
}

impl Seen {
    fn take(&mut self, seq: u64, stamp_ns: u64) {
        if let Some((before, at)) = self.last {
            if seq <= before {
                // The sender began anew.
                *self = Seen::default();
            } else if seq == before + 1 {
                self.periods.push(stamp_ns.saturating_sub(at));
            }
        }
        self.first.get_or_insert((seq, stamp_ns));
        self.last = Some((seq, stamp_ns));
        self.seen += 1;
    }

    /// Closes the window and returns its line.
    fn line(&mut self, path: &str) -> Line {
        let mut line = Line { path: path.to_owned(), seen: self.seen, ..Line::default() };
        if let (Some((from, began)), Some((to, ended))) = (self.first, self.last) {
            line.sent = if self.seen > 0 { to - from + u64::from(!self.goes_on) } else { 0 };
            if ended > began {
                line.rate_hz = (to - from) as f64 * 1e9 / (ended - began) as f64;
            }
        }
        let n = self.periods.len() as f64;
        if n > 0.0 {
            let avg = self.periods.iter().sum::<u64>() as f64 / n;
            let off = self.periods.iter().map(|p| (*p as f64 - avg).powi(2)).sum::<f64>();
            line.periods = self.periods.len() as u64;
            (line.period_avg_ns, line.period_std_ns) = (avg, (off / n).sqrt());
            line.period_min_ns = self.periods.iter().copied().min().unwrap_or_default();
            line.period_max_ns = self.periods.iter().copied().max().unwrap_or_default();
        }
        *self = Seen { first: self.last, last: self.last, goes_on: self.last.is_some(), ..Seen::default() };
        line
    }
}

impl Line {
    fn text(&self) -> String {
        let path = &self.path;
        if self.seen == 0 {
            return format!("{path}  nothing came");
        }
        if self.rate_hz == 0.0 {
            return format!("{path}  1 came; a rate takes two");
        }
        let missed = self.sent - self.seen.min(self.sent);
        let lost = match missed {
            0 => format!("all {} seen", self.sent),
            _ => format!("{} of {} seen from here", self.seen, self.sent),
        };
        let rate = units::rate(self.rate_hz);
        if self.periods == 0 {
            return format!("{path}  {rate}  {lost}: no two neighbours, so no period can be told");
        }
        let time = |ns: f64| units::time(ns.round() as u64);
        format!(
            "{path}  {rate}  period {} ± {}, {} to {}, of {} neighbours  {lost}",
            time(self.period_avg_ns),
            time(self.period_std_ns),
            units::time(self.period_min_ns),
            units::time(self.period_max_ns),
            self.periods,
        )
    }
}

pub(super) async fn run(args: HzArgs, session: &Session) -> Done {
    if let Some(path) = args.paths.iter().find(|p| p.split('/').count() < 3) {
        return Err(Failure::usage(
            format!("{path} is neither an output nor an event"),
            format!("name one of its ports; `trocar describe {path}` lists them"),
        ));
    }
    let mut items = session.subscribe(&args.paths, LOOKS_HZ).await?;
    let mut seen: BTreeMap<String, Seen> = args.paths.iter().map(|p| (p.clone(), Seen::default())).collect();
    let mut window = tokio::time::interval(Duration::from_nanos(args.window));
    window.tick().await;
    let mut left = args.count.unwrap_or(u64::MAX);
    while left > 0 {
        tokio::select! {
            biased;
            _ = window.tick() => {
                left -= 1;
                for (path, seen) in &mut seen {
                    let line = seen.line(path);
                    if session.json() { session.print_json(&line)?; } else { out::say(&line.text()); }
                }
            }
            item = items.next() => match item? {
                Some(ItemView { path, seq, stamp_ns, .. }) => {
                    if let Some(seen) = seen.get_mut(&path) {
                        seen.take(seq, stamp_ns);
                    }
                }
                None => {
                    out::complain("warning", "nothing more comes: what was followed is gone or made anew");
                    break;
                }
            }
        }
    }
    Ok(Exit::Ok)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(items: &[(u64, u64)]) -> Line {
        let mut seen = Seen::default();
        for (seq, ms) in items {
            seen.take(*seq, ms * 1_000_000);
        }
        seen.line("h/a/out")
    }

    #[test]
    fn what_is_lost_on_the_way_does_not_change_the_rate() {
        let all = line(&[(1, 10), (2, 20), (3, 30), (4, 40), (5, 50)]);
        let some = line(&[(1, 10), (2, 20), (5, 50)]);
        assert_eq!((all.rate_hz, some.rate_hz), (100.0, 100.0));
        assert_eq!((all.seen, all.sent, all.periods), (5, 5, 4));
        assert_eq!((some.seen, some.sent, some.periods), (3, 5, 1));
        assert!(all.text().contains("all 5 seen") && some.text().contains("3 of 5 seen"), "{}", some.text());
    }

    #[test]
    fn jitter_is_told_from_neighbours_only() {
        let line = line(&[(1, 0), (2, 9), (3, 20), (7, 60)]);
        assert_eq!((line.period_min_ns, line.period_max_ns, line.periods), (9_000_000, 11_000_000, 2));
        assert_eq!((line.period_avg_ns, line.period_std_ns), (10_000_000.0, 1_000_000.0));
    }

    #[test]
    fn too_little_to_tell_is_said() {
        assert!(line(&[]).text().contains("nothing came"));
        assert!(line(&[(4, 10)]).text().contains("a rate takes two"));
        assert!(line(&[(1, 0), (3, 20)]).text().contains("no period can be told"));
    }

    #[test]
    fn what_comes_seldom_has_a_rate_across_windows() {
        let mut seen = Seen::default();
        seen.take(1, 1_000_000_000);
        assert_eq!(seen.line("e").rate_hz, 0.0, "there was only one");
        assert!(seen.line("e").text().contains("nothing came"));
        seen.take(2, 3_000_000_000);
        let line = seen.line("e");
        assert_eq!((line.rate_hz, line.seen, line.sent, line.periods), (0.5, 1, 1, 1));
        assert!(line.text().contains("all 1 seen"), "{}", line.text());
        seen.take(5, 9_000_000_000);
        let line = seen.line("e");
        assert_eq!((line.rate_hz, line.seen, line.sent, line.periods), (0.5, 1, 3, 0));
    }

    #[test]
    fn neighbours_of_two_windows_are_neighbours() {
        let mut seen = Seen::default();
        for (seq, ms) in [(1, 0), (2, 10), (3, 20)] {
            seen.take(seq, ms * 1_000_000);
        }
        assert_eq!((seen.line("o").sent, seen.seen), (3, 0));
        for (seq, ms) in [(4, 30), (5, 40)] {
            seen.take(seq, ms * 1_000_000);
        }
        let line = seen.line("o");
        assert_eq!((line.rate_hz, line.sent, line.seen, line.periods), (100.0, 2, 2, 2));
    }

    #[test]
    fn a_sender_that_began_anew_is_not_mixed_with_what_it_was() {
        let line = line(&[(100, 0), (101, 10), (1, 500), (2, 510)]);
        assert_eq!((line.seen, line.sent, line.rate_hz), (2, 2, 100.0));
    }
}
