//! Samples: latest value, bounded queues with exact gap counts, staleness, rewiring.

use serde_json::json;
use trocar::model::{ConnectOptions, Health, Queue, State};

use super::super::{Lab, Samples, Way};
use crate::eventually;

/// Both running, and this input of the client connected to the server's samples.
fn flowing(way: &Way, input: &str, options: ConnectOptions) -> Lab {
    let lab = Lab::pair(way);
    lab.connect_with(&format!("client/{input}"), "server/value_out", options);
    lab.start("server");
    lab.start("client");
    lab
}

fn fifo(depth: usize, drop_oldest: bool) -> ConnectOptions {
    ConnectOptions { queue: Some(Queue::Fifo { depth, drop_oldest }), ..ConnectOptions::default() }
}

fn publish(lab: &Lab, samples: u32) {
    let done = lab.invoke("server/ctl/publish", Some(json!(f64::from(samples))), false);
    done.unwrap_or_else(|refusal| panic!("publishing: {refusal}"));
}

fn dropped(lab: &Lab) -> u64 {
    lab.links().iter().map(|l| l.dropped).sum()
}

pub fn the_latest_value_is_shown_again_and_is_fresh_once(way: &Way) {
    let lab = flowing(way, "latest", ConnectOptions::default());
    assert_eq!(lab.samples("look").count, 0, "nothing was written yet");
    publish(&lab, 10);
    let first = lab.samples("look");
    assert_eq!((first.last, first.fresh, first.gaps), (10.0, 1, 9), "the newest; nine were passed over");
    let again = lab.samples("look");
    assert_eq!((again.last, again.fresh), (10.0, 0));
    let skipped: u64 = lab.links().iter().map(|l| l.skipped).sum();
    assert_eq!((skipped, dropped(&lab)), (9, 0), "what a newer one took the place of is no loss");
}

pub fn a_full_queue_of_samples_drops_its_oldest_and_the_gap_says_how_many(way: &Way) {
    let lab = flowing(way, "fifo", fifo(4, true));
    publish(&lab, 10);
    let seen = lab.samples("collect");
    assert_eq!((seen.count, seen.first, seen.last, seen.gaps), (4, 7.0, 10.0, 6), "{seen:?}");
    assert_eq!(dropped(&lab), seen.gaps, "the connection counts what the gap says");
}

pub fn a_full_queue_of_samples_drops_the_newest_where_asked(way: &Way) {
    let lab = flowing(way, "fifo", fifo(4, false));
    publish(&lab, 10);
    let seen = lab.samples("collect");
    assert_eq!((seen.count, seen.first, seen.last, seen.gaps), (4, 1.0, 4.0, 0), "{seen:?}");
    publish(&lab, 1);
    let next = lab.samples("collect");
    assert_eq!((next.count, next.first, next.gaps), (1, 11.0, 6), "{next:?}");
    assert_eq!(dropped(&lab), 6);
}

pub fn an_input_s_own_depth_counts_where_the_connection_names_none(way: &Way) {
    let lab = flowing(way, "fifo", ConnectOptions::default());
    publish(&lab, 20);
    let seen = lab.samples("collect");
    assert_eq!((seen.count, seen.first, seen.gaps), (8, 13.0, 12), "{seen:?}");
}

pub fn nothing_is_lost_without_being_counted_while_both_run(way: &Way) {
    let lab = flowing(way, "fifo", fifo(16, true));
    let mut all = Samples { count: 0, gaps: 0, first: 0.0, last: 0.0, stale: 0, fresh: 0 };
    let mut take = || {
        let seen = lab.samples("collect");
        (all.count, all.gaps) = (all.count + seen.count, all.gaps + seen.gaps);
    };
    std::thread::scope(|scope| {
        let source = scope.spawn(|| (0..40).for_each(|_| publish(&lab, 13)));
        while !source.is_finished() {
            take();
        }
        source.join().expect("each sample was published");
    });
    take();
    assert_eq!(all.count + all.gaps, 40 * 13, "{all:?}");
    assert_eq!(dropped(&lab), all.gaps, "{all:?}");
}

pub fn one_output_feeds_many_inputs_each_at_its_own_pace(way: &Way) {
    let lab = flowing(way, "fifo", fifo(4, true));
    lab.connect("client/latest", "server/value_out");
    publish(&lab, 3);
    assert_eq!(lab.samples("look").last, 3.0);
    let seen = lab.samples("collect");
    assert_eq!((seen.count, seen.first, seen.gaps), (3, 1.0, 0), "{seen:?}");
}

pub fn a_sample_older_than_the_connection_allows_is_stale(way: &Way) {
    // Long enough that its own end on a grid sees it, and that what is told to a GCM in another process is
    // not over by then.
    let max_age_ns = if way.deployment.two_processes() { 300_000_000 } else { 20_000_000 };
    let options = ConnectOptions { max_age_ns: Some(max_age_ns), ..ConnectOptions::default() };
    let lab = flowing(way, "latest", options);
    let until = |what: &str, health, doing: &dyn Fn()| {
        eventually(what, || {
            doing();
            let now = lab.stands("client");
            if now == Some((State::Active, health)) { Ok(()) } else { Err(format!("{now:?}")) }
        });
    };
    until("nothing that ever came is too old as well", Health::StaleInput, &|| ());
    for _ in 0..2 {
        until("the client is well", Health::Ok, &|| publish(&lab, 1));
        let newest = lab.count("server", "samples") as f64;
        until("the client has stale input", Health::StaleInput, &|| ());
        let seen = lab.samples("look");
        // It is still shown, so that the component chooses.
        assert_eq!((seen.last, seen.stale), (newest, 1), "{seen:?}");
    }
    eventually("a sample that is looked at in time is not stale", || {
        publish(&lab, 1);
        let seen = lab.samples("look");
        if (seen.fresh, seen.stale) == (1, 0) { Ok(()) } else { Err(format!("{seen:?}")) }
    });
    until("the client has stale input again", Health::StaleInput, &|| ());
    lab.disconnect("client/latest", "server/value_out");
    until("without a connection nothing is too old", Health::Ok, &|| ());
}

pub fn samples_of_a_clock_that_is_ahead_or_behind_are_stale_when_health_says_so(way: &Way) {
    let max_age_ns = if way.deployment.two_processes() { 300_000_000 } else { 20_000_000 };
    let options = ConnectOptions { max_age_ns: Some(max_age_ns), ..ConnectOptions::default() };
    let lab = flowing(way, "latest", options);
    let stands = |health| {
        let now = lab.stands("client");
        if now == Some((State::Active, health)) { Ok(()) } else { Err(format!("{now:?}")) }
    };
    // Ahead: a sample is as old as its coming, for the component as for its health.
    lab.configure("server", json!({ "clock_s": 3600.0 })).expect("clock_s is live");
    eventually("a sample that has just come is fresh, and the client is well", || {
        publish(&lab, 1);
        let seen = lab.samples("look");
        if (seen.fresh, seen.stale) != (1, 0) {
            return Err(format!("{seen:?}"));
        }
        stands(Health::Ok)
    });
    eventually("after it the client has stale input", || stands(Health::StaleInput));
    let seen = lab.samples("look");
    assert_eq!(seen.stale, 1, "what health calls stale is stale for the component: {seen:?}");
    eventually("the server is warned of its stamps", || {
        let said = lab.warnings("server");
        if said
            .iter()
            .any(|w| w.contains("stamped with a time to come") && w.contains("s ahead at value_out"))
        {
            Ok(())
        } else {
            Err(said.join("; "))
        }
    });
    // Behind: as old as its stamp says, for both.
    lab.configure("server", json!({ "clock_s": -3600.0 })).expect("clock_s is live");
    publish(&lab, 1);
    eventually("the old sample has arrived", || {
        publish(&lab, 1);
        let seen = lab.samples("look");
        if seen.last == lab.count("server", "samples") as f64 { Ok(()) } else { Err(format!("{seen:?}")) }
    });
    let seen = lab.samples("look");
    assert_eq!(seen.stale, 1, "{seen:?}");
    eventually("the client has stale input while samples come", || {
        publish(&lab, 1);
        stands(Health::StaleInput)
    });
}

pub fn a_slow_consumer_misses_what_its_queue_cannot_hold_and_knows_how_much(way: &Way) {
    let lab = flowing(way, "fifo", fifo(2, true));
    for round in 1..=50_u32 {
        publish(&lab, 3);
        let (seen, newest) = (lab.samples("collect"), f64::from(3 * round));
        assert_eq!((seen.count, seen.gaps, seen.first, seen.last), (2, 1, newest - 1.0, newest), "{seen:?}");
    }
    assert_eq!((dropped(&lab), lab.count("server", "samples")), (50, 150));
}

pub fn a_cut_stream_shows_nothing_and_a_new_one_starts_afresh(way: &Way) {
    let lab = flowing(way, "latest", ConnectOptions::default());
    publish(&lab, 2);
    assert_eq!(lab.samples("look").last, 2.0);
    lab.disconnect("client/latest", "server/value_out");
    assert_eq!(lab.samples("look").count, 0, "a cut input shows nothing old");
    lab.connect("client/latest", "server/value_out");
    publish(&lab, 1);
    assert_eq!(lab.samples("look").last, 3.0);
}

pub fn an_input_is_rewired_in_one_request(way: &Way) {
    let lab = flowing(way, "latest", ConnectOptions::default());
    lab.create("other", "Server", json!({}), super::own_thread());
    lab.start("other");
    publish(&lab, 5);
    assert_eq!(lab.samples("look").last, 5.0);
    let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
    lab.connect_with("client/latest", "other/value_out", options);
    assert_eq!(lab.graph().connections.len(), 1, "the old connection went");
    lab.invoke("other/ctl/publish", Some(json!(1.0)), false).expect("the other publishes");
    assert_eq!(lab.samples("look").last, 1.0);
}
