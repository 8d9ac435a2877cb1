//! Outcomes for callers that wait for a component that is taken away: stopped it is not ACTIVE, removed it is
//! gone.

use trocar_model::StopReason;

use super::standing::Held;
use super::*;

/// Refusals of a waiting and a later caller, while the component's step lasts.
async fn turned_away(process: &'static str, verb: Verb) -> [Refusal; 2] {
    let world = World::new(process);
    let (held, open) = Held::at("step", "");
    world.create_as("c", class(ctl(), Safety::None), periodic(1000), held.clone()).await;
    world.start("c").await;
    let instance = world.lcm.instance(&world.id("c")).unwrap();
    held.is_inside().await;
    let queued = || instance.queues().iter().any(|inbox| !inbox.mailbox.is_empty());
    let (waiting, ()) = tokio::join!(world.call("c"), async {
        eventually("somebody waits", queued).await;
        let to = State::Stopped(StopReason::Requested);
        let change = Change::Run { id: world.id("c"), verb, from: State::Active, to };
        world.lcm.apply(change, (Instant::now() + Duration::from_millis(20)).into()).await.unwrap_err();
    });
    let later = world.call("c").await;
    open.send(()).unwrap();
    world.end().await;
    [waiting.unwrap_err(), later.unwrap_err()]
}

#[tokio::test(flavor = "multi_thread")]
async fn callers_of_one_that_is_removed_get_peer_lost() {
    for refusal in turned_away("go_removed", Verb::Remove).await {
        assert!(matches!(refusal, Refusal::PeerLost { .. }), "{refusal}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn callers_of_one_that_is_stopped_get_not_active() {
    for refusal in turned_away("go_stopped", Verb::Stop).await {
        assert!(matches!(refusal, Refusal::NotActive { .. }), "{refusal}");
    }
}
