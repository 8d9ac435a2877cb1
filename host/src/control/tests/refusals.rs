//! Every reason that can be produced at this level reaches a caller with its code and details.

use std::time::Duration;

use prost_types::value::Kind;
use tonic::{Code, Request, Status};
use tonic_types::StatusExt;
use trocar_proto::v1;

use super::{System, connect, create, in_time, link, reason, serve, start, stop};

fn refused<T: std::fmt::Debug>(what: &str, answer: Result<T, Status>, code: Code, want: &str) -> Status {
    let status = answer.expect_err(what);
    assert_eq!((status.code(), reason(&status).as_str()), (code, want), "{what}: {status}");
    let info = status.get_details_error_info().unwrap();
    assert_eq!(info.domain, "trocar.v1", "{what}");
    assert!(status.get_details_help().is_some_and(|h| !h.links.is_empty()), "{what} comes without help");
    status
}

#[tokio::test]
async fn names_that_are_wrong_are_refused_with_what_exists() {
    let s = System::start().await;
    let mut gcm = s.gcm();
    gcm.create(create("host/a")).await.unwrap();
    refused("a slash in front", gcm.create(create("/host/b")).await, Code::InvalidArgument, "BAD_PATH");
    refused("no component", gcm.start(start("host")).await, Code::InvalidArgument, "BAD_PATH");
    refused("no name", gcm.create(create("")).await, Code::InvalidArgument, "ARGUMENT_INVALID");
    refused("no target", gcm.start(start("")).await, Code::InvalidArgument, "ARGUMENT_INVALID");
    let status =
        refused("unknown process", gcm.create(create("hots/b")).await, Code::NotFound, "PROCESS_NOT_FOUND");
    assert!(status.message().contains("host"), "it must name what exists: {}", status.message());
    let other = v1::CreateRequest { class: "amr".into(), ..create("host/b") };
    refused("unknown class", gcm.create(other).await, Code::NotFound, "CLASS_NOT_FOUND");
    refused("twice", gcm.create(create("host/a")).await, Code::AlreadyExists, "COMPONENT_EXISTS");
    refused("unknown component", gcm.start(start("host/b")).await, Code::NotFound, "COMPONENT_NOT_FOUND");
    let state = v1::GetStateRequest { path: "host/b".into() };
    refused("state of nothing", gcm.get_state(state).await, Code::NotFound, "COMPONENT_NOT_FOUND");
    let describe = v1::DescribeRequest { path: "gui".into(), ..Default::default() };
    refused("unknown process", gcm.describe(describe).await, Code::NotFound, "PROCESS_NOT_FOUND");
}

#[tokio::test]
async fn ends_that_do_not_fit_are_refused() {
    let s = System::start().await;
    let mut gcm = s.gcm();
    gcm.create(create("host/a")).await.unwrap();
    gcm.create(create("host/b")).await.unwrap();
    gcm.create(create("host/c")).await.unwrap();
    let swapped = gcm.connect(link("host/a/arm", "host/b/robot")).await;
    refused("swapped", swapped, Code::InvalidArgument, "WRONG_DIRECTION");
    let unknown = gcm.connect(link("host/b/robot", "host/a/amr")).await;
    refused("unknown interface", unknown, Code::NotFound, "INTERFACE_NOT_FOUND");
    assert_eq!(gcm.connect(link("host/b/robot", "host/a/arm")).await.unwrap().into_inner().id, 1);
    let again = gcm.connect(link("host/b/robot", "host/a/arm")).await;
    refused("the same again", again, Code::AlreadyExists, "CONNECTION_EXISTS");
    let second = gcm.connect(link("host/b/robot", "host/c/arm")).await;
    refused("a second source", second, Code::AlreadyExists, "ALREADY_CONNECTED");
    let remove = v1::RemoveRequest { path: "host/a".into(), ..Default::default() };
    refused("in use", gcm.remove(remove).await, Code::FailedPrecondition, "IN_USE");
    let disconnect = v1::DisconnectRequest { id: 9, ..Default::default() };
    refused("no such connection", gcm.disconnect(disconnect).await, Code::NotFound, "CONNECTION_NOT_FOUND");
}

#[tokio::test]
async fn what_a_component_may_not_or_will_not_do_is_refused() {
    let s = System::start().await;
    let mut gcm = s.gcm();
    gcm.create(create("host/a")).await.unwrap();
    let resume = v1::ResumeRequest { path: "host/a".into(), ..Default::default() };
    refused("resume", gcm.resume(resume).await, Code::FailedPrecondition, "WRONG_STATE");
    let gain = prost_types::Value { kind: Some(Kind::NumberValue(-1.0)) };
    let config = prost_types::Struct { fields: [("gain".to_owned(), gain)].into() };
    let configure =
        v1::ConfigureRequest { path: "host/a".into(), config: Some(config), ..Default::default() };
    let status = refused("bad gain", gcm.configure(configure).await, Code::InvalidArgument, "CONFIG_INVALID");
    let violations = status.get_details_bad_request().unwrap().field_violations;
    assert!(violations[0].field.contains("gain"), "the field to blame: {violations:?}");
    s.lcm.refuse("Start host/a");
    refused("cable", gcm.start(start("host/a")).await, Code::FailedPrecondition, "COMPONENT_REFUSED");
    let stale = v1::StartRequest { expected_revision: Some(77), ..start("host/a") };
    let status = refused("stale", gcm.start(stale).await, Code::Aborted, "REVISION_CONFLICT");
    assert_eq!(status.get_details_error_info().unwrap().metadata["expected"], "77");
    let wait = v1::WaitForRequest {
        path: "host/a".into(),
        deadline: Some(prost_types::Duration { seconds: 0, nanos: 5_000_000 }),
        ..Default::default()
    };
    let status = refused("never active", gcm.wait_for(wait).await, Code::DeadlineExceeded, "NOT_REACHED");
    assert!(status.message().contains("ACTIVE"), "no states means ACTIVE: {}", status.message());
}

#[tokio::test]
async fn calls_and_reads_that_cannot_be_made_are_refused() {
    let s = System::start().await;
    let mut interact = s.interact();
    let invoke = |path: &str| v1::InvokeRequest { path: path.into(), ..Default::default() };
    refused("short", interact.invoke(invoke("host/a")).await, Code::InvalidArgument, "BAD_PATH");
    let unknown = interact.invoke(invoke("hots/a/arm/write")).await;
    refused("process", unknown, Code::NotFound, "PROCESS_NOT_FOUND");
    refused("member", interact.invoke(invoke("host/a/arm/wirte")).await, Code::NotFound, "MEMBER_NOT_FOUND");
    let negative = prost_types::Duration { seconds: -1, nanos: 0 };
    let late = v1::InvokeRequest { deadline: Some(negative), ..invoke("host/a/arm/write") };
    refused("negative", interact.invoke(late).await, Code::InvalidArgument, "ARGUMENT_INVALID");
    let nothing = v1::SubscribeRequest::default();
    refused("nothing", interact.subscribe(nothing).await, Code::InvalidArgument, "ARGUMENT_INVALID");
    let emit = v1::EmitRequest::default();
    refused("emit", interact.emit(emit).await, Code::Unimplemented, "NOT_IMPLEMENTED");
    let plugin = v1::DescribePluginRequest { name: "tyo".into(), ..Default::default() };
    refused("plugin", s.plugin().describe_plugin(plugin).await, Code::NotFound, "PLUGIN_NOT_FOUND");
    let load = v1::LoadRequest::default();
    refused("load", s.plugin().load(load).await, Code::Unimplemented, "NOT_IMPLEMENTED");
}

#[tokio::test]
async fn a_component_that_hangs_answers_before_the_caller_gives_up() {
    let s = System::start().await;
    let mut tries = 0;
    let answer = in_time(async || {
        tries += 1;
        let path = format!("host/hangs-{tries}");
        s.lcm.hold(&format!("Create {path}"));
        let mut request = Request::new(create(&path));
        request.set_timeout(Duration::from_secs(1));
        s.gcm().create(request).await
    });
    refused("hanging", answer.await, Code::DeadlineExceeded, "LCM_TIMEOUT");
    s.gcm().create(create("host/b")).await.expect("the next request must not hang behind it");
}

#[tokio::test]
async fn a_lost_process_is_refused_as_unavailable() {
    let s = System::start().await;
    let mut gcm = s.gcm();
    gcm.create(create("host/a")).await.unwrap();
    let host = super::name("host");
    s.gcm.lost(&host, s.gcm.graph().processes[&host].epoch);
    refused("lost", gcm.start(start("host/a")).await, Code::Unavailable, "PROCESS_LOST");
    let stopped = gcm.stop(stop("host/a")).await.unwrap().into_inner();
    assert_eq!(stopped.skipped.len(), 1, "Stop is never refused, but says what it could not reach");
}

#[tokio::test]
async fn a_process_managed_elsewhere_says_where_and_serves_its_own_components() {
    let lcm = crate::gcm::fake::FakeLcm::new("host");
    let server = serve("127.0.0.1:0", None, Some(&lcm)).await;
    let channel = connect(&server).await;
    let mut gcm = super::GcmServiceClient::new(channel.clone());
    let answer = gcm.create(create("host/a")).await;
    let status = refused("managed", answer, Code::FailedPrecondition, "MANAGED_ELSEWHERE");
    assert!(status.message().contains("127.0.0.1:50551"), "{}", status.message());
    let mut interact = super::InteractServiceClient::new(channel);
    let invoke = v1::InvokeRequest { path: "host/a/arm/write".into(), ..Default::default() };
    assert!(interact.invoke(invoke).await.unwrap().into_inner().executed);
}
