//! Questions of the GCM, which change nothing but what components do when they are called: answered by the
//! LCM of this process, over whichever stream they came by.
//!
//! Invariant: each question runs in its own task, so that none delays another; every one is answered, if only
//! with a refusal. What is followed ends with its stream.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::task::{AbortHandle, JoinSet};
use trocar_model::{ComponentId, MemberId, Refusal};
use trocar_proto::v1;
use trocar_proto::v1::answer::Answer as A;
use trocar_proto::v1::order::Order as O;

use crate::control::convert;
use crate::lcm::{Invoke, Lcm};

/// Longest time an order may take.
pub(super) const MOST: Duration = Duration::from_secs(60);

/// The questions of one stream.
pub(super) struct Questions {
    lcm: Arc<dyn Lcm>,
    answers: mpsc::Sender<v1::Answer>,
    followed: HashMap<u64, AbortHandle>,
    running: JoinSet<()>,
}

impl Questions {
    pub(super) fn new(lcm: Arc<dyn Lcm>, answers: mpsc::Sender<v1::Answer>) -> Questions {
        Questions { lcm, answers, followed: HashMap::new(), running: JoinSet::new() }
    }

    /// Begins to answer; the answers follow.
    pub(super) async fn answer(&mut self, id: u64, question: Option<O>, deadline: Instant) {
        // Feeds that ended by themselves are forgotten.
        while self.running.try_join_next().is_some() {}
        self.followed.retain(|_, feed| !feed.is_finished());
        let (lcm, answers) = (self.lcm.clone(), self.answers.clone());
        match question {
            Some(O::Subscribe(request)) => {
                let feed = self.running.spawn(follow(lcm, id, request, answers));
                self.followed.insert(id, feed);
            }
            Some(O::Unsubscribe(feed)) => {
                if let Some(feed) = self.followed.remove(&feed) {
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

pub(super) async fn give(answers: &mpsc::Sender<v1::Answer>, id: u64, answer: Result<A, Refusal>) {
    let answer = answer.unwrap_or_else(|refusal| A::Refused(convert::refusal_info(&refusal)));
    // A session that has ended needs no answers.
    let _ = answers.send(v1::Answer { id, answer: Some(answer) }).await;
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
        O::Details(order) => {
            let ids = order.paths.iter().map(|path| ComponentId::parse(path)).collect::<Result<_, _>>()?;
            A::Details(convert::details(lcm.details(ids).await?))
        }
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
        O::Apply(_) | O::Link(_) | O::Stop(_) | O::Subscribe(_) | O::Unsubscribe(_) => return Err(unknown()),
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
