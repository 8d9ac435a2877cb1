//! What was done and never decided when its GCM ended: nobody was told of it, and nothing of it stays.

use super::super::Standing;
use super::journal::{Process, all_run, gcm_with};
use super::kept::Kept;
use super::*;

#[tokio::test]
async fn a_refusal_is_told_when_what_it_rests_on_is_on_record() {
    let store = Kept::default();
    let gcm = gcm_with(&store).await;
    Process::come(&gcm, "host").await;
    gcm.flush().await;
    let (release, hangs) = std::sync::mpsc::channel::<()>();
    store.0.lock().hangs = Some(hangs);
    let (first, second) = (gcm.clone(), gcm.clone());
    let made = tokio::spawn(async move { ask(&first, vec![create("host/a")]).await });
    until(&gcm, "it is made", |graph| graph.components.len() == 1).await;
    let refused = tokio::spawn(async move { ask(&second, vec![create("host/a")]).await });
    all_run().await;
    assert!(!made.is_finished() && !refused.is_finished(), "the next GCM would know of neither");
    drop(release);
    assert_eq!(refused.await.unwrap().unwrap_err().reason(), "COMPONENT_EXISTS");
    assert_eq!(store.wanted().components.len(), 1, "it is on record when that was told");
    made.await.unwrap().unwrap();
    // One that rests on nothing new waits for nothing.
    let (_release, hangs) = std::sync::mpsc::channel::<()>();
    gcm.flush().await;
    store.0.lock().hangs = Some(hangs);
    assert_eq!(ask(&gcm, vec![create("host/a")]).await.unwrap_err().reason(), "COMPONENT_EXISTS");
    assert_eq!(*gcm.journal().borrow(), Standing::Written);
}
