//! What a process may tell: of its own components, and of nothing else.
//!
//! Invariant: whatever a process says, its words change only what is its own; they may come from a machine
//! that somebody else has taken over.

use trocar_model::{ComponentId, Name, Refusal};

use crate::control::convert;
use crate::lcm::{HalfReport, Halted, Inventory, News, Report};

fn is_own(process: &Name, id: &ComponentId) -> bool {
    id.process == *process
}

fn of_another(process: &Name, what: &str) {
    log::warn!("process {process} tells of {what}, which is not its own: that is left out");
}

/// # Errors
/// It is of another process's component.
pub(super) fn report(process: &Name, report: Report) -> Result<Report, Refusal> {
    if is_own(process, &report.id) {
        return Ok(report);
    }
    of_another(process, &report.id.to_string());
    Err(convert::unreadable("report"))
}

pub(super) fn halted(process: &Name, mut all: Vec<Halted>) -> Vec<Halted> {
    all.retain(|halted| is_own(process, &halted.id));
    all
}

fn is_own_half(process: &Name, half: &HalfReport) -> bool {
    half.proxy.as_ref().is_none_or(|proxy| proxy.process == *process)
}

/// Leaves out of an inventory what is not its process's own.
pub(super) fn inventory(process: &Name, mut inventory: Inventory) -> Inventory {
    let before = inventory.components.len() + inventory.halves.len();
    inventory.components.retain(|report| is_own(process, &report.id));
    inventory.halves.retain(|half| is_own_half(process, half));
    if inventory.components.len() + inventory.halves.len() < before {
        of_another(process, "components or connections of others");
    }
    if inventory.card.as_ref().is_some_and(|card| card.process != process.as_str()) {
        of_another(process, "another process's card");
        inventory.card = None;
    }
    inventory
}

/// Returns the news, if they are of what is its own.
pub(super) fn news(process: &Name, news: News) -> Option<News> {
    let is_fine = match &news {
        News::State(report) => is_own(process, &report.id),
        News::Half(half) => is_own_half(process, half),
        News::Log(line) => line.path.split('/').next() == Some(process.as_str()),
        // Made here, of an answer that was looked at.
        News::Late(..) => true,
        News::Catalog(_) | News::Warnings(_) | News::StoppedHere(_) => true,
    };
    if !is_fine {
        of_another(process, "what");
        return None;
    }
    Some(news)
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
        let cart = name("cart");
        assert!(report(&cart, told("cart/arm")).is_ok() && report(&cart, told("left/arm")).is_err());
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
            assert_eq!(news(&cart, news_of.clone()).is_some(), is_heard, "{news_of:?}");
        }
        let all = Inventory {
            components: vec![told("cart/arm"), told("left/arm")],
            halves: vec![half("left"), half("cart")],
            ..Inventory::default()
        };
        let kept = inventory(&cart, all);
        assert_eq!((kept.components.len(), kept.halves.len()), (1, 1));
        assert_eq!(kept.components[0].id, id("cart/arm"));
    }
}
