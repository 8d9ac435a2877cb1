//! The words of a process about components: its own count, and no others.
//!
//! Invariant: a process changes only what is its own, whatever it says; its words may come from a machine
//! that somebody else has taken over. It cannot fill the log.

use parking_lot::Mutex;
use trocar_links::Seldom;
use trocar_model::{ComponentId, Name, Refusal};
use trocar_rt::os::now_ns;

use crate::control::convert;
use crate::lcm::{Detail, HalfReport, Halted, Inventory, News, Report};

/// The process whose words are looked at.
pub(super) struct Own {
    process: Name,
    warned: Mutex<Seldom>,
}

impl Own {
    pub(super) fn new(process: Name) -> Own {
        Own { process, warned: Mutex::default() }
    }

    fn is_own(&self, id: &ComponentId) -> bool {
        id.process == self.process
    }

    fn is_own_half(&self, half: &HalfReport) -> bool {
        half.proxy.as_ref().is_none_or(|proxy| proxy.process == self.process)
    }

    fn is_left_out(&self, what: &str) {
        let said =
            format!("process {} tells of {what}, which is not its own: that is left out", self.process);
        self.warned.lock().warn(now_ns(), &said);
    }

    /// Keeps what is its own.
    fn keep<T>(&self, what: &str, all: &mut Vec<T>, is_own: impl Fn(&T) -> bool) {
        let before = all.len();
        all.retain(is_own);
        if all.len() < before {
            self.is_left_out(what);
        }
    }

    /// # Errors
    /// It is of another process's component.
    pub(super) fn report(&self, report: Report) -> Result<Report, Refusal> {
        if self.is_own(&report.id) {
            return Ok(report);
        }
        self.is_left_out(&report.id.to_string());
        Err(convert::unreadable("report"))
    }

    pub(super) fn halted(&self, mut all: Vec<Halted>) -> Vec<Halted> {
        self.keep("a Stop of other components", &mut all, |halted| self.is_own(&halted.id));
        all
    }

    pub(super) fn details(&self, mut all: Vec<(ComponentId, Detail)>) -> Vec<(ComponentId, Detail)> {
        self.keep("figures of other components", &mut all, |(id, _)| self.is_own(id));
        all
    }

    pub(super) fn inventory(&self, mut inventory: Inventory) -> Inventory {
        self.keep("other components", &mut inventory.components, |report| self.is_own(&report.id));
        self.keep("halves of other processes", &mut inventory.halves, |half| self.is_own_half(half));
        if inventory.card.as_ref().is_some_and(|card| card.process != self.process.as_str()) {
            self.is_left_out("the card of another process");
            inventory.card = None;
        }
        inventory
    }

    /// Returns the news, if they are of what is its own.
    pub(super) fn news(&self, news: News) -> Option<News> {
        let what = match &news {
            News::State(report) if !self.is_own(&report.id) => report.id.to_string(),
            News::Half(half) if !self.is_own_half(half) => "a half of another process".into(),
            News::Log(line) if line.path.split('/').next() != Some(self.process.as_str()) => {
                "the log of others".into()
            }
            // A late answer is made here, of a report that was looked at.
            _ => return Some(news),
        };
        self.is_left_out(&what);
        None
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use trocar_model::{End, Health, Proxy, State};

    use super::*;
    use crate::gcm::fake::{id, name};
    use crate::lcm::LogLine;

    fn told(path: &str) -> Report {
        Report {
            id: id(path),
            number: u64::MAX,
            state: State::Ready,
            health: Health::Ok,
            fault: String::new(),
            ports: None,
            lost_connections: vec![1],
            warnings: Vec::new(),
        }
    }

    fn half(process: &str) -> HalfReport {
        let proxy = Proxy {
            process: name(process),
            epoch: 1,
            why: String::new(),
            carrier: "memfd".into(),
            peer: String::new(),
        };
        HalfReport { connection: 1, end: End::Client, proxy: Some(proxy) }
    }

    fn line(path: &str) -> News {
        let (target, message) = (String::new(), "text".into());
        News::Log(LogLine { wall_ns: 1, level: 3, path: path.into(), target, message })
    }

    #[test]
    fn a_process_tells_of_its_own_and_of_nothing_else() {
        let cart = Own::new(name("cart"));
        assert!(cart.report(told("cart/arm")).is_ok() && cart.report(told("left/arm")).is_err());
        for (news_of, is_heard) in [
            (News::State(told("cart/arm")), true),
            (News::State(told("left/arm")), false),
            (News::Half(half("cart")), true),
            (News::Half(half("left")), false),
            (line("cart/arm"), true),
            (line("cart"), true),
            (line("left/arm"), false),
            (line("cart2"), false),
        ] {
            assert_eq!(cart.news(news_of.clone()).is_some(), is_heard, "{news_of:?}");
        }
        let all = Inventory {
            components: vec![told("cart/arm"), told("left/arm")],
            halves: vec![half("left"), half("cart")],
            ..Inventory::default()
        };
        let kept = cart.inventory(all);
        assert_eq!((kept.components.len(), kept.halves.len()), (1, 1));
        assert_eq!(kept.components[0].id, id("cart/arm"));
    }
}
