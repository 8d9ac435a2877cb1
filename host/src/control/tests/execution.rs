//! Execution settings over the wire: each one arrives, is shown again, and is refused where it is wrong.

use tonic_types::StatusExt;
use trocar_proto::v1;

use super::{System, create, reason, start};

/// Seconds.
fn seconds(s: i64, nanos: i32) -> Option<prost_types::Duration> {
    Some(prost_types::Duration { seconds: s, nanos })
}

fn configure(path: &str, execution: v1::Execution) -> v1::ConfigureRequest {
    v1::ConfigureRequest { path: path.into(), execution: Some(execution), ..Default::default() }
}

async fn shown(s: &System, path: &str) -> v1::Execution {
    let state = s.gcm().get_state(v1::GetStateRequest { path: path.into() }).await.unwrap();
    state.into_inner().component.unwrap().execution.unwrap()
}

#[tokio::test]
async fn every_setting_arrives_and_is_shown_again() {
    let s = System::start().await;
    let lead = v1::Execution {
        model: "stream".into(),
        rate_hz: Some(100.0),
        priority: Some(80),
        cpus: vec![1],
        catch_up: Some(3),
        threads: Some(4),
        ..Default::default()
    };
    let mut gcm = s.gcm();
    gcm.create(v1::CreateRequest { execution: Some(lead.clone()), ..create("host/lead") }).await.unwrap();
    let want = v1::Execution { period: seconds(0, 10_000_000), phase: None, ..lead };
    assert_eq!(shown(&s, "host/lead").await, want);
    let rider = v1::Execution {
        stream_of: "host/lead".into(),
        on_failure: "bypass".into(),
        max_step: seconds(0, 20_000_000),
        ..Default::default()
    };
    gcm.create(v1::CreateRequest { execution: Some(rider), ..create("host/rider") }).await.unwrap();
    let rider = shown(&s, "host/rider").await;
    assert_eq!((rider.model.as_str(), rider.on_failure.as_str()), ("stream", "bypass"));
    assert_eq!(rider.max_step, seconds(0, 20_000_000));
    let inside = v1::Execution { model: "exec_out".into(), inside: "host/lead".into(), ..Default::default() };
    gcm.create(v1::CreateRequest { execution: Some(inside), ..create("host/inside") }).await.unwrap();
    assert_eq!(shown(&s, "host/inside").await.model, "exec_out");
}

#[tokio::test]
async fn configure_changes_it_but_not_while_it_runs() {
    let s = System::start().await;
    let mut gcm = s.gcm();
    gcm.create(create("host/a")).await.unwrap();
    let faster = v1::Execution { rate_hz: Some(2000.0), ..Default::default() };
    let done = gcm.configure(configure("host/a", faster.clone())).await.unwrap().into_inner();
    assert!(done.plan.iter().any(|l| l.contains("period_us: 1000 → 500")), "{:?}", done.plan);
    assert_eq!(shown(&s, "host/a").await.rate_hz, Some(2000.0));
    gcm.start(start("host/a")).await.unwrap();
    gcm.configure(configure("host/a", faster)).await.expect("what it is already is no change");
    let slower = v1::Execution { rate_hz: Some(500.0), ..Default::default() };
    let status = gcm.configure(configure("host/a", slower)).await.unwrap_err();
    assert_eq!(reason(&status), "WRONG_STATE", "{status}");
    assert!(status.message().contains("its execution cannot change while it runs"), "{status}");
}

#[tokio::test]
async fn a_wrong_setting_is_refused_with_its_field() {
    let s = System::start().await;
    let e = v1::Execution::default;
    let cases = [
        (v1::Execution { model: "exec_im".into(), ..e() }, "execution.model", "did you mean \"exec_in\"?"),
        (
            v1::Execution { on_failure: "bypas".into(), ..e() },
            "execution.on_failure",
            "did you mean \"bypass\"?",
        ),
        (v1::Execution { rate_hz: Some(f64::NAN), ..e() }, "execution.rate_hz", "NaN Hz"),
        (v1::Execution { rate_hz: Some(0.0), ..e() }, "execution.rate_hz", "0 Hz is not a rate"),
        (v1::Execution { rate_hz: Some(-5.0), ..e() }, "execution.rate_hz", "-5 Hz is not a rate"),
        (v1::Execution { rate_hz: Some(f64::INFINITY), ..e() }, "execution.rate_hz", "inf Hz"),
        (
            v1::Execution { rate_hz: Some(1e12), ..e() },
            "execution.rate_hz",
            "1000000000000 Hz is outside one step an hour to 1000000 Hz",
        ),
        (
            v1::Execution { rate_hz: Some(1e-9), ..e() },
            "execution.rate_hz",
            "outside one step an hour to 1000000 Hz",
        ),
        (v1::Execution { period: seconds(0, 0), ..e() }, "execution.period", "a period of 0 ns"),
        (v1::Execution { period: seconds(-1, 0), ..e() }, "execution.period", "-1 s is not a duration here"),
        (v1::Execution { period: seconds(i64::MAX, 0), ..e() }, "execution.period", "is not a duration"),
        (v1::Execution { phase: seconds(0, -1), ..e() }, "execution.phase", "is not a duration"),
        (v1::Execution { max_step: seconds(0, 0), ..e() }, "execution.max_step", "0 ns is outside 100 µs"),
        (v1::Execution { priority: Some(4000), ..e() }, "execution.priority", "4000 is outside 1 to 99"),
        (v1::Execution { catch_up: Some(u32::MAX), ..e() }, "execution.catch_up", "4294967295"),
        (v1::Execution { threads: Some(65), ..e() }, "execution.threads", "65 is outside 1 to 64"),
        (v1::Execution { cpus: vec![0, 1, 0], ..e() }, "execution.cpus", "processor 0 is named twice"),
        (v1::Execution { cpus: vec![u32::MAX], ..e() }, "execution.cpus", "4294967295"),
        (v1::Execution { model: "exec_in".into(), ..e() }, "execution.inside", "model exec_in needs"),
    ];
    for (execution, field, want) in cases {
        let request = v1::CreateRequest { execution: Some(execution), ..create("host/a") };
        let status = s.gcm().create(request).await.unwrap_err();
        assert_eq!(reason(&status), "ARGUMENT_INVALID", "{status}");
        let blamed = status.get_details_bad_request().unwrap().field_violations.remove(0);
        assert_eq!(blamed.field, field, "{status}");
        assert!(blamed.description.contains(want), "{:?} should contain {want:?}", blamed.description);
    }
    assert!(s.gcm.graph().components.is_empty(), "nothing was made");
}
