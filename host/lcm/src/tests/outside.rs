//! Followers from outside: each gets the items at its own pace, and the component pushes once for all of
//! them.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use serde_json::json;
use tokio::sync::mpsc::Receiver;
use trocar_plugin_api::abi::{EXHAUSTED, Tick};

use super::super::boundary::puppet::Own;
use super::super::{Item, ItemKind, Selection, When};
use super::removal::destroy;
use super::*;

/// Number of followers: many, as of a page for everybody in a theatre.
const MANY: usize = 100;

/// Writes 1, 2, 3, …
#[derive(Default)]
struct Counts(AtomicU64);

impl Behaviour for Counts {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        own.write(0, &(self.0.fetch_add(1, Ordering::SeqCst) + 1));
        Ok(())
    }
}

async fn counting(process: &'static str) -> World {
    let world = World::new(process);
    let info = class(plain(false, true), Safety::None);
    world.create_as("source", info, periodic(1000), Arc::new(Counts::default())).await;
    world
}

impl World {
    async fn follow(&self, path: &str, max_rate_hz: f64, times: usize) -> Receiver<Item> {
        let path = format!("{}/{path}", self.process);
        self.select(Selection { path, max_rate_hz, ..Selection::default() }, times).await
    }

    async fn select(&self, one: Selection, times: usize) -> Receiver<Item> {
        self.lcm.subscribe(vec![one; times]).await.unwrap()
    }

    fn readers(&self) -> usize {
        let instance = self.lcm.instance(&self.id("source")).unwrap();
        instance.described.now().slots.output(0).readers()
    }

    fn listeners(&self) -> usize {
        let instance = self.lcm.instance(&self.id("source")).unwrap();
        let set = instance.described.now();
        let system = set.ports.provided.iter().position(|p| p.name == "system").unwrap();
        let events = &set.ports.provided[system].events;
        let changed = events.iter().position(|e| e.name == "state_changed").unwrap();
        set.slots.event(set.ports.first_event(system) + changed).listeners()
    }
}

#[tokio::test]
async fn however_many_follow_an_output_its_component_pushes_once() {
    let world = counting("outside_many").await;
    let mut told = world.follow("source/out", 1000.0, MANY).await;
    assert_eq!(world.readers(), 1);
    world.start("source").await;
    let mut seen = BTreeMap::<u64, usize>::new();
    // All are given items, and the same number never twice.
    while seen.values().copied().max() != Some(MANY) {
        let item = told.recv().await.unwrap();
        assert_eq!((item.kind, &item.value), (ItemKind::Stream, &json!(item.seq)));
        *seen.entry(item.seq).or_default() += 1;
    }
    assert!(seen.values().all(|n| *n <= MANY), "{seen:?}");
    assert_eq!(world.readers(), 1);
    drop(told);
    eventually("the last of them is gone", || world.readers() == 0).await;
    world.end().await;
}

#[tokio::test]
async fn one_who_looks_often_takes_nothing_from_one_who_looks_seldom() {
    let world = counting("outside_pace").await;
    let mut often = world.follow("source/out", 1000.0, 1).await;
    let mut seldom = world.follow("source/out", 20.0, 1).await;
    world.start("source").await;
    let mut last = 0;
    for _ in 0..5 {
        let item = seldom.recv().await.unwrap();
        let skipped = if last == 0 { 0 } else { item.seq - last - 1 };
        assert_eq!(item.skipped, skipped, "its own count, whatever others were given meanwhile");
        last = item.seq;
        while often.try_recv().is_ok() {}
    }
    assert_eq!(world.readers(), 1);
    world.end().await;
}

#[tokio::test]
async fn who_comes_later_is_given_what_is_written_after_that() {
    let world = counting("outside_later").await;
    let mut first = world.follow("source/out", 1000.0, 1).await;
    world.start("source").await;
    first.recv().await.unwrap();
    world.run("source", Verb::Stop).await.unwrap();
    let mut second = world.follow("source/out", 1000.0, 1).await;
    let written = {
        let instance = world.lcm.instance(&world.id("source")).unwrap();
        let set = instance.described.now();
        set.slots.output(0).seq.load(Ordering::SeqCst)
    };
    world.run("source", Verb::Resume).await.unwrap();
    assert!(second.recv().await.unwrap().seq > written, "an old sample is no news");
    world.end().await;
}

/// Makes frames 1, 2, 3, …
#[derive(Default)]
struct Camera(AtomicU64);

impl Behaviour for Camera {
    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        match own.give(0, self.0.fetch_add(1, Ordering::SeqCst) + 1) {
            EXHAUSTED => Err("those who look keep all frames".into()),
            _ => Ok(()),
        }
    }
}

#[tokio::test]
async fn those_who_want_pictures_share_a_reader_of_their_own_and_hold_no_frame() {
    let world = World::new("outside_frames");
    let mut ports = plain(false, true);
    let (header, format) = (Type::Prim(Prim::U64), "image".to_owned());
    ports.outputs[0].ty = PortType::Frame { header, format, max_bytes: 64 };
    world.create_as("source", class(ports, Safety::None), periodic(1000), Arc::new(Camera::default())).await;
    let path = format!("{}/source/out", world.process);
    let of_width = |thumbnail_width| Selection {
        path: path.clone(),
        max_rate_hz: 60.0,
        thumbnail_width,
        ..Selection::default()
    };
    let mut values = world.select(of_width(0), MANY).await;
    let mut pictures = world.select(of_width(64), MANY).await;
    let mut small = world.select(of_width(32), MANY).await;
    assert_eq!(world.readers(), 2);
    world.start("source").await;
    for told in [&mut values, &mut pictures, &mut small] {
        for _ in 0..2 * MANY {
            assert_eq!(told.recv().await.unwrap().kind, ItemKind::Stream);
        }
    }
    let sample = world.lcm.read(path.clone(), When::Newest, true, Instant::now() + PATIENCE).await.unwrap();
    assert_eq!(sample.value, json!(sample.seq));
    assert_eq!(world.readers(), 2);
    let report = world.report("source").await;
    assert_eq!((report.state, report.fault.as_str()), (State::Active, ""));
    world.end().await;
}

#[tokio::test]
async fn however_many_hear_an_event_its_component_pushes_once() {
    let world = counting("outside_events").await;
    let mut told = world.follow("source/system/state_changed", 0.0, MANY).await;
    assert_eq!(world.listeners(), 1);
    world.start("source").await;
    for _ in 0..MANY {
        let item = told.recv().await.unwrap();
        assert_eq!((item.kind, item.seq, item.skipped), (ItemKind::Event, 1, 0));
        assert_eq!(item.value["state"], json!("ACTIVE"));
    }
    let mut late = world.follow("source/system/state_changed", 0.0, 1).await;
    world.run("source", Verb::Stop).await.unwrap();
    let item = late.recv().await.unwrap();
    assert_eq!((item.seq, &item.value["state"]), (1, &json!("STOPPED{requested}")));
    for _ in 0..MANY {
        assert_eq!(told.recv().await.unwrap().seq, 2);
    }
    assert_eq!(world.listeners(), 1);
    drop(told);
    drop(late);
    eventually("the last of them is gone", || world.listeners() == 0).await;
    world.end().await;
}

#[tokio::test]
async fn what_an_event_told_before_its_component_went_is_given_and_then_the_stream_ends() {
    let world = counting("outside_ends").await;
    let mut told = world.follow("source/system/state_changed", 0.0, 2).await;
    world.start("source").await;
    world.run("source", Verb::Stop).await.unwrap();
    world.apply(destroy(&world, "source")).await.unwrap();
    let mut states = Vec::new();
    while let Some(item) = told.recv().await {
        states.push(item.value["state"].as_str().unwrap().to_owned());
    }
    states.sort();
    assert_eq!(states, ["ACTIVE", "ACTIVE", "STOPPED{requested}", "STOPPED{requested}"]);
    world.end().await;
}
