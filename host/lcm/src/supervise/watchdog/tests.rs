//! The watchdog's own lateness, and the cost of a look beside many components at rest.
#![allow(clippy::unwrap_used)]

use std::time::{Duration, Instant};

use trocar_model::{Change, Component, ComponentId, Execution, Health, Name, Ports, Safety, State, Verb};

use super::super::lateness::WAKING_NS;
use super::super::observed::LEAVE_NS;
use super::super::strangers::lists;
use super::*;
use crate::boundary::puppet::{Behaviour, PuppetClasses, behave, class};
use crate::{Lcm, LcmConfig, LocalLcm};

const MS: u64 = 1_000_000;
const PATIENCE: Duration = Duration::from_secs(120);

#[test]
fn a_pause_of_the_machine_is_nobody_s_doing_who_was_inside_during_it() {
    let mut late = Lateness::default();
    late.look(10 * MS, 10 * MS);
    // Due at 15 ms, and the machine stood from 12 to 80 ms.
    late.look(15 * MS, 80 * MS);
    let whole = 65 * MS - WAKING_NS;
    assert_eq!((late.now_ns, late.before_ns), (whole, 0));
    assert_eq!(late.at(12 * MS, 80 * MS), 0, "all of it came afterwards");
    assert_eq!(late.at(78 * MS, 80 * MS), whole - 2 * MS, "what began when it was nearly over");
    assert_eq!(late.at(80 * MS, 80 * MS), whole);
    late.look(85 * MS, 85 * MS);
    assert_eq!(late.at(82 * MS, 85 * MS), whole, "what began when it was over");
}

struct Idle;

impl Behaviour for Idle {}

/// Makes so many components of a process that were started and then stopped.
async fn stopped(process: &str, count: usize) -> (Arc<LocalLcm>, Roster) {
    let config = LcmConfig {
        process: Name::parse(process).unwrap(),
        classes: Some(Arc::new(PuppetClasses)),
        links: None,
        afar: None,
        lock_memory: false,
        allow_exec: false,
    };
    let lcm = LocalLcm::new(config).unwrap();
    let roster = Roster::default();
    for number in 0..count {
        let id = ComponentId::parse(&format!("{process}/c{number}")).unwrap();
        behave(&id.to_string(), Arc::new(Idle));
        let info = class(Ports::default(), Safety::None);
        let component = Box::new(Component {
            ports: Arc::new(info.ports.clone()),
            class: Arc::new(info),
            config: serde_json::json!({}),
            execution: Execution::default(),
            state: State::Created,
            health: Health::Ok,
            fault: String::new(),
        });
        let (from, to) = (serde_json::json!({}), serde_json::json!({}));
        let (from_state, to_state) = (State::Created, State::Ready);
        let run = |verb| Change::Run { id: id.clone(), verb, from: State::Ready, to: State::Active };
        for change in [
            Change::Create { id: id.clone(), component },
            Change::Configure { id: id.clone(), from, to, from_state, to_state },
            run(Verb::Start),
            run(Verb::Stop),
        ] {
            lcm.apply(change, (Instant::now() + PATIENCE).into()).await.unwrap();
        }
        let instance = lcm.instance(&id).unwrap();
        let executor = lcm.executor_of(&instance).unwrap();
        roster.add(Guarded::new(instance, executor));
    }
    (lcm, roster)
}

#[tokio::test(flavor = "multi_thread")]
async fn threads_are_listed_once_for_all_that_come_to_rest_and_not_once_for_each() {
    for (process, count) in [("wd_one", 1), ("wd_many", 400)] {
        let (lcm, roster) = stopped(process, count).await;
        let mut rounds = Rounds::default();
        rounds.take(roster.all());
        let hub = rounds.all_observed[0].guarded.instance.hub.clone();
        let seen_ns = os::now_ns();
        let mut listed = |now_ns: u64| {
            let before = lists();
            rounds.look(now_ns);
            rounds.look_around(&hub, now_ns, &roster);
            lists() - before
        };
        let costs = [seen_ns, seen_ns + LEAVE_NS, seen_ns + 2 * LEAVE_NS].map(&mut listed);
        assert_eq!(costs, [0, 1, 0], "stopped, at rest and afterwards, of {count} components");
        lcm.shutdown(PATIENCE).await;
    }
}
