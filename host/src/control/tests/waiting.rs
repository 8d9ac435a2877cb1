//! WaitFor an event: an event sent meanwhile reaches the waiting caller, who is told when it cannot come any
//! more.

use std::time::Duration;

use tonic::{Code, Request, Status};
use trocar_model::State;
use trocar_proto::v1;

use super::super::{Begin, Dialler, Uplink};
use super::{System, create, in_time, reason, start};
use crate::gcm::Registration;
use crate::gcm::fake::{FakeLcm, name};

const EVENT: &str = "host/a/arm/moved";

type Waiting = tokio::task::JoinHandle<Result<tonic::Response<v1::WaitForResponse>, Status>>;

fn seconds(seconds: i64) -> Option<prost_types::Duration> {
    Some(prost_types::Duration { seconds, nanos: 0 })
}

fn event(path: &str) -> v1::WaitForRequest {
    v1::WaitForRequest { path: path.into(), deadline: seconds(60), ..Default::default() }
}

fn n(answer: &v1::WaitForResponse) -> (u64, f64) {
    let Some(prost_types::value::Kind::StructValue(payload)) =
        answer.json.as_ref().and_then(|v| v.kind.clone())
    else {
        panic!("no payload: {answer:?}");
    };
    let Some(prost_types::value::Kind::NumberValue(n)) = payload.fields["n"].kind else {
        panic!("no number: {answer:?}");
    };
    (answer.stamp_ns, n)
}

async fn active() -> System {
    let s = System::start().await;
    s.gcm().create(create("host/a")).await.unwrap();
    s.gcm().start(start("host/a")).await.unwrap();
    s
}

fn wait(s: &System, request: v1::WaitForRequest) -> Waiting {
    let mut gcm = s.gcm();
    tokio::spawn(async move { gcm.wait_for(request).await })
}

#[tokio::test]
async fn an_event_is_answered_with_payload_stamp_and_component() {
    let s = active().await;
    let waiting = wait(&s, event(EVENT));
    s.lcm.followed(1).await;
    s.lcm.emit(EVENT, 5).await;
    let answer = waiting.await.unwrap().unwrap().into_inner();
    assert_eq!(n(&answer), (5, 5.0));
    assert_eq!(answer.component.unwrap().state(), v1::ComponentState::Active);
    s.lcm.unfollowed().await;
}

#[tokio::test]
async fn what_the_call_brings_about_is_not_missed() {
    let s = active().await;
    let json = prost_types::Value { kind: Some(prost_types::value::Kind::NumberValue(1.0)) };
    let call = v1::InvokeRequest { path: "host/a/arm/write".into(), json: Some(json), ..Default::default() };
    let request = v1::WaitForRequest { call: Some(call), ..event(EVENT) };
    let answer = s.gcm().wait_for(request).await.unwrap().into_inner();
    assert_eq!(n(&answer), (77, 77.0));
    let call = v1::InvokeRequest { path: "host/a/arm/wirte".into(), ..Default::default() };
    let refused =
        s.gcm().wait_for(v1::WaitForRequest { call: Some(call), ..event(EVENT) }).await.unwrap_err();
    assert_eq!(reason(&refused), "MEMBER_NOT_FOUND", "a call that fails ends the waiting: {refused}");
}

#[tokio::test]
async fn an_event_of_an_attached_process_reaches_who_waits() {
    let s = System::start().await;
    let lcm = FakeLcm::new("gui");
    let who = Registration::new(name("gui"), "127.0.0.1:7".into());
    let (addr, dialler) = (s.server.addr().to_string(), Dialler::local());
    let _uplink = Uplink::start(addr, dialler, who, lcm.clone(), Begin::AtOnce).await.unwrap();
    s.gcm().create(create("gui/a")).await.unwrap();
    let waiting = wait(&s, event("gui/a/arm/moved"));
    lcm.followed(1).await;
    lcm.emit("gui/a/arm/moved", 6).await;
    assert_eq!(n(&waiting.await.unwrap().unwrap().into_inner()), (6, 6.0));
    lcm.unfollowed().await;
}

#[tokio::test]
async fn a_component_made_anew_is_listened_to_again() {
    let s = active().await;
    let waiting = wait(&s, event(EVENT));
    s.lcm.followed(1).await;
    s.lcm.end_feeds();
    s.lcm.followed(2).await;
    s.lcm.emit(EVENT, 8).await;
    assert_eq!(n(&waiting.await.unwrap().unwrap().into_inner()), (8, 8.0));
}

#[tokio::test]
async fn an_event_that_does_not_come_is_named_with_what_its_component_does() {
    let s = System::start().await;
    s.gcm().create(create("host/a")).await.unwrap();
    let short = Some(prost_types::Duration { seconds: 0, nanos: 5_000_000 });
    let late = s.gcm().wait_for(v1::WaitForRequest { deadline: short, ..event(EVENT) }).await.unwrap_err();
    assert_eq!((late.code(), reason(&late).as_str()), (Code::DeadlineExceeded, "EVENT_NOT_SEEN"), "{late}");
    assert!(late.message().contains(EVENT) && late.message().contains("READY"), "{late}");
    s.lcm.unfollowed().await;
    let asked = in_time(async || {
        let mut request = Request::new(event(EVENT));
        request.set_timeout(Duration::from_secs(1));
        s.gcm().wait_for(request).await
    });
    let late = asked.await.unwrap_err();
    assert_eq!(reason(&late), "EVENT_NOT_SEEN", "told before the caller gives up: {late}");
}

#[tokio::test]
async fn the_waiting_ends_at_once_when_the_event_cannot_come_any_more() {
    let s = active().await;
    let waiting = wait(&s, event(EVENT));
    s.lcm.followed(1).await;
    s.lcm.become_state("host/a", State::Fault, "the cable is out");
    let ended = waiting.await.unwrap().unwrap_err();
    assert_eq!(reason(&ended), "COMPONENT_FAULT", "{ended}");
    let faulty = s.gcm().wait_for(event(EVENT)).await.unwrap_err();
    assert_eq!(reason(&faulty), "COMPONENT_FAULT", "{faulty}");

    s.gcm().create(create("host/b")).await.unwrap();
    let waiting = wait(&s, event("host/b/arm/moved"));
    s.lcm.followed(2).await;
    let remove = v1::RemoveRequest { path: "host/b".into(), ..Default::default() };
    s.gcm().remove(remove).await.unwrap();
    let ended = waiting.await.unwrap().unwrap_err();
    assert_eq!(reason(&ended), "COMPONENT_NOT_FOUND", "{ended}");
    let nobody = s.gcm().wait_for(event("gui/a/arm/moved")).await.unwrap_err();
    assert_eq!(reason(&nobody), "PROCESS_NOT_FOUND", "{nobody}");
}

#[tokio::test]
async fn what_does_not_belong_together_is_refused() {
    let s = active().await;
    let call = Some(v1::InvokeRequest::default());
    let states = vec![v1::ComponentState::Active.into()];
    let cases = [
        (v1::WaitForRequest { states, ..event(EVENT) }, "ARGUMENT_INVALID", "an event"),
        (v1::WaitForRequest { call, ..event("host/a") }, "ARGUMENT_INVALID", "interface/event"),
        (v1::WaitForRequest { deadline: seconds(-1), ..event("host/a") }, "ARGUMENT_INVALID", "negative"),
        (event("host/a/value"), "BAD_PATH", "interface/event"),
        (event("host"), "BAD_PATH", "process/component"),
        (event(""), "BAD_PATH", "process/component"),
        (event("host/a//moved"), "BAD_PATH", "host/a//moved"),
    ];
    for (request, want, says) in cases {
        let refused = s.gcm().wait_for(request.clone()).await.unwrap_err();
        assert_eq!(reason(&refused), want, "{request:?}: {refused}");
        assert!(refused.message().contains(says), "{request:?}: {refused}");
    }
}
