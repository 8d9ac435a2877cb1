//! A GCM that goes on where the one before it ended, and one whose store cannot be written.

use std::sync::Weak;

use serde_json::json;
use trocar_model::{PortId, Wanted, WantedComponent};

use super::super::fate::Fate;
use super::super::{Standing, StartError, Told, Unusable};
use super::kept::Kept;
use super::*;

pub(super) const STOPPED: State = State::Stopped(StopReason::Requested);

pub(super) async fn gcm_with(store: &Kept) -> Gcm {
    Gcm::resume(GcmConfig::default(), Box::new(store.clone())).await.unwrap()
}

/// Lets every task that has something to do come to its next wait.
pub(super) async fn all_run() {
    for _ in 0..100 {
        tokio::task::yield_now().await;
    }
}

/// The GCM after one that ended in the middle of a request.
pub(super) async fn ended_within<T>(asking: tokio::task::JoinHandle<T>, first: Gcm, store: &Kept) -> Gcm {
    asking.abort();
    // It was aborted.
    let _ = asking.await;
    drop(first);
    gcm_with(store).await
}

/// A process and everything that it brings along when it comes back.
pub(super) struct Process {
    pub(super) lcm: Arc<FakeLcm>,
    who: Registration,
}

impl Process {
    pub(super) async fn come(gcm: &Gcm, name_of: &str) -> Process {
        let who = Registration::new(name(name_of), String::new());
        let (lcm, who) = (FakeLcm::new(name_of), Registration { comes_again: true, ..who });
        let mut process = Process { lcm, who };
        process.is_back(gcm).await;
        process
    }

    /// Comes to a GCM as it is.
    pub(super) async fn is_back(&mut self, gcm: &Gcm) -> Registered {
        let registered = register(gcm, self.who.clone(), self.lcm.clone()).await.unwrap();
        self.who.epoch = registered.epoch;
        registered
    }

    /// Notes all that it was told to have, as an uplink does, and the revision.
    pub(super) fn was_told(&mut self, graph: &SystemGraph) {
        let mine = graph.components.iter().filter(|(id, _)| id.process == self.who.process);
        let components = mine.map(|(id, component)| (id.clone(), component.clone())).collect();
        let wires = graph.connections.values().filter(|c| c.ends_in(&self.who.process));
        self.who.slice = Slice { components, connections: wires.cloned().collect() };
    }
}

pub(super) fn connect(client: &str, server: &str) -> Request {
    let port = |text| PortId::parse(text).unwrap();
    Request::Connect { client: port(client), server: port(server), options: Default::default() }
}

fn with_id(id: &str) -> ExecuteOptions {
    ExecuteOptions { request_id: id.into(), identity: "somebody".into(), ..ExecuteOptions::default() }
}

pub(super) fn shown(graph: &SystemGraph) -> Vec<String> {
    graph.components.iter().map(|(id, c)| format!("{id} {} {:?}", c.state, c.health)).collect()
}

#[tokio::test]
async fn revision_connections_and_answers_outlive_the_gcm() {
    let store = Kept::default();
    let first = gcm_with(&store).await;
    let mut host = Process::come(&first, "host").await;
    let made = first.execute(vec![create("host/a")], with_id("make")).await.unwrap();
    let refused = first.execute(vec![create("host/a")], with_id("again")).await.unwrap_err();
    ask(&first, vec![create("host/b"), connect("host/b/input", "host/a/value"), start("host/b")])
        .await
        .unwrap();
    host.was_told(&first.graph());
    let before = first.graph();
    first.flush().await;
    drop(first);

    let second = gcm_with(&store).await;
    assert_eq!(second.graph().revision, before.revision);
    assert_eq!(second.graph().connections, before.connections, "before its process is here");
    assert_eq!(shown(&second.graph()), ["host/a READY Lost", "host/b ACTIVE Lost"]);
    assert_eq!(second.graph().processes[&name("host")].state, ProcessState::Lost);
    let asked = host.lcm.done().len();
    let back = host.is_back(&second).await;
    assert_eq!(back.epoch, before.processes[&name("host")].epoch);
    assert_eq!(shown(&second.graph()), ["host/a READY Ok", "host/b ACTIVE Ok"]);
    let again = second.execute(vec![create("host/a")], with_id("make")).await.unwrap();
    assert_eq!((again.revision, plan_lines(&again.plan)), (made.revision, plan_lines(&made.plan)));
    let refused_again = second.execute(vec![create("host/a")], with_id("again")).await.unwrap_err();
    assert_eq!(refused_again, refused);
    let other = second.execute(vec![create("host/x")], with_id("make")).await.unwrap_err();
    assert_eq!(other.reason(), "ARGUMENT_INVALID", "the id stands for another request: {other}");
    assert_eq!(host.lcm.done().len(), asked, "nothing is done again: {:?}", host.lcm.done());
    let stale = ExecuteOptions { expected_revision: Some(before.revision - 1), ..ExecuteOptions::default() };
    assert_eq!(
        second.execute(vec![create("host/x")], stale).await.unwrap_err().reason(),
        "REVISION_CONFLICT"
    );
    let done = ask(&second, vec![create("host/c"), connect("host/c/input", "host/a/value")]).await.unwrap();
    assert_eq!(done.revision, before.revision + 1);
    assert_eq!(second.graph().connections.len(), 2, "no number of a connection comes back");
}

#[tokio::test]
async fn a_request_that_was_not_decided_when_the_gcm_ended_leaves_nothing() {
    let store = Kept::default();
    let first = gcm_with(&store).await;
    let (mut a, mut b) = (Process::come(&first, "a").await, Process::come(&first, "b").await);
    ask(&first, vec![create("a/arm"), create("a/cam"), connect("a/arm/input", "a/cam/value")]).await.unwrap();
    let before = first.graph();
    b.lcm.hold("Create b/new");
    let requests = vec![
        create("a/new"),
        connect("a/cam/input", "a/new/value"),
        start("a/new"),
        Request::Configure { id: id("a/arm"), patch: json!({ "gain": 9.0 }), execution: None },
        create("b/new"),
    ];
    let asking = tokio::spawn({
        let first = first.clone();
        async move { ask(&first, requests).await }
    });
    b.lcm.hangs("Create b/new").await;
    assert_eq!(a.lcm.state("a/new"), Some(State::Active));
    for process in [&mut a, &mut b] {
        process.was_told(&first.graph());
    }
    let second = ended_within(asking, first, &store).await;
    a.is_back(&second).await;
    b.is_back(&second).await;
    until(&second, "what was not decided is away", |_| a.lcm.state("a/new").is_none()).await;
    let done = a.lcm.done();
    let times = |what: &str| done.iter().filter(|d| *d == what).count();
    assert_eq!(times("Configure a/arm"), 3, "made, changed, and set back: {done:?}");
    assert_eq!(times("Disconnect a/cam/input from a/new/value"), 1, "{done:?}");
    assert_eq!(second.graph().connections, before.connections);
    assert_eq!(second.graph().components[&id("a/arm")].config, before.components[&id("a/arm")].config);
    assert_eq!(shown(&second.graph()), ["a/arm READY Ok", "a/cam READY Ok"]);
    ask(&second, vec![create("a/new")]).await.unwrap();
}

#[tokio::test]
async fn what_was_stopped_while_its_process_was_away_stands_still_at_the_next_gcm() {
    let store = Kept::default();
    let first = gcm_with(&store).await;
    let mut host = Process::come(&first, "host").await;
    ask(&first, vec![create("host/arm"), create("host/cam"), start("host/*")]).await.unwrap();
    host.was_told(&first.graph());
    let session = first.inner.sessions.lock().holder(&name("host")).unwrap();
    first.lost(&name("host"), session);
    assert_eq!(ask(&first, vec![stop("host/arm")]).await.unwrap_err().reason(), "STOP_NOT_TOLD");
    first.flush().await;
    drop(first);
    let second = gcm_with(&store).await;
    host.is_back(&second).await;
    until(&second, "it is stopped", |graph| component(graph, "host/arm").state == STOPPED).await;
    assert_eq!(host.lcm.state("host/arm"), Some(STOPPED));
    assert_eq!(host.lcm.state("host/cam"), Some(State::Active), "nobody stopped that");
}

#[tokio::test]
async fn another_incarnation_gets_back_what_the_gcm_before_had_decided() {
    let store = Kept::default();
    let first = gcm_with(&store).await;
    Process::come(&first, "host").await;
    ask(&first, vec![create("host/a"), create("host/b"), start("host/a")]).await.unwrap();
    drop(first);
    let second = gcm_with(&store).await;
    let again = Process::come(&second, "host").await;
    let attached = |graph: &SystemGraph| graph.processes[&name("host")].state == ProcessState::Attached;
    until(&second, "all is made again", attached).await;
    assert_eq!(again.lcm.state("host/a"), Some(State::Stopped(StopReason::Restarted)));
    assert_eq!(again.lcm.state("host/b"), Some(State::Ready));
}

#[tokio::test]
async fn a_process_that_was_taken_down_is_not_expected_any_more() {
    let store = Kept::default();
    let first = gcm_with(&store).await;
    let host = Process::come(&first, "host").await;
    ask(&first, vec![create("host/a")]).await.unwrap();
    let (process, last_exit) = (name("host"), String::new());
    first.told(&Told { process, fate: Fate::Dismissed, pid: host.who.pid, last_exit, restarts: 0 });
    first.flush().await;
    drop(first);
    let second = gcm_with(&store).await;
    assert!(second.graph().processes.is_empty() && second.graph().components.is_empty());
}

#[tokio::test]
async fn a_gcm_that_knows_less_than_a_process_learns_from_it() {
    // Its journal was lost.
    let store = Kept::default();
    let first = gcm_with(&Kept::default()).await;
    let mut host = Process::come(&first, "host").await;
    ask(&first, vec![create("host/a"), create("host/b"), connect("host/b/input", "host/a/value")])
        .await
        .unwrap();
    ask(&first, vec![start("host/a")]).await.unwrap();
    host.was_told(&first.graph());
    host.who.revision = first.graph().revision;
    let before = first.graph();
    drop(first);
    let second = gcm_with(&store).await;
    host.is_back(&second).await;
    assert_eq!(shown(&second.graph()), ["host/a ACTIVE Ok", "host/b READY Ok"]);
    assert_eq!(second.graph().connections, before.connections);
    assert_eq!(second.graph().revision, before.revision, "no number of a revision comes back");
    second.flush().await;
    assert_eq!(host.lcm.state("host/a"), Some(State::Active));
    drop(second);
    let third = gcm_with(&store).await;
    assert_eq!(third.graph().connections, before.connections, "what it learned is on record");
    host.is_back(&third).await;
    all_run().await;
    assert_eq!(host.lcm.state("host/a"), Some(State::Active));
    assert_eq!(shown(&third.graph()), ["host/a ACTIVE Ok", "host/b READY Ok"]);
}

#[tokio::test]
async fn what_was_stopped_before_its_process_was_known_is_stopped_when_it_comes() {
    let first = gcm_with(&Kept::default()).await;
    let mut host = Process::come(&first, "host").await;
    ask(&first, vec![create("host/a"), create("host/b"), start("host/*")]).await.unwrap();
    host.was_told(&first.graph());
    host.who.revision = first.graph().revision;
    drop(first);
    let store = Kept::default();
    let second = gcm_with(&store).await;
    for _ in 0..20 {
        assert_eq!(ask(&second, vec![stop("host/a")]).await.unwrap_err().reason(), "PROCESS_NOT_FOUND");
    }
    host.is_back(&second).await;
    until(&second, "it is stopped", |_| host.lcm.state("host/a") == Some(STOPPED)).await;
    assert_eq!(host.lcm.state("host/b"), Some(State::Active), "nobody has stopped it");
    all_run().await;
    second.flush().await;
    assert_eq!(store.wanted().components[&id("host/a")].grant, None);
    assert!(store.wanted().components[&id("host/b")].grant.is_some());
    ask(&second, vec![start("host/a")]).await.unwrap();
    assert_eq!(host.lcm.state("host/a"), Some(State::Active));
}

#[tokio::test]
async fn a_store_that_is_full_keeps_nobody_waiting_and_misses_nothing_later() {
    let store = Kept::default();
    let gcm = gcm_with(&store).await;
    Process::come(&gcm, "host").await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    assert_eq!(*gcm.journal().borrow(), Standing::Written);
    store.fail(Some(Unusable::Now));
    ask(&gcm, vec![create("host/b")]).await.unwrap();
    ask(&gcm, vec![stop("host/b")]).await.unwrap();
    let mut standing = gcm.journal();
    let behind = standing.borrow().clone();
    assert!(matches!(&behind, Standing::Behind { why } if why.contains("full")), "{behind:?}");
    store.fail(None);
    comes("the store has room again", standing.wait_for(|standing| *standing == Standing::Written))
        .await
        .unwrap();
    ask(&gcm, vec![create("host/c")]).await.unwrap();
    gcm.flush().await;
    let wanted = store.wanted();
    assert_eq!(wanted, *gcm.inner.ledger.wanted());
    assert_eq!(wanted.components.len(), 3);
    assert_eq!(store.texts().len(), 4, "{:?}", store.texts());
}

#[tokio::test]
async fn a_store_that_is_damaged_is_not_begun_with_and_one_that_is_away_is() {
    let store = Kept::default();
    for unusable in [Unusable::Damaged, Unusable::Newer, Unusable::InUse] {
        store.fail(Some(unusable));
        let refused = Gcm::resume(GcmConfig::default(), Box::new(store.clone())).await.err().unwrap();
        assert!(matches!(refused, StartError::Store(_)), "{unusable:?}: {refused}");
    }
    store.fail(Some(Unusable::Now));
    let gcm = gcm_with(&store).await;
    Process::come(&gcm, "host").await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    assert!(matches!(&*gcm.journal().borrow(), Standing::Behind { .. }));
}

#[tokio::test]
async fn refused_requests_and_stops_are_on_record() {
    let store = Kept::default();
    let gcm = gcm_with(&store).await;
    Process::come(&gcm, "host").await;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    ask(&gcm, vec![create("host/a")]).await.unwrap_err();
    ask(&gcm, vec![stop("host/**")]).await.unwrap();
    gcm.flush().await;
    let held = store.0.lock();
    let told: Vec<_> =
        held.all.iter().filter_map(|r| Some((r.asked.as_ref()?, r.answer.as_ref()?))).collect();
    assert_eq!(told.len(), 3);
    assert!(told[1].1.is_err() && told[1].0.text.contains("host/a"), "{told:?}");
    assert!(told[2].1.is_ok() && told[2].0.text.contains(r#""stop""#), "{told:?}");
}

#[tokio::test]
async fn the_gcm_is_gone_with_its_last_handle_although_it_has_a_store() {
    let gcm = gcm_with(&Kept::default()).await;
    let inner: Weak<_> = Arc::downgrade(&gcm.inner);
    gcm.flush().await;
    drop(gcm);
    let mut watchdog = crate::watchdog::Watchdog::of("the GCM to go");
    while inner.upgrade().is_some() {
        watchdog.saw("it is there");
        tokio::task::yield_now().await;
    }
}

/// The part of a graph that outlives the GCM.
fn desired(graph: &SystemGraph) -> Wanted {
    let wanted = |component: &Component| WantedComponent {
        class: component.class.clone(),
        config: component.config.clone(),
        execution: component.execution.clone(),
        state: component.state,
        grant: None,
    };
    Wanted {
        revision: graph.revision,
        components: graph.components.iter().map(|(id, c)| (id.clone(), wanted(c))).collect(),
        connections: graph.connections.iter().map(|(id, c)| (*id, c.clone())).collect(),
        ..Wanted::default()
    }
}

#[tokio::test]
async fn at_rest_what_is_wanted_is_what_the_graph_has_and_the_store_tells() {
    let store = Kept::default();
    let gcm = gcm_with(&store).await;
    let host = Process::come(&gcm, "host").await;
    let other = Process::come(&gcm, "other").await;
    for (at, refuse) in
        ["Start host/b", "Create host/b", "Connect host/b/input to host/a/value"].iter().enumerate()
    {
        host.lcm.refuse(refuse);
        let all = vec![
            create("host/a"),
            create("host/b"),
            connect("host/b/input", "host/a/value"),
            start("host/*"),
        ];
        ask(&gcm, all).await.unwrap_err();
        let name_of = format!("other/c{at}");
        ask(&gcm, vec![create(&name_of), start(&name_of)]).await.unwrap();
        ask(&gcm, vec![stop("other/*")]).await.unwrap();
    }
    let configure = Request::Configure { id: id("other/c0"), patch: json!({ "gain": 2.0 }), execution: None };
    ask(&gcm, vec![configure, connect("other/c1/input", "other/c0/value")]).await.unwrap();
    ask(&gcm, vec![Request::Remove { id: id("other/c2"), force: true }, start("other/c1")]).await.unwrap();
    gcm.flush().await;
    let live = gcm.inner.ledger.wanted().clone();
    assert_eq!(store.wanted(), live);
    let mut seen = desired(&gcm.graph());
    (seen.term, seen.decision) = (live.term, live.decision);
    seen.next_connection = live.next_connection;
    seen.processes.clone_from(&live.processes);
    for (id, component) in &mut seen.components {
        component.grant = live.components.get(id).and_then(|wanted| wanted.grant);
        assert_eq!(component.grant.is_some(), component.state == State::Active, "{id}");
    }
    assert_eq!(live, seen);
    drop((host, other));
}

#[tokio::test]
async fn what_was_begun_is_taken_away_also_where_something_is_missing() {
    let store = Kept::default();
    let first = gcm_with(&store).await;
    let (mut a, mut b) = (Process::come(&first, "a").await, Process::come(&first, "b").await);
    ask(&first, vec![create("a/arm"), create("a/cam")]).await.unwrap();
    b.lcm.hold("Create b/new");
    let removes = Request::Remove { id: id("a/cam"), force: true };
    let begun = vec![removes, create("a/new"), start("a/new"), start("a/arm"), create("b/new")];
    let asking = tokio::spawn({
        let first = first.clone();
        async move { ask(&first, begun).await }
    });
    b.lcm.hangs("Create b/new").await;
    assert_eq!(a.lcm.state("a/arm"), Some(State::Active));
    a.was_told(&first.graph());
    b.was_told(&first.graph());
    let second = ended_within(asking, first, &store).await;
    a.is_back(&second).await;
    b.is_back(&second).await;
    let whole = |graph: &SystemGraph| graph.processes[&name("a")].state == ProcessState::Attached;
    until(&second, "all is as it was decided", |graph| whole(graph) && a.lcm.state("a/new").is_none()).await;
    assert_eq!(a.lcm.state("a/cam"), Some(State::Ready), "it is made again");
    assert_eq!(a.lcm.state("a/arm"), Some(STOPPED), "nobody was told that it moves");
}

#[tokio::test]
async fn a_journal_that_is_behind_believes_each_process_that_knows_more() {
    let (full, store) = (Kept::default(), Kept::default());
    let first = gcm_with(&full).await;
    let (mut a, mut b) = (Process::come(&first, "a").await, Process::come(&first, "b").await);
    ask(&first, vec![create("a/old"), create("b/old")]).await.unwrap();
    first.flush().await;
    {
        let (mut old, full) = (store.0.lock(), full.0.lock());
        old.records.clone_from(&full.records);
    }
    ask(&first, vec![create("a/new"), create("b/new"), connect("b/new/input", "a/new/value")]).await.unwrap();
    ask(&first, vec![start("a/new"), start("b/new")]).await.unwrap();
    let before = first.graph();
    for process in [&mut a, &mut b] {
        process.was_told(&before);
        process.who.revision = before.revision;
    }
    drop(first);
    let second = gcm_with(&store).await;
    assert_eq!(second.graph().components.len(), 2, "it knows less");
    a.is_back(&second).await;
    b.is_back(&second).await;
    let all = |graph: &SystemGraph| graph.connections == before.connections && graph.components.len() == 4;
    until(&second, "what both know is there", all).await;
    all_run().await;
    for (process, path) in [(&a, "a/new"), (&b, "b/new")] {
        assert_eq!(process.lcm.state(path), Some(State::Active), "{:?}", process.lcm.done());
    }
    assert_eq!(second.graph().revision, before.revision);
}

#[tokio::test]
async fn a_start_that_a_stop_has_overtaken_is_no_grant() {
    let store = Kept::default();
    let gcm = gcm_with(&store).await;
    let host = Process::come(&gcm, "host").await;
    ask(&gcm, vec![create("host/a"), create("host/b")]).await.unwrap();
    host.lcm.hold("Start host/b");
    let starting = tokio::spawn({
        let gcm = gcm.clone();
        async move { ask(&gcm, vec![start("host/a"), start("host/b")]).await }
    });
    host.lcm.hangs("Start host/b").await;
    ask(&gcm, vec![stop("host/a")]).await.unwrap();
    host.lcm.release("Start host/b");
    starting.await.unwrap().unwrap();
    gcm.flush().await;
    let wanted = store.wanted();
    let state =
        |path: &str| (wanted.components[&id(path)].state, wanted.components[&id(path)].grant.is_some());
    assert_eq!((state("host/a"), state("host/b")), ((STOPPED, false), (State::Active, true)));
}

#[tokio::test]
async fn what_could_not_be_taken_back_is_wanted() {
    let store = Kept::default();
    let first = gcm_with(&store).await;
    let mut host = Process::come(&first, "host").await;
    host.lcm.refuse("Create host/b");
    host.lcm.refuse("Remove host/a");
    ask(&first, vec![create("host/a"), create("host/b")]).await.unwrap_err();
    assert_eq!(shown(&first.graph()), ["host/a CREATED Ok"], "it could not be taken back");
    let configure = Request::Configure { id: id("host/a"), patch: json!({ "gain": 2.0 }), execution: None };
    ask(&first, vec![configure, start("host/a")]).await.unwrap();
    host.was_told(&first.graph());
    first.flush().await;
    drop(first);
    let second = gcm_with(&store).await;
    host.is_back(&second).await;
    all_run().await;
    assert_eq!(shown(&second.graph()), ["host/a ACTIVE Ok"]);
    assert_eq!(host.lcm.state("host/a"), Some(State::Active));
}

#[tokio::test]
async fn what_failed_is_on_record() {
    let store = Kept::default();
    let gcm = gcm_with(&store).await;
    let host = Process::come(&gcm, "host").await;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    host.lcm.become_state("host/a", State::Fault, "it broke");
    until(&gcm, "it is seen", |graph| component(graph, "host/a").state == State::Fault).await;
    let is_noted = || gcm.inner.ledger.wanted().components[&id("host/a")].grant.is_none();
    let mut watchdog = crate::watchdog::Watchdog::of("its failure to be noted");
    while !is_noted() {
        watchdog.saw("it has its grant");
        tokio::task::yield_now().await;
    }
    gcm.flush().await;
    assert_eq!(store.wanted().components[&id("host/a")].state, State::Fault);
}

#[tokio::test]
async fn a_component_of_another_class_than_was_decided_is_made_anew() {
    let store = Kept::default();
    let first = gcm_with(&store).await;
    let mut host = Process::come(&first, "host").await;
    ask(&first, vec![create("host/a"), create("host/b"), connect("host/b/input", "host/a/value")])
        .await
        .unwrap();
    let before = first.graph();
    host.was_told(&before);
    // A request that was not decided has made it anew, of a newer plugin.
    for (_, component) in host.who.slice.components.iter_mut().filter(|(path, _)| *path == id("host/a")) {
        let class = trocar_model::ClassInfo { hash: "01".into(), ..(*component.class).clone() };
        component.class = Arc::new(class);
    }
    first.flush().await;
    drop(first);
    let second = gcm_with(&store).await;
    host.is_back(&second).await;
    let asked = |what: &str| host.lcm.done().iter().filter(|d| *d == what).count();
    let again = |graph: &SystemGraph| graph.processes[&name("host")].state == ProcessState::Attached;
    until(&second, "it is made anew", |graph| again(graph) && asked("Create host/a") == 2).await;
    assert_eq!((asked("Remove host/a"), asked("Create host/b")), (1, 1), "{:?}", host.lcm.done());
    assert_eq!(second.graph().connections, before.connections);
    assert_eq!(asked("Connect host/b/input to host/a/value"), 2, "{:?}", host.lcm.done());
}

#[tokio::test]
async fn a_store_that_breaks_or_hangs_keeps_nobody_waiting() {
    for breaks in [true, false] {
        let store = Kept::default();
        let gcm = gcm_with(&store).await;
        Process::come(&gcm, "host").await;
        let (release, hangs) = std::sync::mpsc::channel::<()>();
        {
            let mut held = store.0.lock();
            held.breaks = breaks;
            held.hangs = (!breaks).then_some(hangs);
        }
        ask(&gcm, vec![create("host/a")]).await.unwrap();
        assert!(matches!(&*gcm.journal().borrow(), Standing::Behind { .. }), "breaks: {breaks}");
        ask(&gcm, vec![stop("host/a")]).await.unwrap();
        drop(release);
        if !breaks {
            let mut standing = gcm.journal();
            comes("it is written", standing.wait_for(|standing| *standing == Standing::Written))
                .await
                .unwrap();
            gcm.flush().await;
            assert_eq!(store.wanted().components.len(), 1);
        }
    }
}
