//! A thread whose signal mask was changed while it hangs is given one job for it, not one with every look. A
//! change of directory that may be due to a new component, or to a load, is left until that is known.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::env;
use std::process::Command;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use trocar_model::{Change, Component, ComponentId, Execution, Health, Name, Ports, Safety, State};
use trocar_rt::os;

use super::super::Guarded;
use super::{Found, ROUND_NS, Round, Visits, blocked, look_at_directory, mask};
use crate::boundary::puppet::{Behaviour, PuppetClasses, behave, class};
use crate::watchdog::Watchdog;
use crate::{Lcm, LcmConfig, LocalLcm};

const PATIENCE: Duration = Duration::from_secs(120);

struct Idle;

impl Behaviour for Idle {}

fn idle() -> Box<Component> {
    let info = class(Ports::default(), Safety::None);
    Box::new(Component {
        ports: Arc::new(info.ports.clone()),
        class: Arc::new(info),
        config: serde_json::json!({}),
        execution: Execution::default(),
        state: State::Created,
        health: Health::Ok,
        fault: String::new(),
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hung_thread_with_another_signal_mask_has_one_job_waiting_for_it_and_gets_its_own_back() {
    let config = LcmConfig {
        process: Name::parse("hy_mask").unwrap(),
        classes: Some(Arc::new(PuppetClasses)),
        links: None,
        afar: None,
        lock_memory: false,
        allow_exec: false,
    };
    let lcm = LocalLcm::new(config).unwrap();
    let id = ComponentId::parse("hy_mask/c").unwrap();
    behave(&id.to_string(), Arc::new(Idle));
    lcm.apply(Change::Create { id: id.clone(), component: idle() }, (Instant::now() + PATIENCE).into())
        .await
        .unwrap();
    let instance = lcm.instance(&id).unwrap();
    let executor = lcm.executor_of(&instance).unwrap();
    let guarded = Guarded::new(instance, executor.clone());
    let own = executor.settings.hygiene().unwrap().sigmask;
    // Twice: a request that was done can be made again.
    for _ in 0..2 {
        let (tell, told) = channel();
        let (go, wait) = channel::<()>();
        executor.submit(move |_| {
            os::set_sigmask(own ^ 1 << 11);
            tell.send(()).unwrap();
            // The test lets go, or has ended.
            let _ = wait.recv();
        });
        told.recv().unwrap();
        // The watchdog looks as well, whenever it comes to it.
        (0..100).for_each(|_| _ = mask(&[&guarded]));
        assert_eq!(executor.waiting(), 1, "every look has left a job");
        go.send(()).unwrap();
        let mut watchdog = Watchdog::of("the mask is put back");
        while executor.waiting() > 0 || blocked(executor.tid()) != Some(own) {
            let (jobs, mask) = (executor.waiting(), blocked(executor.tid()));
            watchdog.saw(format_args!("{jobs} jobs wait, {mask:?} instead of {own:#x}"));
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }
    lcm.shutdown(PATIENCE).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn masks_are_looked_at_in_turn_each_once_in_a_round() {
    let config = LcmConfig {
        process: Name::parse("hy_round").unwrap(),
        classes: Some(Arc::new(PuppetClasses)),
        links: None,
        afar: None,
        lock_memory: false,
        allow_exec: false,
    };
    let lcm = LocalLcm::new(config).unwrap();
    let mut all_guarded = Vec::new();
    for number in 0..7 {
        let id = ComponentId::parse(&format!("hy_round/c{number}")).unwrap();
        behave(&id.to_string(), Arc::new(Idle));
        lcm.apply(Change::Create { id: id.clone(), component: idle() }, (Instant::now() + PATIENCE).into())
            .await
            .unwrap();
        let instance = lcm.instance(&id).unwrap();
        let executor = lcm.executor_of(&instance).unwrap();
        all_guarded.push(Guarded::new(instance, executor));
    }
    let all_guarded: Vec<&Guarded> = all_guarded.iter().collect();
    let mut round = Round { last_ns: ROUND_NS, last: 0 };
    let mut seen: BTreeMap<u64, u64> = BTreeMap::new();
    for look in 0..200 {
        let due = round.due(2 * ROUND_NS + look * ROUND_NS / 100, &all_guarded);
        assert!(look == 0 || due.len() <= 1, "{} in one look", due.len());
        due.iter().flatten().for_each(|guarded| *seen.entry(guarded.executor.id).or_default() += 1);
    }
    assert_eq!(seen.len(), 7, "{seen:?}");
    assert!(seen.values().all(|times| (2..=3).contains(times)), "one and two rounds after: {seen:?}");
    lcm.shutdown(PATIENCE).await;
}

/// Marks the process made for this test: the directory belongs to the whole process.
const CHILD: &str = "TROCAR_HYGIENE_CHILD";

#[test]
fn the_process_that_is_looked_at() {
    if env::var_os(CHILD).is_none() {
        return;
    }
    let home = env::current_dir().unwrap();
    let look = |all: bool| look_at_directory(&[], || all, Vec::new);
    let place = || env::current_dir().unwrap();
    assert_eq!(look(true), Found::Settled);
    env::set_current_dir("/").unwrap();
    assert_eq!(look(false), Found::TooEarly, "somebody came who is not known yet");
    assert_ne!(place(), home, "nothing is put back before it can be said whose doing it was");
    assert_eq!(look(true), Found::Settled);
    assert_eq!(place(), home);
    // A load that is under way changes it; the load puts it back and says so.
    let loading = trocar_loader::Loading::begin();
    env::set_current_dir("/").unwrap();
    assert_eq!(look(true), Found::TooEarly, "a plugin is being loaded");
    assert_ne!(place(), home);
    drop(loading);
    assert_eq!(look(true), Found::Settled);
    assert_eq!(place(), home);
}

#[test]
fn what_a_newcomer_or_a_load_may_have_done_is_left_until_that_is_known() {
    let child = Command::new(env::current_exe().unwrap())
        .args(["--exact", "supervise::hygiene::tests::the_process_that_is_looked_at", "--nocapture"])
        .env(CHILD, "1")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&child.stdout).into_owned() + &String::from_utf8_lossy(&child.stderr);
    assert!(child.status.success() && said.contains("1 passed"), "{said}");
}

#[test]
fn an_entry_beside_another_is_not_alone_whichever_ends_first() {
    let visits = Visits::new();
    let alone = visits.begin();
    assert!(alone.is_some() && visits.end(alone));
    let (first, second) = (visits.begin(), visits.begin());
    assert!(first.is_some() && second.is_none());
    assert!(!visits.end(second) && !visits.end(first), "somebody was there meanwhile");
    let (first, second) = (visits.begin(), visits.begin());
    assert!(!visits.end(first) && !visits.end(second));
    let alone = visits.begin();
    assert!(visits.end(alone));
}
