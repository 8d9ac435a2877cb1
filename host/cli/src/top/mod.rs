//! `trocar top`: every process, component and connection, live.
//!
//! Invariant: there is one question to the GCM in each interval, and keys are heard meanwhile. A terminal is
//! left as it was found; there a GCM that goes away is waited for until it comes back. Into a pipe, or with
//! --json, one block or object is printed in each interval.

pub(super) mod rates;

use std::time::{Duration, Instant};

use clap::Args;
use tokio::time::MissedTickBehavior;

use self::rates::{Figures, Sort, between};
use super::failure::{Done, Exit, Failure};
use super::screen::{self, Key, Screen};
use super::session::Session;
use super::view::SystemView;
use super::{out, style, units};

/// Shows every process, component and connection live; q ends it.
#[derive(Args, Debug)]
pub(super) struct TopArgs {
    /// Only this process, component or glob.
    #[arg(default_value = "", hide_default_value = true)]
    path: String,
    /// Between two looks, from 0.1s.
    #[arg(long, default_value = "1s", value_name = "TIME", value_parser = interval)]
    interval: u64,
    /// What components and connections are sorted by; s changes it.
    #[arg(long, value_enum, default_value_t = Sort::Path)]
    sort: Sort,
    /// End after this many intervals.
    #[arg(long, short = 'n', value_name = "N")]
    count: Option<u64>,
}

fn interval(text: &str) -> Result<u64, String> {
    match units::parse_time(text)? {
        ns if (100_000_000..=3_600_000_000_000).contains(&ns) => Ok(ns),
        _ => Err("an interval is from 0.1s to 60min".to_owned()),
    }
}

/// Content and form of what is shown.
struct Shown {
    sort: Sort,
    reversed: bool,
    paused: bool,
    figures: Figures,
    /// Why there are no newer figures.
    trouble: Option<String>,
}

/// Time that a GCM may take to answer when one of its processes does not.
const PATIENCE: Duration = Duration::from_secs(10);

pub(super) async fn run(args: TopArgs, session: &Session) -> Done {
    let mut last = (Instant::now(), look(session, &args.path).await?);
    let mut screen = (!session.json()).then(Screen::open).flatten();
    let mut shown =
        Shown { sort: args.sort, reversed: false, paused: false, figures: Figures::default(), trouble: None };
    let mut tick = tokio::time::interval(Duration::from_nanos(args.interval));
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    // The first one is now, and there is nothing to compare with yet.
    tick.tick().await;
    let mut left = args.count.unwrap_or(u64::MAX);
    let mut asking = None;
    while left > 0 {
        tokio::select! {
            _ = tick.tick(), if asking.is_none() => {
                if !shown.paused {
                    asking = Some(Box::pin(look(session, &args.path)));
                }
                continue;
            }
            answer = answered(&mut asking) => {
                asking = None;
                left -= 1;
                match answer {
                    Ok(now) => shown.take(&mut last, now),
                    // A person sees it and waits; a script has to know.
                    Err(failure) if screen.is_some() => shown.trouble = Some(failure.message),
                    Err(failure) => return Err(failure),
                }
            }
            key = screen::next(&mut screen) => match key {
                Key::Quit => break,
                Key::Sort => shown.sort = shown.sort.next(),
                Key::Reverse => shown.reversed = !shown.reversed,
                Key::Pause => shown.paused = !shown.paused,
            },
        }
        shown.sort_rows();
        print(&shown, screen.as_mut(), session)?;
    }
    Ok(Exit::Ok)
}

async fn look(session: &Session, path: &str) -> Result<SystemView, Failure> {
    let silent =
        || Failure::no_gcm(&session.address(), &format!("no answer within {} s", PATIENCE.as_secs()));
    tokio::time::timeout(PATIENCE, session.list_of(path)).await.unwrap_or_else(|_| Err(silent()))
}

/// Waits for the answer to a question, for ever where there is none.
async fn answered<F: Future<Output = T> + Unpin, T>(asking: &mut Option<F>) -> T {
    match asking {
        Some(asking) => asking.await,
        None => std::future::pending().await,
    }
}

impl Shown {
    fn take(&mut self, last: &mut (Instant, SystemView), now: SystemView) {
        let at = Instant::now();
        self.figures = between(&last.1, &now, (at - last.0).as_secs_f64());
        self.trouble = None;
        *last = (at, now);
    }

    fn sort_rows(&mut self) {
        self.figures.sort(self.sort);
        if self.reversed {
            self.figures.components.reverse();
            self.figures.connections.reverse();
        }
    }

    fn head(&self) -> String {
        let f = &self.figures;
        let sorted =
            format!("sorted by {}{}", self.sort.name(), if self.reversed { ", reversed" } else { "" });
        let paused = if self.paused { "  paused" } else { "" };
        format!(
            "revision {}  {}  {}  {}  {sorted}{paused}   q quit  s sort  r reverse  space pause",
            f.revision,
            units::count(f.processes.len() as u64, "process"),
            units::count(f.components.len() as u64, "component"),
            units::count(f.connections.len() as u64, "connection")
        )
    }
}

fn print(shown: &Shown, screen: Option<&mut Screen>, session: &Session) -> Result<(), Failure> {
    if session.json() {
        return session.print_json(&shown.figures).map(|_| ());
    }
    let Some(screen) = screen else {
        out::text(&(shown.figures.render(false) + "\n"));
        return Ok(());
    };
    let mut text = style::paint(&shown.head(), style::DIM, style::stdout()) + "\n";
    if let Some(trouble) = &shown.trouble {
        let said = format!("no newer figures: {}", out::harmless(trouble));
        text.push_str(&(style::paint(&said, style::BAD, style::stdout()) + "\n"));
    }
    let columns = screen.size().1;
    text.push_str(&shown.figures.render_in(columns, style::stdout()));
    screen.draw(&text);
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum;

    use super::*;

    #[test]
    fn every_way_of_sorting_is_reached_and_named() {
        let mut sort = Sort::Path;
        for known in Sort::ALL {
            assert_eq!(sort, known);
            assert_eq!(
                sort.name(),
                sort.to_possible_value().map(|v| v.get_name().to_owned()).unwrap_or_default()
            );
            sort = sort.next();
        }
        assert_eq!(sort, Sort::Path);
    }

    #[test]
    fn an_interval_has_limits() {
        assert_eq!(interval("0.5s"), Ok(500_000_000));
        assert!(interval("10ms").is_err() && interval("2").is_err());
    }
}
