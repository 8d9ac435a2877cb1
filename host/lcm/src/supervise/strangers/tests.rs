//! Owners of threads: found by number and begin, whatever the name is, and without a look at those of the
//! host.
#![allow(clippy::unwrap_used)]

use std::env;
use std::process::Command;
use std::sync::mpsc::{Sender, channel};
use std::thread;

use trocar_rt::{house, os};

use super::{Moment, Strangers, looks, threads};

/// Starts a thread that lives until its `Sender` is dropped; returns its kernel id.
fn started(by: impl FnOnce(Box<dyn FnOnce() + Send>)) -> (i32, Sender<()>) {
    let (tell, told) = channel();
    let (end, ended) = channel::<()>();
    by(Box::new(move || {
        tell.send(os::thread_id()).unwrap();
        let _ = ended.recv();
    }));
    (told.recv().unwrap(), end)
}

fn named(name: &str) -> thread::Builder {
    thread::Builder::new().name(name.into())
}

#[test]
fn a_thread_is_the_hosts_by_its_number_and_not_by_its_name() {
    let moment = Moment::now();
    let (foreign, _foreign) = started(|run| drop(named("trocar-log").spawn(run).unwrap()));
    let (own, _own) = started(|run| drop(house::spawn(named("a-library"), run).unwrap()));
    let seen = Strangers::look();
    let since: Vec<i32> = seen.since(moment).map(|thread| thread.tid).collect();
    assert!(since.contains(&foreign) && !since.contains(&own), "{since:?}, {foreign} and {own}");
}

#[test]
fn a_thread_that_was_there_is_not_taken_for_one_that_came() {
    for _ in 0..200 {
        let (elder, _elder) = started(|run| drop(named("elder").spawn(run).unwrap()));
        let moment = Moment::now();
        let (younger, _younger) = started(|run| drop(named("younger").spawn(run).unwrap()));
        assert!(!moment.is_still_so());
        let seen = Strangers::look();
        let since: Vec<i32> = seen.since(moment).map(|thread| thread.tid).collect();
        assert!(
            since.contains(&younger) && !since.contains(&elder),
            "{moment:?}, {elder}, {younger}, {since:?}"
        );
    }
}

#[test]
fn numbers_that_begin_anew_and_clocks_that_are_coarse_change_nothing() {
    let at = |last| Moment { ticks: 100, last };
    // Columns: number given last, number of the thread, its begin; whether it came after.
    for (last, tid, began, after) in [
        (Some(500), 500, 100, false),
        (Some(500), 501, 100, true),
        (Some(500), 499, 101, false),
        (Some(500), 501, 99, true),
        (Some(500), 501, 98, false),
        (Some(500), 400, 102, true),
        (Some(32_767), 301, 100, true),
        (Some(301), 32_767, 100, false),
        (Some(4_194_303), 301, 101, true),
        (None, 501, 99, false),
        (None, 499, 100, true),
    ] {
        assert_eq!(at(last).is_before(tid, began), after, "{last:?}, {tid} at {began}");
    }
    assert!(!at(None).is_still_so(), "where the kernel does not say, nothing is sure");
}

/// Otherwise a thread from before an entry would count as made by it, and the component that "made" it would
/// be kept for ever when it is removed.
#[test]
fn a_thread_that_goes_on_is_in_every_list_although_others_end_meanwhile() {
    for round in 0..400 {
        let (go, wait) = channel::<()>();
        thread::scope(|scope| {
            // This thread comes after those that end: the reader has passed them when it comes to this one.
            let ends: Vec<_> = (0..64)
                .map(|_| {
                    let (end, ended) = channel::<()>();
                    scope.spawn(move || ended.recv());
                    end
                })
                .collect();
            let (tell, told) = channel();
            scope.spawn(move || {
                let own = std::fs::read_link("/proc/thread-self").unwrap();
                tell.send(own.file_name().unwrap().to_str().unwrap().parse::<i32>().unwrap()).unwrap();
                wait.recv()
            });
            let tid = told.recv().unwrap();
            scope.spawn(move || drop(ends));
            for look in 0..40 {
                assert!(threads::list().contains(&tid), "round {round}, look {look}: it is missing");
            }
            drop(go);
        });
    }
}

/// Marks the process made for this test: threads of other tests would count, too.
const CHILD: &str = "TROCAR_STRANGERS_CHILD";

#[test]
fn the_process_whose_threads_are_counted() {
    if env::var_os(CHILD).is_none() {
        return;
    }
    let mut many = Vec::new();
    let mut cost = Vec::new();
    for _ in 0..2 {
        let before = looks();
        drop(Strangers::look());
        cost.push(looks() - before);
        many.extend((0..64).map(|_| started(|run| drop(house::spawn(named("trocar-x"), run).unwrap()))));
    }
    assert_eq!(cost[0], cost[1], "threads of the host are looked at one by one");
}

#[test]
fn a_look_does_not_cost_by_the_number_of_the_hosts_threads() {
    let child = Command::new(env::current_exe().unwrap())
        .args([
            "--exact",
            "supervise::strangers::tests::the_process_whose_threads_are_counted",
            "--nocapture",
        ])
        .env(CHILD, "1")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&child.stdout).into_owned() + &String::from_utf8_lossy(&child.stderr);
    assert!(child.status.success() && said.contains("1 passed"), "{said}");
}
