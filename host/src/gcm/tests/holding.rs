//! Components that go with their holder.

use super::*;

fn hold(gcm: &Gcm, path: &str) -> super::super::Held {
    gcm.hold(id(path), "somebody".into()).unwrap()
}

#[tokio::test]
async fn what_is_held_goes_with_its_holder_whether_it_was_there_before_or_came_later() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    let (a, b) = (hold(&gcm, "host/a"), hold(&gcm, "host/b"));
    ask(&gcm, vec![create("host/b")]).await.unwrap();
    a.end().await;
    assert_eq!(gcm.graph().components.keys().cloned().collect::<Vec<_>>(), [id("host/b")]);
    assert!(lcm.done().contains(&"Remove host/a".to_owned()), "it is stopped first: {:?}", lcm.done());
    b.end().await;
    assert!(gcm.graph().components.is_empty());
    hold(&gcm, "host/never").end().await;
}

#[tokio::test]
async fn what_was_removed_is_held_no_more_whoever_takes_its_name() {
    let (gcm, _lcm) = system().await;
    let mut held = hold(&gcm, "host/a");
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    ask(&gcm, vec![Request::Remove { id: id("host/a"), force: false }]).await.unwrap();
    comes("the hold is over", held.over()).await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    held.end().await;
    assert!(gcm.graph().components.contains_key(&id("host/a")), "another one's");
}

#[tokio::test]
async fn the_last_that_holds_it_is_its_holder_and_one_that_lets_go_leaves_it() {
    let (gcm, _lcm) = system().await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    let (mut first, second) = (hold(&gcm, "host/a"), hold(&gcm, "host/a"));
    comes("the first hold is over", first.over()).await;
    first.end().await;
    assert!(gcm.graph().components.contains_key(&id("host/a")));
    second.let_go();
    assert!(gcm.graph().components.contains_key(&id("host/a")));
    hold(&gcm, "host/a").end().await;
    assert!(gcm.graph().components.is_empty());
}

#[tokio::test]
async fn a_component_that_cannot_be_removed_at_once_is_removed_when_it_can_be() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    lcm.lose_at("Remove host/a");
    let ending = tokio::spawn(hold(&gcm, "host/a").end());
    comes("it is removed", ending).await.unwrap();
    assert!(gcm.graph().components.is_empty());
}

/// A GCM that was started again hears of its processes one by one, and the holder may be gone before that.
#[tokio::test]
async fn a_component_of_a_process_that_is_not_known_yet_is_removed_when_that_has_come() {
    let remote = || Registration::new(name("far"), "127.0.0.1:2".into());
    let (earlier, its) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("far"));
    register(&earlier, remote(), its.clone()).await.unwrap();
    ask(&earlier, vec![create("far/rec")]).await.unwrap();
    let components = earlier.graph().components.iter().map(|(id, c)| (id.clone(), c.clone())).collect();

    let (gcm, _lcm) = system().await;
    let ending = tokio::spawn(hold(&gcm, "far/rec").end());
    let back = Registration { slice: Slice { components, ..Slice::default() }, ..remote() };
    register(&gcm, back, its.clone()).await.unwrap();
    comes("it is removed", ending).await.unwrap();
    assert!(gcm.graph().components.is_empty());
    assert!(its.done().contains(&"Remove far/rec".to_owned()), "{:?}", its.done());
}

#[tokio::test]
async fn a_caller_whose_connection_broke_holds_again_and_nothing_was_removed() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    let ending = tokio::spawn(hold(&gcm, "host/a").end());
    tokio::task::yield_now().await;
    let again = hold(&gcm, "host/a");
    comes("the broken hold has ended", ending).await.unwrap();
    assert!(
        gcm.graph().components.contains_key(&id("host/a"))
            && !lcm.done().contains(&"Remove host/a".to_owned())
    );
    again.let_go();
}

#[tokio::test]
async fn one_hold_too_many_is_refused_and_one_that_ends_makes_room() {
    let (gcm, _lcm) = system().await;
    let mut all: Vec<_> = (0..1024).map(|n| hold(&gcm, &format!("host/c{n}"))).collect();
    let refused = gcm.hold(id("host/more"), String::new()).err().unwrap().to_string();
    assert!(refused.contains("1024 components are held"), "{refused}");
    let again = hold(&gcm, "host/c3");
    all.pop().unwrap().end().await;
    hold(&gcm, "host/more").let_go();
    again.let_go();
}
