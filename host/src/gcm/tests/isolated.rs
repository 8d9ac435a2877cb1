//! Processes for isolated components: wanted, made, given up.

use std::collections::BTreeSet;

use super::*;
use crate::gcm::{Fate, Isolated, Supervising, Supervisor, Told};

fn isolated(path: &str) -> Request {
    let written = id(path);
    let (class, execution) = ("arm".to_owned(), Execution::default());
    Request::CreateIsolated {
        id: written.isolated().unwrap(),
        home: written.process,
        class,
        config: None,
        execution,
    }
}

fn supervisor(isolated: &[(&str, &str)], term: u64) -> Supervisor {
    let processes: BTreeSet<_> = [name("host")].into();
    let isolated =
        isolated.iter().map(|(process, home)| Isolated { process: name(process), home: name(home) });
    Supervisor { processes, isolated: isolated.collect(), term }
}

async fn wanted(supervising: &mut Supervising) -> Vec<String> {
    supervising.next().await.isolated.iter().map(|isolated| isolated.process.to_string()).collect()
}

fn told(fate: Fate, pid: u32) -> Told {
    Told { process: name("host.a"), fate, pid, last_exit: "was killed by SIGKILL".into(), restarts: 3 }
}

/// Comes up and goes as it is wanted.
async fn obey(gcm: Gcm, mut supervising: Supervising) {
    while supervising.next().await.isolated.is_empty() {}
    let own = Registration { pid: 99, ..Registration::new(name("host.a"), String::new()) };
    register(&gcm, own, FakeLcm::new("host.a")).await.unwrap();
    while !supervising.next().await.isolated.is_empty() {}
    gcm.told(&told(Fate::Dismissed, 99));
}

#[tokio::test]
async fn without_a_supervisor_it_is_refused_and_nothing_is_wanted() {
    let (gcm, _lcm) = system().await;
    let refused = ask(&gcm, vec![isolated("host/a")]).await.unwrap_err();
    assert_eq!(refused.reason(), "NOT_SUPERVISED");
    assert_eq!(wanted(&mut gcm.supervise(supervisor(&[], 0))).await, Vec::<String>::new());
    let refused = ask(&gcm, vec![isolated("host/a")]).await.unwrap_err();
    assert_eq!(refused.reason(), "NOT_SUPERVISED", "that one does not listen any more");
}

#[tokio::test]
async fn it_is_made_where_its_process_came_up_and_goes_with_it() {
    let (gcm, _lcm) = system().await;
    tokio::spawn(obey(gcm.clone(), gcm.supervise(supervisor(&[], 0))));
    let done = ask(&gcm, vec![isolated("host/a")]).await.unwrap();
    assert_eq!(plan_lines(&done.plan)[0], "+ create host.a/a (toy/arm)");
    assert_eq!(component(&gcm.graph(), "host.a/a").state, State::Ready);
    ask(&gcm, vec![Request::Remove { id: id("host.a/a"), force: false }]).await.unwrap();
    assert_eq!(gcm.graph().processes.keys().map(ToString::to_string).collect::<Vec<_>>(), ["host"]);
}

#[tokio::test]
async fn what_fails_behind_it_in_the_same_request_takes_the_process_back() {
    let (gcm, _lcm) = system().await;
    tokio::spawn(obey(gcm.clone(), gcm.supervise(supervisor(&[], 0))));
    let before = gcm.graph().revision;
    let failing = vec![isolated("host/a"), create("host/b"), start("host/b"), create("host/b")];
    let refused = ask(&gcm, failing).await.unwrap_err();
    assert_eq!(refused.reason(), "COMPONENT_EXISTS", "found before anything was begun");
    assert_eq!((gcm.graph().revision, gcm.graph().processes.len()), (before, 1));
}

#[tokio::test]
async fn one_that_does_not_come_up_is_not_wanted_any_more_and_says_why() {
    let (gcm, _lcm) = system().await;
    let mut supervising = gcm.supervise(supervisor(&[], 0));
    assert!(wanted(&mut supervising).await.is_empty());
    let asked = tokio::spawn({
        let gcm = gcm.clone();
        async move { ask(&gcm, vec![isolated("host/a")]).await }
    });
    assert_eq!(wanted(&mut supervising).await, ["host.a"]);
    gcm.told(&told(Fate::Failed, 99));
    assert!(wanted(&mut supervising).await.is_empty(), "it is taken off the list");
    gcm.told(&told(Fate::Dismissed, 99));
    let refused = asked.await.unwrap().unwrap_err();
    assert_eq!(refused.reason(), "PROCESS_NOT_UP");
    assert!(refused.to_string().contains("it was killed by SIGKILL, and 3 restarts"), "{refused}");
    assert_eq!(gcm.graph().processes.len(), 1);
}

#[tokio::test]
async fn a_list_is_taken_over_from_a_gcm_before_this_one_only() {
    let (gcm, _lcm) = system().await;
    let old = supervisor(&[("host.a", "host")], gcm.term() + 1);
    assert_eq!(wanted(&mut gcm.supervise(old)).await, ["host.a"]);
    let mine = supervisor(&[("host.a", "host"), ("host.b", "host")], gcm.term());
    assert_eq!(wanted(&mut gcm.supervise(mine)).await, ["host.a"], "host.b was given up meanwhile");
    let elsewhere = Supervisor { processes: [name("gui")].into(), ..Supervisor::default() };
    assert!(wanted(&mut gcm.supervise(elsewhere)).await.is_empty(), "beside its own processes only");
}
