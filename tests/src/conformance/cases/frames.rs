//! Frames: never copied, changed in place by a sole owner, bounded by their pool.

use serde_json::{Value, json};
use trocar::model::{ConnectOptions, Execution, OnFailure, Queue, State};

use super::super::answer::whole;
use super::super::{Lab, Way};
use crate::eventually;

/// Bytes of a frame of the fixture.
const FRAME: u64 = 4096;

fn publish(lab: &Lab, frames: u32) {
    let done = lab.invoke("server/ctl/publish_frames", Some(json!(f64::from(frames))), false);
    done.unwrap_or_else(|refusal| panic!("publishing frames: {refusal}"));
}

fn taken(lab: &Lab) -> Value {
    lab.own("take_frame")
}

fn connected(way: &Way, options: ConnectOptions) -> Lab {
    let lab = Lab::pair(way);
    lab.connect_with("client/frame", "server/frame_out", options);
    lab.start("server");
    lab.start("client");
    lab
}

pub fn a_frame_arrives_where_it_was_made(way: &Way) {
    let lab = connected(way, ConnectOptions::default());
    publish(&lab, 1);
    let frame = taken(&lab);
    assert_eq!(frame["at"], lab.row("server")["frame_at"], "the very bytes, not a copy");
    assert_eq!((whole(&frame["len"]), whole(&frame["seq"]), whole(&frame["byte"])), (FRAME, 1, 1));
    assert_eq!(whole(&frame["own"]), 1, "nobody else has it");
    assert_eq!(whole(&taken(&lab)["at"]), 0, "each frame is given once");
}

pub fn a_frame_that_two_have_is_nobody_s_to_change(way: &Way) {
    let lab = connected(way, ConnectOptions::default());
    lab.create("second", "Client", json!({}), super::own_thread());
    lab.connect("second/frame", "server/frame_out");
    lab.start("second");
    publish(&lab, 1);
    let frame = taken(&lab);
    assert_eq!(frame["at"], lab.row("server")["frame_at"]);
    assert_eq!(whole(&frame["own"]), 0);
    let other = lab.invoke("second/run/take_frame", None, false).expect("the second takes it").value;
    let other = other.unwrap_or_default();
    assert_eq!(other["at"], frame["at"], "both see one frame");
}

pub fn a_filter_changes_a_frame_in_place(way: &Way) {
    let lab = Lab::pair(way);
    let alone = Execution { stream_of: Some("host/source".into()), ..Execution::default() };
    lab.create("source", "Server", json!({}), super::stream());
    lab.create("through", "Through", json!({}), alone);
    lab.connect("through/frame", "source/frame_out");
    lab.connect("client/frame", "through/frame_out");
    for name in ["client", "through", "source"] {
        lab.start(name);
    }
    lab.invoke("source/ctl/publish_frames", Some(json!(1.0)), false).expect("a frame is published");
    lab.await_count("through", "passed", |n| n == 1);
    assert_eq!(lab.count("through", "changed"), 1, "it was the only owner");
    let frame = taken(&lab);
    assert_eq!(whole(&frame["byte"]), 2, "what the filter added");
    assert_eq!(frame["at"], lab.row("source")["frame_at"], "no copy on the way");
}

pub fn an_exhausted_pool_is_a_counted_drop(way: &Way) {
    let queue = Some(Queue::Fifo { depth: 16, drop_oldest: true });
    let lab = connected(way, ConnectOptions { queue, ..ConnectOptions::default() });
    // The pool has four slots, and nobody takes anything.
    publish(&lab, 10);
    assert_eq!((lab.count("server", "samples"), lab.count("server", "exhausted")), (4, 6));
    for number in 1..=4 {
        assert_eq!(whole(&taken(&lab)["seq"]), number);
    }
    lab.own("release_frame");
    publish(&lab, 3);
    assert_eq!(lab.count("server", "exhausted"), 6, "slots that were handed back are used again");
}

/// `source` → `through` in one stream → `host/client`; the filter has this configuration and policy.
fn filtered(way: &Way, filter: Value, head: Execution, on_failure: OnFailure) -> Lab {
    let lab = Lab::pair(way);
    lab.create("source", "Server", json!({}), head);
    let member = Execution {
        stream_of: Some("host/source".into()),
        on_failure: Some(on_failure),
        ..Execution::default()
    };
    lab.create("through", "Through", filter, member);
    lab.connect("through/frame", "source/frame_out");
    lab.connect("client/frame", "through/frame_out");
    for name in ["client", "through", "source"] {
        lab.start(name);
    }
    lab
}

fn from_source(lab: &Lab) {
    lab.invoke("source/ctl/publish_frames", Some(json!(1.0)), false).expect("a frame is published");
}

pub fn the_threads_of_a_stream_work_on_slices_at_the_same_time(way: &Way) {
    let head = Execution { threads: Some(3), ..super::stream() };
    let lab = filtered(way, json!({ "slices": 3 }), head, OnFailure::StopBranch);
    for round in 1..=5 {
        from_source(&lab);
        lab.await_count("through", "passed", |n| n == round);
        assert_eq!(lab.count("through", "slices"), 3 * round, "each slice once");
    }
    assert_eq!(lab.count("through", "together"), 3);
}

pub fn a_filter_that_failed_is_bypassed_where_its_stream_says_so(way: &Way) {
    let lab = filtered(way, json!({ "fail": true }), super::stream(), OnFailure::Bypass);
    from_source(&lab);
    lab.await_state("through", State::Fault);
    assert_eq!(whole(&taken(&lab)["at"]), 0, "the frame it failed on does not go by");
    from_source(&lab);
    let frame = eventually("the frame goes by", || match taken(&lab) {
        frame if whole(&frame["at"]) != 0 => Ok(frame),
        none => Err(none),
    });
    assert_eq!(frame["at"], lab.row("source")["frame_at"], "no copy on the way");
    assert_eq!(frame["byte"], json!(2), "as it was made");
}

pub fn a_filter_that_failed_stops_its_branch_and_no_other(way: &Way) {
    let lab = filtered(way, json!({ "fail": true }), super::stream(), OnFailure::StopBranch);
    lab.create("second", "Client", json!({}), super::own_thread());
    lab.connect("second/frame", "source/frame_out");
    lab.start("second");
    from_source(&lab);
    lab.await_state("through", State::Fault);
    for number in 1..=3 {
        let frame = lab.invoke("second/run/take_frame", None, false).expect("the second takes it").value;
        assert_eq!(frame.map(|f| whole(&f["seq"])), Some(number), "the trunk goes on");
        from_source(&lab);
    }
    assert_eq!(whole(&taken(&lab)["at"]), 0, "nothing passes the filter");
}
