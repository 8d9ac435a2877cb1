//! Orders of the GCM, carried out by the LCM of this process.
//!
//! Invariant: each order runs in its own task, so that none delays a Stop; every order is answered, if only
//! with a refusal.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use tokio::sync::{RwLock, mpsc};
use tokio::task::{AbortHandle, JoinSet};
use trocar_model::{Change, ComponentId, MemberId, Plan, Refusal, SystemGraph};
use trocar_proto::v1;
use trocar_proto::v1::answer::Answer as A;
use trocar_proto::v1::order::Order as O;

use crate::control::convert;
use crate::gcm::observe;
use crate::lcm::{Invoke, Lcm};

/// Longest time an order may take.
const MOST: Duration = Duration::from_secs(60);

/// Everything this process was ordered to have, as far as the orders are carried out.
pub(super) type Told = Arc<Mutex<SystemGraph>>;

pub(super) struct Orders {
    lcm: Arc<dyn Lcm>,
    told: Told,
    quiet: Arc<RwLock<()>>,
    answers: mpsc::Sender<v1::Answer>,
    feeds: HashMap<u64, AbortHandle>,
    /// Feeds end with the session.
    running: JoinSet<()>,
}

impl Orders {
    pub(super) fn new(
        lcm: Arc<dyn Lcm>,
        told: Told,
        quiet: Arc<RwLock<()>>,
        answers: mpsc::Sender<v1::Answer>,
    ) -> Orders {
        Orders { lcm, told, quiet, answers, feeds: HashMap::new(), running: JoinSet::new() }
    }

    /// Begins it; the answer follows.
    pub(super) async fn carry_out(&mut self, order: v1::Order) {
        // Feeds that ended by themselves.
        while self.running.try_join_next().is_some() {}
        self.feeds.retain(|_, feed| !feed.is_finished());
        let deadline = Instant::now() + Duration::from_nanos(order.deadline_ns).min(MOST);
        let (id, lcm, answers) = (order.id, self.lcm.clone(), self.answers.clone());
        match order.order {
            Some(O::Apply(change)) => {
                let (told, busy) = (self.told.clone(), self.quiet.clone().read_owned().await);
                // The task is not the session's: an order that has begun is finished without the session.
                tokio::spawn(async move {
                    let answer = apply(&lcm, &told, change, deadline).await;
                    drop(busy);
                    give(&answers, id, answer.map(A::Report)).await;
                });
            }
            Some(O::Link(end)) => {
                let (told, busy) = (self.told.clone(), self.quiet.clone().read_owned().await);
                tokio::spawn(async move {
                    let answer = link(&lcm, &told, end, deadline).await;
                    drop(busy);
                    give(&answers, id, answer.map(A::Report)).await;
                });
            }
            Some(O::Subscribe(request)) => {
                let feed = self.running.spawn(follow(lcm, id, request, answers));
                self.feeds.insert(id, feed);
            }
            Some(O::Unsubscribe(feed)) => {
                if let Some(feed) = self.feeds.remove(&feed) {
                    feed.abort();
                }
            }
            Some(other) => {
                tokio::spawn(async move {
                    let answer = ask(&lcm, other, deadline).await;
                    give(&answers, id, answer).await;
                });
            }
            None => give(&answers, id, Err(unknown())).await,
        }
    }
}

fn unknown() -> Refusal {
    Refusal::NotImplemented {
        what: "this order".into(),
        hint: "Run the same version of trocar in every process.".into(),
    }
}

async fn give(answers: &mpsc::Sender<v1::Answer>, id: u64, answer: Result<A, Refusal>) {
    let answer = answer.unwrap_or_else(|refusal| A::Refused(convert::refusal_info(&refusal)));
    // A session that has ended needs no answers.
    let _ = answers.send(v1::Answer { id, answer: Some(answer) }).await;
}

/// Makes a change, then remembers the order for it.
async fn apply(
    lcm: &Arc<dyn Lcm>,
    told: &Told,
    change: v1::Change,
    deadline: Instant,
) -> Result<v1::ComponentReport, Refusal> {
    let change = convert::change_in(change)?;
    let report = lcm.apply(change.clone(), deadline).await?;
    let mut told = told.lock();
    told.apply(&Plan { changes: vec![change], skipped: Vec::new() });
    observe(&mut told, &report);
    Ok(convert::report(&report))
}

/// Does the same as [`apply`], for a connection to another process.
async fn link(
    lcm: &Arc<dyn Lcm>,
    told: &Told,
    end: v1::LinkOrder,
    deadline: Instant,
) -> Result<v1::ComponentReport, Refusal> {
    let end = convert::remote_in(end)?;
    let connection = end.connection.clone();
    let report = lcm.link(end, deadline).await?;
    let mut told = told.lock();
    told.apply(&Plan { changes: vec![Change::Connect { connection }], skipped: Vec::new() });
    observe(&mut told, &report);
    Ok(convert::report(&report))
}

async fn ask(lcm: &Arc<dyn Lcm>, order: O, deadline: Instant) -> Result<A, Refusal> {
    Ok(match order {
        O::Invoke(r) => {
            let call = Invoke {
                member: MemberId::parse(&r.path)?,
                arg: convert::payload(r.json, r.encoded),
                send: r.send,
                deadline_ns: r.deadline.as_ref().and_then(convert::duration_ns).unwrap_or(1_000_000_000),
            };
            A::Reply(convert::reply(lcm.invoke(call).await?))
        }
        O::Read(r) => {
            A::Sample(convert::sample(lcm.read(r.path, convert::when(r.row), r.frame, deadline).await?))
        }
        O::Detail(path) => A::Detail(convert::stats(&lcm.detail(ComponentId::parse(&path)?).await?)),
        O::Links(_) => {
            A::Links(v1::Links { links: lcm.links().await?.into_iter().map(convert::link).collect() })
        }
        O::Plugins(_) => A::Plugins(v1::Plugins {
            plugins: lcm.plugins().await?.into_iter().map(convert::plugin).collect(),
        }),
        O::Recheck(order) => A::Plugins(v1::Plugins {
            plugins: lcm.recheck(&order.name, deadline).await?.into_iter().map(convert::plugin).collect(),
        }),
        O::Phases(order) => {
            let given = convert::phases_in(order)?;
            A::Steps(convert::steps_out(lcm.phases(given, deadline).await?))
        }
        O::Inventory(_) => A::Inventory(convert::inventory_out(&lcm.inventory().await?)),
        O::Apply(_) | O::Link(_) | O::Subscribe(_) | O::Unsubscribe(_) => return Err(unknown()),
    })
}

async fn follow(
    lcm: Arc<dyn Lcm>,
    id: u64,
    request: v1::SubscribeRequest,
    answers: mpsc::Sender<v1::Answer>,
) {
    let selections: Result<Vec<_>, _> = request.selections.into_iter().map(convert::selection).collect();
    let followed = match selections {
        Ok(selections) => lcm.subscribe(selections).await,
        Err(refusal) => Err(refusal),
    };
    let mut items = match followed {
        Ok(items) => items,
        Err(refusal) => return give(&answers, id, Err(refusal)).await,
    };
    give(&answers, id, Ok(A::Subscribed(v1::Subscribed {}))).await;
    // While the stream is full the LCM drops items and counts them.
    while let Some(item) = items.recv().await {
        give(&answers, id, Ok(A::Item(convert::item(item)))).await;
    }
    give(&answers, id, Ok(A::Ended(v1::Ended {}))).await;
}
