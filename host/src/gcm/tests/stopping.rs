//! Stop is an order, whatever the GCM believes, and whatever else is under way.

use trocar_lcm_api::{News, StoppedHere};

use super::super::Told;
use super::super::fate::Fate;
use super::super::stop::worst;
use super::*;

const STOPPED: State = State::Stopped(StopReason::Requested);

fn stops(paths: &[&str]) -> Request {
    Request::Stop { targets: paths.iter().map(|path| Target::parse(path).unwrap()).collect() }
}

async fn running(paths: &[&str]) -> (Gcm, Arc<FakeLcm>) {
    let (gcm, lcm) = system().await;
    let made = paths.iter().map(|path| create(path)).chain([start("host/*")]);
    ask(&gcm, made.collect()).await.unwrap();
    (gcm, lcm)
}

#[tokio::test]
async fn a_name_that_is_not_there_keeps_nothing_from_being_stopped() {
    let (gcm, lcm) = running(&["host/arm", "host/cam"]).await;
    let done = ask(&gcm, vec![stops(&["host/amr", "host/arm", "hots/arm", "host/x*"])]).await.unwrap();
    assert_eq!(lcm.state("host/arm"), Some(STOPPED));
    assert_eq!(lcm.state("host/cam"), Some(State::Active));
    let mut failed: Vec<_> = done.failed.iter().map(|(t, r)| (t.to_string(), r.reason())).collect();
    failed.sort();
    let want = [
        ("host/amr".to_owned(), "COMPONENT_NOT_FOUND"),
        ("host/x*".to_owned(), "NOTHING_MATCHES"),
        ("hots/arm".to_owned(), "PROCESS_NOT_FOUND"),
    ];
    assert_eq!(failed, want);
    assert_eq!(ask(&gcm, vec![stops(&["host/amr"])]).await.unwrap_err().reason(), "COMPONENT_NOT_FOUND");
    // A dry run says the same, and stops nothing.
    let options = ExecuteOptions { validate_only: true, ..ExecuteOptions::default() };
    let would = gcm.execute(vec![stops(&["host/amr", "host/cam"])], options).await.unwrap();
    assert_eq!((would.failed.len(), would.plan.changes.len()), (1, 1));
    assert_eq!(lcm.state("host/cam"), Some(State::Active));
}

#[tokio::test]
async fn what_an_lcm_has_is_stopped_although_the_graph_does_not_know_it() {
    let (gcm, lcm) = system().await;
    lcm.become_state("host/stray", State::Active, "");
    ask(&gcm, vec![stop("host/stray")]).await.unwrap();
    assert_eq!(lcm.state("host/stray"), Some(STOPPED));
    lcm.become_state("host/stray", State::Active, "");
    ask(&gcm, vec![stop("**")]).await.unwrap();
    assert_eq!(lcm.state("host/stray"), Some(STOPPED));
}

#[tokio::test]
async fn a_stop_with_an_id_that_was_used_stops() {
    let (gcm, lcm) = running(&["host/a"]).await;
    let with_id = || ExecuteOptions { request_id: "again".into(), ..ExecuteOptions::default() };
    for _ in 0..2 {
        gcm.execute(vec![stop("host/a")], with_id()).await.unwrap();
        assert_eq!(lcm.state("host/a"), Some(STOPPED), "answered from memory");
        ask(&gcm, vec![start("host/a")]).await.unwrap();
    }
    // Also where another request had it.
    gcm.execute(
        vec![create("host/b")],
        ExecuteOptions { request_id: "b".into(), ..ExecuteOptions::default() },
    )
    .await
    .unwrap();
    let options = ExecuteOptions { request_id: "b".into(), ..ExecuteOptions::default() };
    gcm.execute(vec![stop("host/a")], options).await.unwrap();
    assert_eq!(lcm.state("host/a"), Some(STOPPED));
}

#[tokio::test]
async fn a_start_that_waits_for_its_turn_when_a_stop_comes_starts_nothing() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    let configure =
        Request::Configure { id: id("host/a"), patch: serde_json::json!({ "gain": 2.0 }), execution: None };
    lcm.hold("Configure host/a");
    let configuring = tokio::spawn({
        let gcm = gcm.clone();
        async move { ask(&gcm, vec![configure]).await }
    });
    lcm.hangs("Configure host/a").await;
    let mut starting = std::pin::pin!(ask(&gcm, vec![start("host/a")]));
    begun(starting.as_mut()).await;
    ask(&gcm, vec![stop("host/a")]).await.unwrap();
    lcm.release("Configure host/a");
    configuring.await.unwrap().unwrap();
    let refusal = starting.await.unwrap_err();
    assert!(refusal.to_string().contains("stopped while this Start"), "{refusal}");
    assert!(!lcm.done().contains(&"Start host/a".to_owned()), "{:?}", lcm.done());
    ask(&gcm, vec![start("host/a")]).await.unwrap();
}

#[tokio::test]
async fn what_is_taken_back_sets_no_actuator_in_motion() {
    let (gcm, lcm) = running(&["host/a", "host/b"]).await;
    lcm.refuse("Create host/c");
    let refusal = ask(&gcm, vec![stop("host/a"), create("host/c")]).await.unwrap_err();
    assert_eq!(refusal.reason(), "COMPONENT_REFUSED");
    assert_eq!(lcm.state("host/a"), Some(STOPPED), "nobody asked that it moves: {:?}", lcm.done());
    assert_eq!(component(&gcm.graph(), "host/a").state, STOPPED, "and it is shown");
    assert_eq!(lcm.state("host/b"), Some(State::Active));
}

#[tokio::test]
async fn a_process_that_ended_is_no_reason_to_say_that_a_stop_failed() {
    let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
    let who = host();
    let pid = who.pid;
    let session = register(&gcm, who, lcm).await.unwrap().session;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    gcm.lost(&name("host"), session);
    assert_eq!(ask(&gcm, vec![stop("host/a")]).await.unwrap_err().reason(), "STOP_NOT_TOLD");
    let (process, last_exit) = (name("host"), "was killed by SIGKILL".to_owned());
    gcm.told(&Told { process, fate: Fate::Restarting, pid, last_exit, restarts: 1 });
    let done = ask(&gcm, vec![stop("host/a")]).await.unwrap();
    assert!(done.skipped()[0].why.contains("it comes back stopped"), "{:?}", done.skipped());
    let again = FakeLcm::new("host");
    register(&gcm, host(), again.clone()).await.unwrap();
    until(&gcm, "it is made again", |g| g.processes[&name("host")].state == ProcessState::Attached).await;
    assert_eq!(again.state("host/a"), Some(STOPPED));
}

#[tokio::test]
async fn a_stop_at_the_process_itself_becomes_one_of_the_gcms() {
    for is_news in [true, false] {
        let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
        let who = host();
        let session = register(&gcm, who.clone(), lcm.clone()).await.unwrap().session;
        ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
        let before = gcm.graph().revision;
        let told = StoppedHere { number: 3, targets: vec![(Target::parse("host/a").unwrap(), 3)] };
        lcm.become_state("host/a", STOPPED, "");
        if is_news {
            lcm.news.send(News::StoppedHere(told)).unwrap();
        } else {
            // It was asked while there was no GCM.
            *lcm.stopped_here.lock() = told;
            gcm.lost(&name("host"), session);
            register(&gcm, who, lcm.clone()).await.unwrap();
        }
        let mut watchdog = crate::watchdog::Watchdog::of("the GCM answers with a Stop of its own");
        while lcm.known_here() != Some(3) {
            watchdog.saw(format_args!("{:?}", lcm.known_here()));
            tokio::task::yield_now().await;
        }
        until(&gcm, "it is a revision", |graph| graph.revision > before).await;
        ask(&gcm, vec![start("host/a")]).await.unwrap();
        assert_eq!(lcm.state("host/a"), Some(State::Active), "asked after the GCM knew of it");
        // It had not heard the answer to the first when it was asked once more.
        let targets = [("host/a", 3), ("host/b", 4)].map(|(path, n)| (Target::parse(path).unwrap(), n));
        lcm.news.send(News::StoppedHere(StoppedHere { number: 4, targets: targets.into() })).unwrap();
        while lcm.known_here() != Some(4) {
            watchdog.saw(format_args!("{:?}", lcm.known_here()));
            tokio::task::yield_now().await;
        }
        assert_eq!(lcm.state("host/a"), Some(State::Active), "it was started after its Stop was answered");
    }
}

#[test]
fn a_component_that_may_move_is_what_the_answer_speaks_of() {
    let not_there = Refusal::ComponentNotFound { id: id("host/a"), known: Vec::new() };
    let not_told = Refusal::StopNotTold { id: id("eye/c"), why: "its process is lost".into() };
    let failed = [not_there.clone(), not_told.clone()].map(|refusal| (Target::everything(), refusal));
    assert_eq!(worst(&failed), Some(&not_told));
    assert_eq!(worst(&failed[..1]), Some(&not_there));
    assert_eq!(worst(&[]), None);
}

#[tokio::test]
async fn a_gcm_that_knows_nothing_counts_on_from_what_its_processes_have_seen() {
    let (gcm, lcm) = running(&["host/a"]).await;
    for _ in 0..9 {
        ask(&gcm, vec![stop("host/a")]).await.unwrap();
        ask(&gcm, vec![start("host/a")]).await.unwrap();
    }
    ask(&gcm, vec![stop("host/a")]).await.unwrap();
    let graph = gcm.graph();
    let slice = Slice {
        components: graph.components.iter().map(|(id, c)| (id.clone(), c.clone())).collect(),
        connections: Vec::new(),
    };
    let other = Gcm::start(GcmConfig::default()).await.unwrap();
    register(&other, Registration { slice, ..host() }, lcm.clone()).await.unwrap();
    ask(&other, vec![start("host/a")]).await.unwrap();
    assert_eq!(lcm.state("host/a"), Some(State::Active), "its Start is later than every Stop before");
}

#[tokio::test]
async fn a_start_whose_answer_was_lost_may_be_moving_and_is_stopped_when_its_process_is_back() {
    let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
    let who = host();
    let session = register(&gcm, who.clone(), lcm.clone()).await.unwrap().session;
    ask(&gcm, vec![create("host/a"), create("host/b")]).await.unwrap();
    lcm.lose_at("Start host/a");
    ask(&gcm, vec![start("host/a")]).await.unwrap_err();
    lcm.become_state("host/a", State::Active, "");
    gcm.lost(&name("host"), session);
    let done = ask(&gcm, vec![stop("host/**")]).await.unwrap();
    let [(target, not_told)] = &done.failed[..] else { panic!("{done:?}") };
    assert_eq!((target.to_string().as_str(), not_told.reason()), ("host/a", "STOP_NOT_TOLD"));
    register(&gcm, who, lcm.clone()).await.unwrap();
    until(&gcm, "it is stopped", |graph| graph.components[&id("host/a")].state == STOPPED).await;
    assert_eq!(lcm.state("host/a"), Some(STOPPED));
    ask(&gcm, vec![start("host/*")]).await.unwrap();
    assert_eq!(lcm.state("host/a"), Some(State::Active), "asked after it was told");
}

#[tokio::test]
async fn how_a_process_ended_before_is_no_sign_that_it_has_ended_now() {
    let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
    let who = host();
    let pid = who.pid;
    let session = register(&gcm, who, lcm).await.unwrap().session;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    let (process, last_exit) = (name("host"), "was killed by SIGKILL".to_owned());
    gcm.told(&Told { process, fate: Fate::Running, pid, last_exit, restarts: 1 });
    gcm.lost(&name("host"), session);
    assert_eq!(ask(&gcm, vec![stop("host/a")]).await.unwrap_err().reason(), "STOP_NOT_TOLD");
}

#[tokio::test]
async fn a_file_that_was_applied_before_a_stop_starts_nothing_after_it() {
    let (gcm, lcm) = running(&["host/a"]).await;
    let file = r#"{ "version": 1, "processes": { "host": {} },
        "components": { "host/a": { "class": "arm", "config": { "gain": 2.0 } } } }"#;
    lcm.hold("Create host/b");
    let creating = tokio::spawn({
        let gcm = gcm.clone();
        async move { ask(&gcm, vec![create("host/b"), stop("host/a"), start("host/a")]).await }
    });
    lcm.hangs("Create host/b").await;
    let mut applying = std::pin::pin!(gcm.apply_system(file, false, ExecuteOptions::default()));
    begun(applying.as_mut()).await;
    ask(&gcm, vec![stop("host/a")]).await.unwrap();
    lcm.release("Create host/b");
    creating.await.unwrap().unwrap_err();
    let applied = applying.await;
    assert_eq!(lcm.state("host/a"), Some(STOPPED), "{applied:?}: {:?}", lcm.done());
}

#[tokio::test]
async fn a_process_that_comes_while_a_stop_is_carried_out_is_stopped_by_it() {
    let (gcm, lcm) = running(&["host/arm"]).await;
    let peer = FakeLcm::new("peer");
    peer.become_state("peer/stray", State::Active, "");
    // The Stop waits for the process that is there.
    lcm.hold("Stop host/arm");
    let stopping = tokio::spawn({
        let gcm = gcm.clone();
        async move { ask(&gcm, vec![stop("**")]).await }
    });
    comes("it is told to stop", lcm.hangs("Stop host/arm")).await;
    let who = Registration::new(name("peer"), "127.0.0.1:7".into());
    register(&gcm, who, peer.clone()).await.unwrap();
    // It sets itself in motion after what its registration may have stopped.
    peer.become_state("peer/stray", State::Active, "");
    lcm.release("Stop host/arm");
    comes("the Stop ends", stopping).await.unwrap().unwrap();
    assert_eq!(peer.state("peer/stray"), Some(STOPPED), "an answered Stop that moves on");
}
