//! Rows of a component's state from outside: the newest, earlier ones, and the values at a time; in the
//! process and over gRPC.

use serde_json::json;
use tonic::transport::Channel;
use trocar::lcm::{Sample, When};
use trocar_proto::v1::interact_service_client::InteractServiceClient;
use trocar_proto::v1::read_request::Row;
use trocar_proto::v1::{ReadRequest, ReadResponse};

use super::super::world::block_on;
use super::super::{Lab, Way};
use crate::eventually;

/// Rows that are looked for, newest first: stamp, tick, value.
type Known = Vec<(u64, u64, f64)>;

/// Writes 10, 20, … 50, and finds the row of each.
fn five(way: &Way, lab: &Lab) -> Known {
    for value in 1..=5_u32 {
        let write = lab.invoke("server/ctl/write", Some(json!(10.0 * f64::from(value))), false);
        write.unwrap_or_else(|refusal| panic!("{refusal}"));
    }
    // On its grid it would write over them while a slow machine is still asking; what was published stays
    // when it is stopped.
    if way.deployment.server_steps_unasked() {
        lab.stop("server");
    }
    // Rows are counted from the newest: whoever heard of the last write may still step, and then they move.
    let known = eventually("the server rests", || {
        let newest = || lab.row_at("server", When::Newest).map(|row| row.stamp_ns).ok();
        let before = newest();
        let mut known = Known::new();
        for k in 0..200 {
            let Ok(row) = lab.row_at("server", When::Delayed(k)) else { break };
            let value = row.value["value"].as_f64().unwrap_or_default();
            // The first row that shows it; a step after it shows it again.
            if known.last().is_some_and(|(_, _, newer)| *newer == value) {
                known.pop();
            }
            known.push((row.stamp_ns, row.seq, value));
        }
        if before == newest() { Ok(known) } else { Err(format!("{known:?}")) }
    });
    let values: Vec<f64> = known.iter().map(|(_, _, value)| *value).collect();
    assert_eq!(values, [50.0, 40.0, 30.0, 20.0, 10.0, 0.0]);
    assert!(known.windows(2).all(|w| w[0].0 > w[1].0 && w[0].1 >= w[1].1), "newer is later: {known:?}");
    known
}

pub fn each_row_is_found_by_its_time_its_tick_and_its_distance(way: &Way) {
    let lab = Lab::running(way);
    if way.deployment.server_never_rests() {
        return newest_alone(&lab);
    }
    let known = five(way, &lab);
    let value = |when| {
        let row = lab.row_at("server", when).unwrap_or_else(|refusal| panic!("{when:?}: {refusal}"));
        row.value["value"].as_f64().unwrap_or_default()
    };
    assert_eq!(value(When::Newest), 50.0);
    for (stamp_ns, tick, expected) in &known {
        assert_eq!(value(When::Time(*stamp_ns)), *expected, "at {stamp_ns} ns");
        assert_eq!(value(When::Nearest(*stamp_ns)), *expected, "near {stamp_ns} ns");
        let found = lab.row_at("server", When::Tick(*tick)).unwrap_or_else(|refusal| panic!("{refusal}"));
        assert_eq!(found.seq, *tick);
    }
    // Between two rows a time is answered by what lies between them.
    let ((late, _, high), (early, _, low)) = (known[1], known[2]);
    let middle = value(When::Time(early + (late - early) / 2));
    assert!(middle >= low && middle <= high, "{middle} between {low} and {high}");
    for (when, why) in [
        (When::Delayed(100_000), "not there yet"),
        (When::Tick(u64::MAX), "not there yet"),
        (When::Time(u64::MAX), "not there yet"),
        (When::Time(1), "no such row"),
    ] {
        let refused = lab.row_at("server", when).expect_err("there is none");
        assert_eq!(refused.reason(), "ARGUMENT_INVALID", "{when:?}: {refused}");
        assert!(refused.to_string().contains(why), "{when:?}: {refused}");
    }
}

/// A server that never rests writes over its rows before anybody could ask for one of them: its newest one is
/// found, and what is kept no more is refused as such.
fn newest_alone(lab: &Lab) {
    lab.invoke("server/ctl/write", Some(json!(50.0)), false).unwrap_or_else(|refusal| panic!("{refusal}"));
    let first = newest(lab);
    assert_eq!(first.value["value"], json!(50.0));
    let later = eventually("it has written over that row", || match newest(lab) {
        row if row.seq > first.seq + 1000 => Ok(row),
        row => Err(row.seq),
    });
    assert!(later.stamp_ns > first.stamp_ns && later.value["value"] == json!(50.0), "{later:?}");
    for (when, why) in [
        (When::Tick(first.seq), "overwritten"),
        (When::Time(first.stamp_ns), "overwritten"),
        (When::Tick(u64::MAX), "not there yet"),
        (When::Time(u64::MAX), "not there yet"),
    ] {
        let refused = lab.row_at("server", when).expect_err("there is none");
        assert_eq!(refused.reason(), "ARGUMENT_INVALID", "{when:?}: {refused}");
        assert!(refused.to_string().contains(why), "{when:?}: {refused}");
    }
}

fn newest(lab: &Lab) -> Sample {
    lab.row_at("server", When::Newest).unwrap_or_else(|refusal| panic!("{refusal}"))
}

/// Over gRPC comes a row between the newest of before and of afterwards.
fn newest_over_grpc(lab: &Lab) {
    lab.invoke("server/ctl/write", Some(json!(50.0)), false).unwrap_or_else(|refusal| panic!("{refusal}"));
    let before = newest(lab);
    let remote = read(lab, None).unwrap_or_else(|status| panic!("{status}"));
    let after = newest(lab);
    assert!(
        (before.seq..=after.seq).contains(&remote.seq),
        "{} … {} … {}",
        before.seq,
        remote.seq,
        after.seq
    );
    assert!(
        (before.stamp_ns..=after.stamp_ns).contains(&remote.stamp_ns),
        "{before:?} … {remote:?} … {after:?}"
    );
    assert_eq!(remote.encoded.len(), before.encoded.len());
    let refused = read(lab, Some(Row::Tick(before.seq + u64::from(u32::MAX)))).expect_err("there is none");
    assert_eq!(refused.code(), tonic::Code::InvalidArgument, "{refused}");
}

pub fn rows_are_the_same_over_grpc(way: &Way) {
    let lab = Lab::listening(way);
    if way.deployment.server_never_rests() {
        return newest_over_grpc(&lab);
    }
    let known = five(way, &lab);
    let (stamp_ns, tick, expected) = known[2];
    for (row, when) in [
        (None, When::Newest),
        (Some(Row::AtNs(stamp_ns)), When::Time(stamp_ns)),
        (Some(Row::NearestNs(stamp_ns + 1)), When::Nearest(stamp_ns + 1)),
        (Some(Row::Tick(tick)), When::Tick(tick)),
        (Some(Row::Delayed(2)), When::Delayed(2)),
    ] {
        let near = || {
            let row = lab.row_at("server", when).unwrap_or_else(|refusal| panic!("{when:?}: {refusal}"));
            (row.encoded, row.stamp_ns, row.seq)
        };
        // What is newest may change in between: whoever heard of the last write may still step.
        eventually("the server rests", || {
            let before = near();
            let remote = read(&lab, row).unwrap_or_else(|status| panic!("{when:?}: {status}"));
            let remote = (remote.encoded, remote.stamp_ns, remote.seq);
            if before != near() {
                return Err(format!("{remote:?}"));
            }
            assert_eq!(remote, before, "{when:?}");
            Ok(())
        });
    }
    let remote = read(&lab, Some(Row::AtNs(stamp_ns))).unwrap_or_else(|status| panic!("{status}"));
    assert_eq!((remote.stamp_ns, expected), (stamp_ns, 30.0));
    let refused = read(&lab, Some(Row::Tick(u64::MAX))).expect_err("there is none");
    assert_eq!(refused.code(), tonic::Code::InvalidArgument, "{refused}");
    assert!(refused.message().contains("not there yet"), "{refused}");
}

fn read(lab: &Lab, row: Option<Row>) -> Result<ReadResponse, tonic::Status> {
    block_on(async {
        let channel = Channel::from_shared(format!("http://{}", lab.address())).expect("a good address");
        let channel = channel.connect().await.expect("the host answers");
        let request = ReadRequest { path: lab.path("server"), row, ..ReadRequest::default() };
        Ok(InteractServiceClient::new(channel).read(request).await?.into_inner())
    })
}
