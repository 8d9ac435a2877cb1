//! A process attached over the wire behaves as one in the GCM's own process; the loss of either side is
//! survived.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use trocar_model::{Health, ProcessState, Refusal, State, StopReason, SystemGraph};
use trocar_proto::v1::attach_service_client::AttachServiceClient;
use trocar_proto::v1::{self, attach_request, attach_response};

use super::super::{Begin, Dialler, Uplink, UplinkError};
use super::{System, connect, create, link, reason, serve, start, stop};
use crate::gcm::fake::{FakeLcm, comes, id, name, until};
use crate::gcm::{Gcm, GcmConfig, Registration};
use crate::lcm::{Lcm, News, Report};

/// Longer than any test should take; only a broken one waits for it.
const WATCHDOG: Duration = Duration::from_secs(60);

fn who(process: &str) -> Registration {
    Registration::new(name(process), "127.0.0.1:7".into())
}

async fn attach(addr: &str, process: &str, lcm: &Arc<FakeLcm>) -> Result<Uplink, UplinkError> {
    Uplink::start(addr.into(), Dialler::local(), who(process), lcm.clone(), Begin::AtOnce).await
}

/// A GCM's system with a process "gui" attached over the wire.
async fn attached() -> (System, Arc<FakeLcm>, Uplink) {
    let (s, lcm) = (System::start().await, FakeLcm::new("gui"));
    let uplink = attach(&s.server.addr().to_string(), "gui", &lcm).await.unwrap();
    (s, lcm, uplink)
}

#[tokio::test]
async fn the_state_of_one_component_is_asked_of_no_process_that_has_no_part_in_it() {
    let s = System::start().await;
    let mut others = Vec::new();
    for process in ["peer", "other", "another"] {
        let lcm = FakeLcm::new(process);
        let inventory = lcm.inventory().await.unwrap();
        s.gcm.register(who(process), lcm.clone(), inventory).await.unwrap();
        others.push(lcm);
    }
    let mut gcm = s.gcm();
    for path in ["host/a", "host/b", "peer/a", "other/a"] {
        gcm.create(create(path)).await.unwrap();
    }
    gcm.connect(link("host/a/robot", "host/b/arm")).await.unwrap();
    gcm.connect(link("peer/a/input", "host/b/value")).await.unwrap();
    let asked = || -> Vec<usize> {
        let all = [&s.lcm].into_iter().chain(&others);
        all.map(|lcm| lcm.figures.swap(0, Ordering::Relaxed)).collect()
    };
    asked();
    // (of whom, questions: one for the component, one for the connections where there are some)
    for (path, questions) in [("host/a", [2, 0, 0, 0]), ("host/b", [2, 1, 0, 0]), ("other/a", [0, 0, 1, 0])] {
        gcm.get_state(v1::GetStateRequest { path: path.into() }).await.unwrap();
        assert_eq!(asked(), questions, "{path}");
    }
    gcm.list(v1::ListRequest { path: "other".into(), ..Default::default() }).await.unwrap();
    assert_eq!(asked(), [0, 0, 1, 0], "the list of one process");
}

fn process_is(process: &'static str, state: ProcessState) -> impl Fn(&SystemGraph) -> bool {
    move |graph| graph.processes.get(&name(process)).is_some_and(|p| p.state == state)
}

#[tokio::test]
async fn an_attached_process_does_what_one_of_the_gcms_own_does() {
    let (s, lcm, _uplink) = attached().await;
    let mut gcm = s.gcm();
    gcm.create(create("gui/a")).await.unwrap();
    gcm.create(create("gui/b")).await.unwrap();
    gcm.connect(link("gui/b/robot", "gui/a/arm")).await.unwrap();
    let started = gcm.start(start("gui/*")).await.unwrap().into_inner();
    assert_eq!(started.components.len(), 2);
    assert_eq!(lcm.state("gui/a"), Some(State::Active));
    let list = gcm.list(v1::ListRequest::default()).await.unwrap().into_inner();
    assert_eq!(list.warnings, Vec::<String>::new());
    let a = list.components.iter().find(|c| c.path == "gui/a").unwrap();
    assert_eq!((a.state(), a.stats.as_ref().unwrap().executed), (v1::ComponentState::Active, 42));
    assert_eq!(list.connections[0].carrier, "inline");
    let plugins = s.plugin().list_plugins(v1::ListPluginsRequest { process: "gui".into() }).await.unwrap();
    assert_eq!(plugins.into_inner().plugins[0].process, "gui");
    let again = |name: &str| v1::RecheckRequest { name: name.into(), process: String::new() };
    let looked_at = s.plugin().recheck(again("libtoy.so")).await.unwrap().into_inner();
    assert!(looked_at.plugins.iter().any(|plugin| plugin.process == "gui"), "{looked_at:?}");
    assert_eq!(reason(&s.plugin().recheck(again("tyo")).await.unwrap_err()), "PLUGIN_NOT_FOUND");
    lcm.become_state("gui/a", State::Fault, "the cable is out");
    let graph = until(&s.gcm, "the fault", |g| g.components[&id("gui/a")].state == State::Fault).await;
    assert_eq!(graph.components[&id("gui/a")].fault, "the cable is out");
    gcm.stop(stop("gui/**")).await.unwrap();
    assert_eq!(lcm.state("gui/b"), Some(State::Stopped(StopReason::Requested)));
}

#[tokio::test]
async fn a_port_that_goes_in_an_attached_process_takes_its_connection_with_it() {
    let (s, lcm, _uplink) = attached().await;
    let mut gcm = s.gcm();
    gcm.create(create("gui/a")).await.unwrap();
    gcm.create(create("gui/b")).await.unwrap();
    let number = gcm.connect(link("gui/b/robot", "gui/a/arm")).await.unwrap().into_inner().id;
    let a = s.gcm.graph().components[&id("gui/a")].clone();
    let ports = trocar_model::Ports { provided: vec![], ..(*a.ports).clone() };
    let report = Report {
        id: id("gui/a"),
        number: 0,
        state: a.state,
        health: Health::Ok,
        fault: String::new(),
        ports: Some(Arc::new(ports)),
        lost_connections: vec![number],
        warnings: vec![],
    };
    lcm.news.send(News::State(report)).unwrap();
    let graph = until(&s.gcm, "the connection goes", |g| g.connections.is_empty()).await;
    assert!(graph.components[&id("gui/a")].ports.provided.is_empty());
    assert!(graph.revision > 3, "it is a new revision: {}", graph.revision);
}

#[tokio::test]
async fn what_a_class_offers_crosses_the_wire_whole() {
    let (s, _lcm, _uplink) = attached().await;
    let graph = s.gcm.graph();
    let (near, remote) = (&graph.processes[&name("host")].classes, &graph.processes[&name("gui")].classes);
    assert_eq!(near, remote);
}

#[tokio::test]
async fn calls_reads_and_logs_of_an_attached_process_go_through_the_gcm() {
    let (s, lcm, _uplink) = attached().await;
    let mut interact = s.interact();
    let json = prost_types::Value { kind: Some(prost_types::value::Kind::NumberValue(2.5)) };
    let invoke =
        v1::InvokeRequest { path: "gui/a/arm/write".into(), json: Some(json.clone()), ..Default::default() };
    let reply = interact.invoke(invoke).await.unwrap().into_inner();
    assert_eq!((reply.executed, reply.json, reply.unit.as_str()), (true, Some(json), "mm"));
    let mut read = v1::ReadRequest { path: "gui/a/value".into(), ..Default::default() };
    let without = interact.read(read.clone()).await.unwrap().into_inner();
    assert_eq!((without.seq, without.frame_bytes, without.frame), (3, 2, vec![]));
    read.frame = true;
    assert_eq!(interact.read(read).await.unwrap().into_inner().frame, [7, 8], "the frame's bytes, too");
    use v1::read_request::Row;
    for row in [Row::AtNs(u64::MAX), Row::NearestNs(2), Row::Tick(3), Row::Delayed(4)] {
        let read = v1::ReadRequest { path: "gui/a".into(), row: Some(row), frame: false };
        let json = interact.read(read).await.unwrap().into_inner().json.unwrap();
        let want = match row {
            Row::AtNs(ns) => format!("gui/a Time({ns})"),
            Row::NearestNs(ns) => format!("gui/a Nearest({ns})"),
            Row::Tick(tick) => format!("gui/a Tick({tick})"),
            Row::Delayed(rows) => format!("gui/a Delayed({rows})"),
        };
        assert_eq!(json.kind, Some(prost_types::value::Kind::StringValue(want)));
    }
    lcm.log("gui/a", 2, "hello");
    let request = v1::LogsRequest { path: "gui".into(), follow: true, ..Default::default() };
    let line = interact.logs(request).await.unwrap().into_inner().message().await.unwrap().unwrap();
    assert_eq!(line.line.unwrap().message, "hello");
}

#[tokio::test]
async fn a_refusal_of_an_attached_process_arrives_as_it_was_said() {
    let (s, lcm, _uplink) = attached().await;
    let unknown = v1::InvokeRequest { path: "gui/a/arm/wirte".into(), ..Default::default() };
    let status = s.interact().invoke(unknown).await.unwrap_err();
    assert_eq!(reason(&status), "MEMBER_NOT_FOUND");
    assert!(status.message().contains("write"), "it must name what exists: {}", status.message());
    lcm.refuse("Create gui/a");
    let status = s.gcm().create(create("gui/a")).await.unwrap_err();
    assert_eq!(reason(&status), "COMPONENT_REFUSED");
    assert!(status.message().contains("the cable is out"), "{}", status.message());
}

#[tokio::test]
async fn a_subscription_reaches_an_attached_process_and_ends_with_its_reader() {
    let (s, lcm, _uplink) = attached().await;
    let selections = vec![v1::Selection { path: "gui/a/arm/moved".into(), ..Default::default() }];
    let mut items = s.interact().subscribe(v1::SubscribeRequest { selections }).await.unwrap().into_inner();
    for n in 1..=3 {
        lcm.emit("gui/a/arm/moved", n).await;
        let item = items.message().await.unwrap().unwrap();
        assert_eq!((item.seq, item.kind(), item.skipped), (n, v1::ItemKind::Event, 0));
    }
    drop(items);
    comes("the process feeds the reader that is gone no more", lcm.unfollowed()).await;
}

#[tokio::test]
async fn a_name_that_is_taken_and_an_address_where_nobody_is_are_told_at_once() {
    let (s, _lcm, _uplink) = attached().await;
    let refused = attach(&s.server.addr().to_string(), "gui", &FakeLcm::new("gui")).await.err().unwrap();
    let UplinkError::Refused(Refusal::ProcessExists { process, endpoint, .. }) = refused else {
        panic!("{refused:?}");
    };
    assert_eq!((process, endpoint.as_str()), (name("gui"), "127.0.0.1:7"));
    let addr = s.server.addr().to_string();
    s.server.shutdown().await;
    let nobody = attach(&addr, "other", &FakeLcm::new("other")).await.err().unwrap();
    assert!(matches!(&nobody, UplinkError::NoGcm { addr: said, .. } if *said == addr), "{nobody:?}");
}

#[tokio::test]
async fn a_process_that_leaves_is_lost_and_its_name_is_free() {
    let (s, lcm, uplink) = attached().await;
    s.gcm().create(create("gui/a")).await.unwrap();
    uplink.shutdown().await;
    let graph = until(&s.gcm, "gui is lost", process_is("gui", ProcessState::Lost)).await;
    assert_eq!(graph.components[&id("gui/a")].health, Health::Lost);
    let _again = attach(&s.server.addr().to_string(), "gui", &lcm).await.unwrap();
    assert_eq!(s.gcm.graph().processes[&name("gui")].state, ProcessState::Attached);
}

#[tokio::test]
async fn a_silent_process_is_lost_although_its_stream_stands() {
    let s = System::start().await;
    let mut client = AttachServiceClient::new(s.channel.clone());
    let (tell, told) = mpsc::channel(4);
    let hello = v1::Hello { process: "mute".into(), instance: vec![7; 16], ..Default::default() };
    let hello = v1::AttachRequest { message: Some(attach_request::Message::Hello(hello)) };
    tell.send(hello).await.unwrap();
    let mut heard = client.attach(ReceiverStream::new(told)).await.unwrap().into_inner();
    let first = heard.message().await.unwrap().unwrap().message;
    assert!(matches!(first, Some(attach_response::Message::Registered(_))), "{first:?}");
    until(&s.gcm, "mute is lost", process_is("mute", ProcessState::Lost)).await;
}

#[tokio::test]
async fn a_stream_that_does_not_begin_with_hello_is_refused() {
    let s = System::start().await;
    let mut client = AttachServiceClient::new(s.channel.clone());
    let beat = attach_request::Message::Heartbeat(v1::Heartbeat { sequence: 1, ..Default::default() });
    let status =
        client.attach(tokio_stream::once(v1::AttachRequest { message: Some(beat) })).await.unwrap_err();
    assert_eq!(reason(&status), "ARGUMENT_INVALID");
}

/// The same address, served by a GCM that knows nothing.
async fn restarted(s: System) -> (Gcm, super::Server) {
    let addr = s.server.addr().to_string();
    s.server.shutdown().await;
    let gcm = Gcm::start(GcmConfig::default()).await.unwrap();
    let server = serve(&addr, Some(&gcm), None).await;
    (gcm, server)
}

#[tokio::test]
async fn a_restarted_gcm_gets_its_processes_back_with_all_they_have() {
    let (s, lcm, _uplink) = attached().await;
    let mut client = s.gcm();
    client.create(create("gui/a")).await.unwrap();
    client.create(create("gui/b")).await.unwrap();
    client.connect(link("gui/b/robot", "gui/a/arm")).await.unwrap();
    client.start(start("gui/*")).await.unwrap();
    let before = s.gcm.graph();
    lcm.become_state("gui/b", State::Stopped(StopReason::Interlock), "");
    let (gcm, server) = restarted(s).await;
    let after = until(&gcm, "gui is back", process_is("gui", ProcessState::Attached)).await;
    assert_eq!(after.components[&id("gui/a")], before.components[&id("gui/a")]);
    assert_eq!(after.components[&id("gui/b")].state, State::Stopped(StopReason::Interlock));
    assert_eq!(after.connections, before.connections);
    let mut client = super::GcmServiceClient::new(connect(&server).await);
    client.stop(stop("gui/a")).await.unwrap();
    assert_eq!(lcm.state("gui/a"), Some(State::Stopped(StopReason::Requested)));
    let done = lcm.done();
    assert_eq!(done.iter().filter(|d| d.starts_with("Create")).count(), 2, "nothing is made anew: {done:?}");
}

#[tokio::test]
async fn a_process_whose_gcm_died_in_the_middle_of_a_change_is_there_at_once_and_takes_it_back() {
    let (s, lcm, _uplink) = attached().await;
    s.gcm().create(create("gui/b")).await.unwrap();
    let all = || vec!["gui/**".to_owned()];
    s.gcm().start(v1::StartRequest { paths: all(), ..Default::default() }).await.unwrap();
    lcm.hold("Create gui/a");
    let creating = tokio::spawn({
        let mut client = s.gcm();
        async move { client.create(create("gui/a")).await }
    });
    lcm.hangs("Create gui/a").await;
    let (gcm, _server) = restarted(s).await;
    creating.await.unwrap().unwrap_err();
    until(&gcm, "the process is there", process_is("gui", ProcessState::Attached)).await;
    let stop = trocar_model::Request::Stop { targets: vec!["gui/**".parse().unwrap()] };
    gcm.execute(vec![stop], Default::default()).await.unwrap();
    assert_eq!(lcm.state("gui/b"), Some(State::Stopped(StopReason::Requested)), "Stop waited for it");
    lcm.hold("Remove gui/a");
    lcm.release("Create gui/a");
    comes("it is taken back", lcm.hangs("Remove gui/a")).await;
    lcm.release("Remove gui/a");
    comes("it is gone", async {
        while lcm.state("gui/a").is_some() {
            tokio::task::yield_now().await;
        }
    })
    .await;
    assert_eq!(lcm.state("gui/a"), None, "its caller was told that it failed");
}

#[tokio::test]
async fn a_process_whose_name_was_given_away_meanwhile_is_sent_away() {
    let (s, _lcm, mut uplink) = attached().await;
    let gcm = Gcm::start(GcmConfig::default()).await.unwrap();
    let (other, inventory) = (FakeLcm::new("gui"), crate::lcm::Inventory::default());
    gcm.register(who("gui"), other, inventory).await.unwrap();
    let addr = s.server.addr().to_string();
    s.server.shutdown().await;
    let _server = serve(&addr, Some(&gcm), None).await;
    let refusal = comes("it dials no more", uplink.refused()).await;
    assert_eq!(refusal.reason(), "PROCESS_EXISTS");
}

#[tokio::test]
async fn nobody_waits_for_a_process_that_is_gone() {
    let (s, lcm, uplink) = attached().await;
    lcm.hold("Create gui/a");
    let creating = tokio::spawn({
        let gcm = s.gcm.clone();
        let request = trocar_model::Request::Create {
            id: id("gui/a"),
            class: "arm".into(),
            config: None,
            execution: Default::default(),
        };
        let deadline = Some(Instant::now() + WATCHDOG);
        let options = crate::gcm::ExecuteOptions { deadline, ..Default::default() };
        async move { gcm.execute(vec![request], options).await }
    });
    lcm.hangs("Create gui/a").await;
    uplink.shutdown().await;
    assert_eq!(creating.await.unwrap().unwrap_err().reason(), "PROCESS_LOST");
}
