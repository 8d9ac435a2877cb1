//! Care for a system that is up: mends processes that break, judges them, reports about them, and makes the
//! extra ones that the GCM wants.
//!
//! Invariant: all of it goes on for as long as the system is kept, and ends with it.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::pin::Pin;
use std::task::Poll;
use std::time::{Duration, Instant};

use super::System;
use super::mend::{self, Mender, Tools};
use super::news::Ears;
use super::standing::Standing;
use super::telling::Voice;
use super::useless::{self, Patience};
use crate::session::Session;
use trocar::processes::Unheard;
use trocar::system_file::SystemFile;

/// Pause before a question about a process that could not be answered is asked again.
const ASK_AGAIN: Duration = Duration::from_secs(1);

type Forever<'a> = Pin<Box<dyn Future<Output = Infallible> + 'a>>;

impl System {
    /// Mends what breaks and tells of it, for ever.
    pub(crate) async fn keep(&self, file: &SystemFile, voice: Option<&Voice>) -> Infallible {
        let Some(session) = &self.session else { return std::future::pending().await };
        let making = tokio::sync::Mutex::new(());
        let tools = Tools { file, session, voice, making: &making };
        tokio::select! {
            never = self.mend(&tools) => match never {},
            never = self.attend(session) => match never {},
            never = self.judge(session) => match never {},
            never = self.tell(voice) => match never {},
        }
    }

    /// Gives every process a mender that makes it whole again.
    async fn mend(&self, tools: &Tools<'_>) -> Infallible {
        let (statuses, mut isolated) = (self.supervisor.statuses(), self.isolated.subscribe());
        let mut menders: BTreeMap<String, Forever<'_>> = BTreeMap::new();
        loop {
            isolated.mark_unchanged();
            let (names, now) = (self.names(), statuses.borrow().clone());
            menders.retain(|name, _| names.contains(name));
            for name in names {
                menders.entry(name.clone()).or_insert_with(|| {
                    let status = now.get(&name).cloned().unwrap_or_default();
                    let mender = Mender::new(&name, &status, &self.standing.borrow());
                    Box::pin(mend::keep_whole(mender, statuses.clone(), self.standing.clone(), tools))
                });
            }
            tokio::select! {
                never = all(&mut menders) => match never {},
                // `self` holds the sender.
                _ = isolated.changed() => {}
            }
        }
    }

    /// Puts down processes that live and are of no use, for ever.
    async fn judge(&self, session: &Session) -> Infallible {
        let (mut statuses, mut standing) = (self.supervisor.statuses(), self.standing.clone());
        let mut patience = Patience::default();
        loop {
            let (now, stands) = (statuses.borrow_and_update().clone(), standing.borrow_and_update().clone());
            let all: BTreeMap<String, Unheard> = {
                let isolated = self.isolated.borrow();
                let all = self.hosts.iter().chain(isolated.values());
                all.map(|h| (h.name().to_owned(), h.policy().unheard())).collect()
            };
            // A network that was cut a moment ago is no fault of a process.
            let is_judged = |name: &String, policy: Unheard| {
                policy.limit(false).is_none_or(|limit| self.supervisor.is_heard_for(name, limit))
            };
            let (policies, later): (BTreeMap<_, _>, BTreeMap<_, _>) =
                all.into_iter().partition(|(name, policy)| is_judged(name, *policy));
            let (over, mut next) = patience.look(&now, &stands, &policies, Instant::now());
            if !later.is_empty() {
                next = next.into_iter().chain([Instant::now() + ASK_AGAIN]).min();
            }
            if !over.is_empty() {
                // The state heard last may be old: a GCM that stands still says nothing new.
                let fresh = session.standing().await.map(|listed| Standing::of(stands.term, listed));
                for useless in over {
                    if fresh.as_ref().is_ok_and(|fresh| useless::is_so(fresh, &useless)) {
                        self.supervisor.put_down(&useless.process, useless.pid, useless.why);
                    }
                }
                next = Some(Instant::now() + ASK_AGAIN);
            }
            tokio::select! {
                _ = statuses.changed() => {}
                _ = standing.changed() => {}
                () = until(next) => {}
            }
        }
    }

    /// Tells people what happens, for ever.
    async fn tell(&self, voice: Option<&Voice>) -> Infallible {
        let Some(voice) = voice else { return std::future::pending().await };
        let (mut statuses, mut standing) = (self.supervisor.statuses(), self.standing.clone());
        let mut before = statuses.borrow_and_update().clone();
        let mut ears = Ears::of(&standing.borrow());
        loop {
            let (news, next) = ears.look(&standing.borrow_and_update(), Instant::now());
            voice.tell_of(&news);
            tokio::select! {
                _ = statuses.changed() => {}
                _ = standing.changed() => {}
                () = until(next) => {}
            }
            let now = statuses.borrow_and_update().clone();
            voice.tell(&before, &now);
            before = now;
        }
    }
}

/// Runs all menders side by side.
async fn all(menders: &mut BTreeMap<String, Forever<'_>>) -> Infallible {
    std::future::poll_fn(|cx| {
        for mender in menders.values_mut() {
            if let Poll::Ready(never) = mender.as_mut().poll(cx) {
                match never {}
            }
        }
        Poll::Pending
    })
    .await
}

/// Sleeps until then, or for ever when there is nothing to wait for.
async fn until(next: Option<Instant>) {
    match next {
        Some(at) => tokio::time::sleep_until(at.into()).await,
        None => std::future::pending().await,
    }
}
