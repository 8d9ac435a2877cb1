//! Changes that a process has done after they were given up.
//!
//! Promise: what a caller was told to have failed does not stay, and what is gone is not listed.

use serde_json::json;
use trocar_lcm_api::{Decision, Lcm, News, clock};
use trocar_model::{Change, ConnectOptions, PortId, plan};

use super::*;

fn connect(client: &str, server: &str) -> Request {
    let port = |path: &str| PortId::parse(path).unwrap();
    Request::Connect { client: port(client), server: port(server), options: ConnectOptions::default() }
}

fn configure(path: &str) -> Request {
    Request::Configure { id: id(path), patch: json!({ "gain": 2.0 }), execution: None }
}

/// A change that the process does and tells too late.
async fn late(lcm: &FakeLcm, change: Change) {
    let done = lcm.apply(change.clone(), clock::now().into()).await.unwrap();
    lcm.news.send(News::Late(Box::new(change), Decision::NONE, done)).unwrap();
}

fn planned(gcm: &Gcm, request: &Request) -> Change {
    plan(&gcm.graph(), request).unwrap().changes.remove(0)
}

#[tokio::test]
async fn what_is_made_late_is_removed_again() {
    let (gcm, lcm) = system().await;
    let change = planned(&gcm, &create("host/late"));
    late(&lcm, change).await;
    while lcm.state("host/late").is_some() {
        tokio::task::yield_now().await;
    }
    assert!(gcm.graph().components.is_empty(), "nobody was told that it is there");
    ask(&gcm, vec![create("host/late")]).await.unwrap();
}

#[tokio::test]
async fn what_is_made_late_and_was_accepted_meanwhile_stays() {
    let (gcm, lcm) = system().await;
    let change = planned(&gcm, &create("host/late"));
    ask(&gcm, vec![create("host/late")]).await.unwrap();
    late(&lcm, change).await;
    // A request that has to wait for the look at it.
    ask(&gcm, vec![configure("host/late")]).await.unwrap();
    assert!(lcm.state("host/late").is_some());
}

#[tokio::test]
async fn settings_that_are_taken_late_count_unless_others_were_given_since() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    let change = planned(&gcm, &configure("host/a"));
    let config = || gcm.graph().components[&id("host/a")].config.clone();
    let before = config();
    // The first was ordered before it was made anew, the second is the last word.
    for (decision, as_told) in [(Decision::NONE, false), (Decision::MOST, true)] {
        let has = lcm.inventory().await.unwrap().components.remove(0);
        lcm.news.send(News::Late(Box::new(change.clone()), decision, has)).unwrap();
        gcm.hear_out(&name("host")).await;
        super::journal::all_run().await;
        assert_eq!(config() != before, as_told, "{decision:?}");
    }
}

#[tokio::test]
async fn a_failed_component_keeps_the_settings_that_it_took_late() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    let change = planned(&gcm, &configure("host/a"));
    let Change::Configure { to, .. } = &change else { panic!("{change:?}") };
    let configured = || lcm.done().into_iter().filter(|done| done.starts_with("Configure")).count();
    let before = configured();
    lcm.become_state("host/a", State::Fault, "it broke");
    until(&gcm, "it has failed", |graph| graph.components[&id("host/a")].state == State::Fault).await;
    let has = lcm.inventory().await.unwrap().components.remove(0);
    lcm.news.send(News::Late(Box::new(change.clone()), Decision::MOST, has)).unwrap();
    until(&gcm, "it is listed with them", |graph| graph.components[&id("host/a")].config == *to).await;
    assert_eq!(configured(), before, "one in FAULT takes no settings");
}

#[tokio::test]
async fn settings_that_it_does_not_give_back_are_what_it_is_listed_with() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    let change = planned(&gcm, &configure("host/a"));
    let Change::Configure { to, .. } = &change else { panic!("{change:?}") };
    lcm.refuse("Configure host/a");
    let has = lcm.inventory().await.unwrap().components.remove(0);
    lcm.news.send(News::Late(Box::new(change.clone()), Decision::MOST, has)).unwrap();
    until(&gcm, "it is listed with what it has", |graph| graph.components[&id("host/a")].config == *to).await;
}

#[tokio::test]
async fn what_is_removed_late_is_gone_with_its_connections_and_a_new_revision() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), create("host/b"), connect("host/a/robot", "host/b/arm")]).await.unwrap();
    let (id, before) = (id("host/b"), gcm.graph());
    let component = Box::new(component(&before, "host/b"));
    late(&lcm, Change::Destroy { id: id.clone(), component }).await;
    let graph = until(&gcm, "it is gone", |graph| !graph.components.contains_key(&id)).await;
    assert!(graph.connections.is_empty(), "{:?}", graph.connections);
    assert_eq!(graph.revision, before.revision + 1);
    let wanted = gcm.inner.ledger.wanted();
    assert!(!wanted.components.contains_key(&id) && wanted.connections.is_empty());
}

#[tokio::test]
async fn what_is_connected_late_is_cut() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), create("host/b")]).await.unwrap();
    let change = planned(&gcm, &connect("host/a/robot", "host/b/arm"));
    late(&lcm, change).await;
    let cut = "Disconnect host/a/robot from host/b/arm";
    while !lcm.done().iter().any(|done| done == cut) {
        tokio::task::yield_now().await;
    }
    assert!(gcm.graph().connections.is_empty());
}

#[tokio::test]
async fn where_news_is_lost_what_was_done_late_is_found_and_what_could_not_be_made_stays_listed() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), create("host/b"), create("host/lost")]).await.unwrap();
    let made = planned(&gcm, &create("host/late"));
    let destroy = |path: &str| {
        let component = Box::new(component(&gcm.graph(), path));
        Change::Destroy { id: id(path), component }
    };
    let gone = [made, destroy("host/b"), destroy("host/lost")];
    gcm.edit(|graph| {
        let lost = graph.components.get_mut(&id("host/lost")).unwrap();
        (lost.state, lost.health) = (State::Fault, Health::Lost);
    });
    for change in gone {
        lcm.apply(change, clock::now().into()).await.unwrap();
    }
    // More than its followers can keep.
    for at in 0..200 {
        lcm.log("host/a", 3, &format!("line {at}"));
    }
    while lcm.state("host/late").is_some() {
        tokio::task::yield_now().await;
    }
    let graph = until(&gcm, "it is gone", |graph| !graph.components.contains_key(&id("host/b"))).await;
    assert_eq!(graph.components.keys().map(ToString::to_string).collect::<Vec<_>>(), ["host/a", "host/lost"]);
}
