//! One component hangs: requests that go on all the same, and requests that wait for their turn.

use trocar_model::{ConnectOptions, Health, PortId};

use super::*;

fn remove(path: &str) -> Request {
    Request::Remove { id: id(path), force: true }
}

fn connect(client: &str, server: &str) -> Request {
    let port = |path: &str| PortId::parse(path).unwrap();
    Request::Connect { client: port(client), server: port(server), options: ConnectOptions::default() }
}

type Asking = tokio::task::JoinHandle<Result<super::super::Executed, Refusal>>;

/// Asks and waits until the change hangs.
async fn hanging(gcm: &Gcm, lcm: &FakeLcm, requests: Vec<Request>, change: &str) -> Asking {
    lcm.hold(change);
    let asked = tokio::spawn({
        let gcm = gcm.clone();
        async move { gcm.execute(requests, within(60_000)).await }
    });
    comes(&format!("{change} is asked"), lcm.hangs(change)).await;
    asked
}

#[tokio::test]
async fn others_are_changed_while_one_hangs_and_every_change_is_a_revision() {
    let (gcm, lcm) = system().await;
    ask(&gcm, ["host/a", "host/b", "host/c"].map(create).to_vec()).await.unwrap();
    let hung = hanging(&gcm, &lcm, vec![start("host/a")], "Start host/a").await;
    let before = gcm.graph().revision;
    ask(&gcm, vec![create("host/d")]).await.unwrap();
    ask(&gcm, vec![connect("host/c/robot", "host/b/arm")]).await.unwrap();
    ask(&gcm, vec![start("host/b")]).await.unwrap();
    ask(&gcm, vec![stop("host/b")]).await.unwrap();
    let last = ask(&gcm, vec![remove("host/b")]).await.unwrap();
    assert_eq!(last.revision, before + 5);
    lcm.release("Start host/a");
    assert_eq!(hung.await.unwrap().unwrap().revision, before + 6);
}

#[tokio::test]
async fn what_names_a_component_of_a_request_under_way_waits_in_the_order_of_arrival() {
    let (gcm, lcm) = system().await;
    let hung = hanging(&gcm, &lcm, vec![create("host/a")], "Create host/a").await;
    // Not there yet, and still not refused for that.
    let mut starting = std::pin::pin!(ask(&gcm, vec![start("host/a")]));
    begun(starting.as_mut()).await;
    let mut again = std::pin::pin!(ask(&gcm, vec![create("host/a")]));
    begun(again.as_mut()).await;
    lcm.release("Create host/a");
    hung.await.unwrap().unwrap();
    let (started, again) = tokio::join!(starting, again);
    started.unwrap();
    assert_eq!(again.unwrap_err().reason(), "COMPONENT_EXISTS");
    assert_eq!(lcm.state("host/a"), Some(State::Active));
}

#[tokio::test]
async fn connections_are_made_one_after_the_other_so_that_no_two_close_a_circle_or_share_a_number() {
    let (gcm, lcm) = system().await;
    ask(&gcm, ["host/a", "host/b", "host/c", "host/d"].map(create).to_vec()).await.unwrap();
    let first = "Connect host/a/robot to host/b/arm";
    let hung = hanging(&gcm, &lcm, vec![connect("host/a/robot", "host/b/arm")], first).await;
    let mut other = std::pin::pin!(ask(&gcm, vec![connect("host/c/robot", "host/d/arm")]));
    begun(other.as_mut()).await;
    lcm.release(first);
    hung.await.unwrap().unwrap();
    other.await.unwrap();
    let numbers: Vec<u64> = gcm.graph().connections.keys().map(|c| c.0).collect();
    assert_eq!(numbers, [1, 2]);
}

#[tokio::test]
async fn a_forced_remove_and_a_stop_give_up_what_hangs_and_wait_for_what_is_only_slow() {
    for verb in [remove("host/a"), stop("host/a")] {
        let (gcm, lcm) = system().await;
        ask(&gcm, vec![create("host/a"), create("host/b")]).await.unwrap();
        let hung = hanging(&gcm, &lcm, vec![start("host/b"), start("host/a")], "Start host/a").await;
        let mut asked = std::pin::pin!(ask(&gcm, vec![verb.clone()]));
        begun(asked.as_mut()).await;
        assert!(!hung.is_finished(), "it may only be slow: {verb:?}");
        lcm.become_health("host/a", State::Ready, Health::Unresponsive);
        let refusal = hung.await.unwrap().unwrap_err();
        assert_eq!(refusal.reason(), "WRONG_STATE", "{refusal}");
        assert!(refusal.to_string().contains("while this Start was being carried out"), "{refusal}");
        match (asked.await, &verb) {
            // Its process has not said what became of the start.
            (Err(refusal), Request::Stop { .. }) => {
                assert_eq!(refusal.reason(), "STOP_NOT_TOLD", "{refusal}")
            }
            (removed, _) => _ = removed.unwrap(),
        }
        assert_ne!(lcm.state("host/b"), Some(State::Active), "all or nothing: {:?}", lcm.done());
        let left = gcm.graph().components.contains_key(&id("host/a"));
        assert_eq!(left, matches!(verb, Request::Stop { .. }), "{:?}", lcm.done());
    }
}

#[tokio::test]
async fn a_forced_remove_of_what_is_only_just_being_made_says_that_it_is_not_there() {
    let (gcm, lcm) = system().await;
    let hung = hanging(&gcm, &lcm, vec![create("host/a")], "Create host/a").await;
    let refusal = ask(&gcm, vec![remove("host/a")]).await.unwrap_err();
    assert_eq!(refusal.reason(), "COMPONENT_NOT_FOUND");
    lcm.release("Create host/a");
    hung.await.unwrap().unwrap();
}

#[tokio::test]
async fn a_forced_remove_of_what_its_maker_takes_back_is_done_with_it() {
    let (gcm, lcm) = system().await;
    let hung = hanging(&gcm, &lcm, vec![create("host/a"), start("host/a")], "Start host/a").await;
    lcm.become_health("host/a", State::Ready, Health::Unresponsive);
    ask(&gcm, vec![remove("host/a")]).await.unwrap();
    hung.await.unwrap().unwrap_err();
    assert_eq!((gcm.graph().components.len(), lcm.state("host/a")), (0, None));
}

#[tokio::test]
async fn of_two_that_expect_one_revision_one_passes_whatever_they_touch() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), create("host/b")]).await.unwrap();
    let expecting = |path: &str| {
        let (gcm, request) = (gcm.clone(), vec![start(path)]);
        let expected_revision = Some(gcm.graph().revision);
        async move { gcm.execute(request, ExecuteOptions { expected_revision, ..within(5000) }).await }
    };
    lcm.hold("Start host/a");
    let first = tokio::spawn(expecting("host/a"));
    lcm.hangs("Start host/a").await;
    let mut other = std::pin::pin!(expecting("host/b"));
    begun(other.as_mut()).await;
    lcm.release("Start host/a");
    first.await.unwrap().unwrap();
    assert_eq!(other.await.unwrap_err().reason(), "REVISION_CONFLICT");
    // One that was refused leaves the revision to others.
    lcm.refuse("Start host/b");
    let refused = tokio::join!(expecting("host/b"), expecting("host/b"));
    assert_eq!(
        (refused.0.unwrap_err().reason(), refused.1.unwrap_err().reason()),
        ("COMPONENT_REFUSED", "COMPONENT_REFUSED")
    );
}
