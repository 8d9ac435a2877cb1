//! A GCM among several: what it decides counts only when it is on record, and only while it leads.

use std::time::Duration;

use trocar_lcm_api::clock;

use super::super::{Lead, Standing, StartError, Unusable};
use super::kept::Kept;
use super::*;

const LONG: Duration = Duration::from_secs(60);

async fn leading(store: &Kept, lead: &Lead) -> Result<Gcm, StartError> {
    let config = GcmConfig { lead: Some(lead.clone()), ..GcmConfig::default() };
    Gcm::resume(config, Box::new(store.clone())).await
}

/// A GCM that leads in that term, with a component `host/a` that runs.
async fn running(store: &Kept, term: u64) -> (Gcm, Lead, Arc<FakeLcm>) {
    let lead = Lead::new(term, clock::now() + LONG);
    let gcm = leading(store, &lead).await.unwrap();
    let lcm = FakeLcm::new("host");
    register(&gcm, Registration::new(name("host"), String::new()), lcm.clone()).await.unwrap();
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    (gcm, lead, lcm)
}

async fn is_behind(gcm: &Gcm) {
    let mut standing = gcm.journal();
    let behind = standing.wait_for(|standing| matches!(standing, Standing::Behind { .. }));
    comes("the journal is behind", behind).await.unwrap();
}

#[tokio::test]
async fn its_term_is_that_of_its_lead_and_its_epochs_are_its_own() {
    let store = Kept::default();
    let (first, lead, _) = running(&store, 7).await;
    assert_eq!(first.term(), 7);
    let epoch = first.graph().processes[&name("host")].epoch;
    lead.lose("another leads");
    drop(first);
    let lead = Lead::new(8, clock::now() + LONG);
    let second = leading(&store, &lead).await.unwrap();
    let who = Registration::new(name("other"), String::new());
    let other = register(&second, who, FakeLcm::new("other")).await.unwrap();
    assert!(second.term() == 8 && other.epoch > epoch + 1000, "{} after {epoch}", other.epoch);
    // A count of terms that was set back would give numbers twice.
    drop(second);
    let early = Lead::new(8, clock::now() + LONG);
    let refused = leading(&store, &early).await.err().unwrap();
    assert!(matches!(&refused, StartError::Store(e) if e.unusable == Unusable::Damaged), "{refused}");
    assert!(early.holds().is_err(), "another may have the lead");
}

#[tokio::test]
async fn it_begins_with_what_is_on_record_or_not_at_all() {
    let store = Kept::default();
    store.fail(Some(Unusable::Now));
    let refused = leading(&store, &Lead::new(1, clock::now() + LONG)).await.err().unwrap();
    assert!(matches!(&refused, StartError::Store(e) if e.unusable == Unusable::Now), "{refused}");
}

#[tokio::test]
async fn a_change_is_answered_when_it_is_on_record_and_others_are_refused_meanwhile() {
    let store = Kept::default();
    let (gcm, _lead, lcm) = running(&store, 1).await;
    let on_record = gcm.revision_on_record();
    store.fail(Some(Unusable::Now));
    let asking = {
        let gcm = gcm.clone();
        tokio::spawn(async move { ask(&gcm, vec![create("host/b")]).await })
    };
    is_behind(&gcm).await;
    assert!(!asking.is_finished(), "it is not on record");
    assert_eq!(gcm.revision_on_record(), on_record, "no process is told what is not on record");
    let done = lcm.done();
    match ask(&gcm, vec![create("host/c")]).await.unwrap_err() {
        Refusal::JournalUnavailable { carried_out: false, .. } => {}
        other => panic!("{other:?}"),
    }
    assert_eq!(lcm.done(), done, "what is refused is not begun");
    let stopped = ask(&gcm, vec![stop("host/a")]).await.unwrap();
    assert!(stopped.left.iter().any(|left| left.contains("not on record yet")), "{:?}", stopped.left);
    assert!(matches!(lcm.state("host/a"), Some(State::Stopped(_))), "a Stop acts all the same");
    store.fail(None);
    asking.await.unwrap().unwrap();
    ask(&gcm, vec![create("host/c")]).await.unwrap();
    assert_eq!(store.wanted(), *gcm.inner.ledger.wanted());
}

#[tokio::test]
async fn a_change_that_is_not_on_record_when_the_lead_is_lost_is_not_answered_as_done() {
    let store = Kept::default();
    let (gcm, lead, _) = running(&store, 1).await;
    store.fail(Some(Unusable::Now));
    let asking = {
        let gcm = gcm.clone();
        tokio::spawn(async move { ask(&gcm, vec![create("host/b")]).await })
    };
    is_behind(&gcm).await;
    lead.lose("etcd has ended its lease");
    match asking.await.unwrap().unwrap_err() {
        Refusal::JournalUnavailable { carried_out: true, why } => assert_eq!(why, "etcd has ended its lease"),
        other => panic!("{other:?}"),
    }
    let refused = ask(&gcm, vec![create("host/c")]).await.unwrap_err();
    assert_eq!(refused.reason(), "NOT_LEADER", "{refused}");
    let who = Registration::new(name("late"), String::new());
    register(&gcm, who, FakeLcm::new("late")).await.unwrap_err();
    assert!(!gcm.graph().processes.contains_key(&name("late")));
}

#[tokio::test]
async fn a_lead_that_was_not_confirmed_decides_nothing_until_it_is() {
    let store = Kept::default();
    let lead = Lead::new(1, clock::now() + LONG);
    let gcm = leading(&store, &lead).await.unwrap();
    let lcm = FakeLcm::new("host");
    register(&gcm, Registration::new(name("host"), String::new()), lcm).await.unwrap();
    drop(gcm);
    let doubted = Lead::new(2, clock::now());
    let gcm = leading(&store, &doubted).await.unwrap();
    register(&gcm, Registration::new(name("other"), String::new()), FakeLcm::new("other")).await.unwrap();
    let refused = ask(&gcm, vec![create("other/a")]).await.unwrap_err();
    assert!(refused.reason() == "NOT_LEADER" && gcm.is_doubted(), "{refused}");
    doubted.confirm(clock::now() + LONG);
    ask(&gcm, vec![create("other/a")]).await.unwrap();
    assert!(!gcm.is_doubted());
}
