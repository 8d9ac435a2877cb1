//! Components that hang, and what is made of them when they are to stop or go.
//!
//! Invariant: as of a true LCM. One that hangs is given up by the deadline of its order, and comes back by
//! itself; one that is stopped meanwhile fails, and one that is removed is left behind.

use super::*;

/// One of so many changes hangs.
const HANGS: usize = 500;
/// Time after which a component that hangs is not waited for when it is to stop.
const HUNG: Duration = Duration::from_secs(1);

impl ModelLcm {
    pub(super) fn hangs_now(&self, id: &ComponentId) -> bool {
        self.has.lock().components.get(id).is_some_and(|c| c.health == Health::Unresponsive)
    }

    /// Takes the time that the work on a component takes, in its turn; or it hangs, and comes back later.
    ///
    /// # Errors
    /// As [`ModelLcm::works`].
    pub(super) async fn works_in(
        &self,
        id: &ComponentId,
        turn: OwnedMutexGuard<()>,
        order: &Order,
    ) -> Result<OwnedMutexGuard<()>, Refusal> {
        if !self.chance.once_in(HANGS) {
            return self.works(order).await.map(|()| turn);
        }
        self.truth.event(Kind::Fails, || format!("{id} hangs"));
        self.truth.counts("a component hangs".into());
        self.healthy(id, Health::Unresponsive);
        let (me, hung, long) = (self.me.clone(), id.clone(), self.chance.ms(500, 15_000));
        let back = tokio::spawn(async move {
            tokio::time::sleep(long).await;
            // One that was removed meanwhile has left its turn behind.
            let Some(me) = me.upgrade() else { return };
            let current = me.has.lock().turns.get(&hung).cloned();
            if current.is_some_and(|current| Arc::ptr_eq(&current, OwnedMutexGuard::mutex(&turn))) {
                me.healthy(&hung, Health::Ok);
            }
        });
        let mut alive = self.alive.subscribe();
        tokio::select! {
            biased;
            _ = alive.wait_for(|alive| !alive) => Err(self.lost()),
            () = order.lease.ended() => Err(self.lost()),
            _ = back => Err(self.refused(id.clone(), "start")),
            () = tokio::time::sleep_until(order.deadline.into()) => Err(self.late("it")),
        }
    }

    fn healthy(&self, id: &ComponentId, health: Health) {
        let mut has = self.has.lock();
        let Some(component) = has.components.get_mut(id) else { return };
        component.health = health;
        if let Ok(report) = has.report(id) {
            drop(has);
            self.tell(report);
        }
    }

    /// Stopping takes its time, and no longer than its order.
    pub(super) async fn takes_time(&self, deadline: Instant) {
        let takes = self.chance.takes();
        if !takes.is_zero() {
            let _ = tokio::time::timeout_at(deadline.into(), tokio::time::sleep(takes)).await;
        }
    }

    /// Waits for what runs through a component that is stopped. One that hangs fails.
    pub(super) async fn rests(
        &self,
        id: &ComponentId,
        decision: Decision,
        deadline: Instant,
    ) -> Result<Report, Refusal> {
        let hung = self.hangs_now(id);
        let until = if hung { deadline.min(clock::now() + HUNG) } else { deadline };
        match self.turn(id, until).await {
            Ok(_turn) => {
                self.takes_time(deadline).await;
                self.halt(id, decision)
            }
            Err(late) => {
                if hung && self.hangs_now(id) {
                    let report = self.becomes(id, State::Fault, "stop: it did not come back")?;
                    self.tell(report);
                }
                Err(late)
            }
        }
    }
}
