//! Frames: never copied, changed in place by a sole owner, bounded by their pool.

use serde_json::{Value, json};
use trocar::model::{ConnectOptions, Execution, OnFailure, Queue, State};

use super::super::answer::whole;
use super::super::{Lab, Reach, Way};
use crate::eventually;

/// Bytes of a frame of the fixture.
const FRAME: u64 = 4096;

fn publish(lab: &Lab, frames: u32) {
    let done = lab.invoke("server/ctl/publish_frames", Some(json!(f64::from(frames))), false);
    done.unwrap_or_else(|refusal| panic!("publishing frames: {refusal}"));
}

/// The frame that was published. In memory that is mapped twice the first one of a pool comes when that
/// memory is mapped, and what was taken is back when the maker has noticed.
fn taken(lab: &Lab) -> Value {
    let mut frame = lab.own("take_frame");
    if lab.maps() && whole(&frame["at"]) == 0 {
        frame = eventually("the frame comes", || match lab.own("take_frame") {
            frame if whole(&frame["at"]) != 0 => Ok(frame),
            frame => Err(format!("{frame}")),
        });
    }
    frame
}

fn connected(way: &Way, options: ConnectOptions) -> Lab {
    let lab = Lab::pair(way);
    lab.connect_with("client/frame", "server/frame_out", options);
    lab.start("server");
    lab.start("client");
    lab
}

/// The file behind an address of a component's process, and the place in it.
fn behind(lab: &Lab, (component, at): (&str, &Value)) -> (u64, u64) {
    let at = whole(at);
    let maps = std::fs::read_to_string(format!("/proc/{}/maps", lab.pid_of(component)));
    let maps = maps.expect("Linux shows what is mapped");
    let found = maps.lines().find_map(|line| {
        let mut parts = line.split_whitespace();
        let (from, to) = parts.next()?.split_once('-')?;
        let number = |text| u64::from_str_radix(text, 16).ok();
        let (from, to, offset) = (number(from)?, number(to)?, number(parts.nth(1)?)?);
        (from..to).contains(&at).then_some((parts.nth(1)?.parse().ok()?, offset + at - from))
    });
    found.unwrap_or_else(|| panic!("nothing is mapped at {at:#x}"))
}

/// The very bytes its maker wrote, not a copy. Each end that maps them has an address of its own.
fn lies_where_it_was_made(lab: &Lab, at: (&str, &Value), made: (&str, &Value)) {
    if lab.copies() {
        assert_ne!(behind(lab, at), behind(lab, made), "memory does not leave its machine");
    } else if lab.maps() {
        assert_eq!(behind(lab, at), behind(lab, made), "another file, or another place in it");
    } else {
        assert_eq!(at.1, made.1);
    }
}

pub fn a_frame_arrives_where_it_was_made(way: &Way) {
    let lab = connected(way, ConnectOptions::default());
    publish(&lab, 1);
    let frame = taken(&lab);
    lies_where_it_was_made(&lab, ("client", &frame["at"]), ("server", &lab.row("server")["frame_at"]));
    assert_eq!((whole(&frame["len"]), whole(&frame["seq"]), whole(&frame["byte"])), (FRAME, 1, 1));
    let own = u64::from(!way.deployment.maps());
    assert_eq!(
        whole(&frame["own"]),
        own,
        "nobody else has it, but where it is mapped twice only its maker may write it"
    );
    assert_eq!(whole(&lab.own("take_frame")["at"]), 0, "each frame is given once");
}

pub fn a_frame_that_two_have_is_nobody_s_to_change(way: &Way) {
    let lab = connected(way, ConnectOptions::default());
    lab.create("second", "Client", json!({}), super::own_thread());
    lab.connect("second/frame", "server/frame_out");
    lab.start("second");
    publish(&lab, 1);
    let frame = taken(&lab);
    lies_where_it_was_made(&lab, ("client", &frame["at"]), ("server", &lab.row("server")["frame_at"]));
    assert_eq!(whole(&frame["own"]), 0);
    let other = lab.invoke("second/run/take_frame", None, false).expect("the second takes it").value;
    lies_where_it_was_made(&lab, ("second", &other.unwrap_or_default()["at"]), ("client", &frame["at"]));
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
    lies_where_it_was_made(&lab, ("client", &frame["at"]), ("source", &lab.row("source")["frame_at"]));
}

fn fifo(depth: usize, drop_oldest: bool) -> ConnectOptions {
    ConnectOptions { queue: Some(Queue::Fifo { depth, drop_oldest }), ..ConnectOptions::default() }
}

/// Takes what waits at a client; the sequence numbers. The last frame stays in its hands.
fn rest(lab: &Lab, client: &str) -> Vec<u64> {
    let take = || {
        let frame = lab.invoke(&format!("{client}/run/take_frame"), None, false);
        whole(&frame.unwrap_or_else(|refusal| panic!("{client}: {refusal}")).value.unwrap_or_default()["seq"])
    };
    std::iter::from_fn(|| Some(take()).filter(|seq| *seq > 0)).collect()
}

/// The pool has four slots, and nobody takes anything.
fn untaken(way: &Way, drop_oldest: bool) -> Lab {
    let lab = connected(way, fifo(16, drop_oldest));
    publish(&lab, 10);
    assert_eq!((lab.count("server", "samples"), lab.count("server", "exhausted")), (10, 0));
    lab
}

pub fn a_queue_of_frames_gives_up_its_oldest_before_their_pool_is_empty(way: &Way) {
    let lab = untaken(way, true);
    assert_eq!(lab.link("client/frame").dropped, 8);
    assert_eq!(rest(&lab, "client"), [9, 10], "two frames for each slot that is free");
    lab.own("release_frame");
    publish(&lab, 3);
    assert_eq!(rest(&lab, "client"), [12, 13]);
    let link = lab.link("client/frame");
    assert_eq!((link.passed, link.dropped, lab.count("server", "exhausted")), (4, 9, 0), "{link:?}");
}

pub fn a_queue_that_keeps_its_oldest_frames_takes_no_more_before_their_pool_is_empty(way: &Way) {
    let lab = untaken(way, false);
    assert_eq!(lab.link("client/frame").dropped, 8);
    assert_eq!(rest(&lab, "client"), [1, 2], "as many as slots are free");
    lab.own("release_frame");
    publish(&lab, 1);
    assert_eq!(rest(&lab, "client"), [11]);
    assert_eq!(lab.count("server", "exhausted"), 0);
}

pub fn an_exhausted_pool_is_a_counted_drop(way: &Way) {
    let newest = || ConnectOptions { queue: Some(Queue::Latest), ..ConnectOptions::default() };
    let lab = connected(way, newest());
    let clients = ["client", "second", "third", "fourth"];
    for name in &clients[1..] {
        lab.create(name, "Client", json!({}), super::own_thread());
        lab.connect_with(&format!("{name}/frame"), "server/frame_out", newest());
        lab.start(name);
    }
    // Each keeps another one of the four slots in its hands.
    for (name, number) in clients.iter().zip(1..) {
        publish(&lab, 1);
        assert_eq!(rest(&lab, name), [number]);
    }
    publish(&lab, 6);
    if way.reach() == Reach::Machine {
        // A frame in the hands of another machine takes nothing from the pool here.
        assert_eq!((lab.count("server", "samples"), lab.count("server", "exhausted")), (10, 0));
        return;
    }
    assert_eq!((lab.count("server", "samples"), lab.count("server", "exhausted")), (4, 6));
    let fourth = lab.link("fourth/frame");
    assert_eq!((fourth.skipped, fourth.dropped), (3, 6), "what it missed and what there was no slot for");
    for name in clients {
        rest(&lab, name);
        lab.invoke(&format!("{name}/run/release_frame"), None, false).expect("it lets go");
    }
    publish(&lab, 3);
    assert_eq!(lab.count("server", "exhausted"), 6, "slots that were handed back are used again");
}

pub fn a_branch_that_takes_no_frames_costs_the_others_none(way: &Way) {
    for drop_oldest in [true, false] {
        let lab = connected(way, ConnectOptions::default());
        lab.create("second", "Client", json!({}), super::own_thread());
        lab.connect_with("second/frame", "server/frame_out", fifo(64, drop_oldest));
        lab.start("second");
        publish(&lab, 1);
        assert_eq!((rest(&lab, "client"), rest(&lab, "second")), (vec![1], vec![1]), "both have it in hands");
        lab.stop("second");
        for number in 2..=50 {
            publish(&lab, 1);
            let (came, exhausted) = (rest(&lab, "client"), lab.count("server", "exhausted"));
            assert_eq!(came, [number], "{exhausted} without memory; {:?}", lab.link("client/frame"));
        }
        assert_eq!((lab.count("server", "samples"), lab.count("server", "exhausted")), (50, 0));
        assert_eq!(lab.link("client/frame").dropped, 0);
        lab.resume("second");
        let kept = rest(&lab, "second");
        if way.reach() == Reach::Machine {
            // On its own machine it has memory for as many as its queue holds.
            assert_eq!(kept, (2..=50).collect::<Vec<u64>>());
        } else {
            let expected: &[u64] = if drop_oldest { &[49, 50] } else { &[2] };
            assert_eq!(kept, expected, "beside a frame in the hands of each");
        }
        let branch = lab.link("second/frame");
        let taken = 1 + kept.len() as u64;
        assert_eq!(
            (branch.passed, branch.dropped),
            (taken, 50 - taken),
            "each is taken or counted: {branch:?}"
        );
    }
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
    assert_eq!(whole(&lab.own("take_frame")["at"]), 0, "the frame it failed on does not go by");
    from_source(&lab);
    let frame = eventually("the frame goes by", || match lab.own("take_frame") {
        frame if whole(&frame["at"]) != 0 => Ok(frame),
        none => Err(none),
    });
    lies_where_it_was_made(&lab, ("client", &frame["at"]), ("source", &lab.row("source")["frame_at"]));
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
    assert_eq!(whole(&lab.own("take_frame")["at"]), 0, "nothing passes the filter");
}
