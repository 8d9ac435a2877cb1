//! One stream to the GCM, from Hello until one side is silent or gone.
//!
//! Invariant: news that came before an answer is sent before it, so the GCM never sees an older state after a
//! newer one; no order begins after the GCM has given this session up.

use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;
use tokio::sync::{RwLock, broadcast, mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::MissedTickBehavior;
use tokio_stream::StreamExt;
use trocar_lcm_api::clock;
use trocar_model::Warnings;
use trocar_proto::v1::{self, attach_request, attach_response, news};

use super::feed::feed;
use super::lateness::Lateness;
use super::orders::{Orders, Told};
use super::way::{Inbound, Line, Refused};
use crate::control::attach::{BEAT, LEASE};
use crate::control::convert;
use crate::gcm::Registration;
use crate::lcm::{Inventory, Lcm, Lease, News};

/// Messages that may wait to be sent.
pub(super) const QUEUE: usize = 256;

type Outgoing = mpsc::Sender<v1::AttachRequest>;

pub(super) struct Session {
    inbound: Inbound,
    out: Outgoing,
    orders: Orders,
    /// Orders that came before Registered, with their stamps.
    early: Vec<(v1::Order, u64)>,
    tasks: JoinSet<()>,
    lateness: Arc<Mutex<Lateness>>,
    /// When the GCM was heard last; what it ordered is taken back when this is dropped.
    heard: watch::Sender<Instant>,
    /// True: the GCM is in doubt whether it leads.
    pub(super) doubted: watch::Sender<bool>,
    /// The GCM's number for this incarnation of the process.
    pub(super) epoch: u64,
    /// Last revision that was told.
    pub(super) revision: u64,
}

impl Session {
    pub(super) async fn open(
        line: impl Line,
        who: Registration,
        lcm: Arc<dyn Lcm>,
        (told, quiet): (Told, Arc<RwLock<()>>),
        lateness: Arc<Mutex<Lateness>>,
    ) -> Result<Session, Refused> {
        // Subscribes before the inventory is taken, so that no news falls between.
        let news = lcm.news();
        let inventory = lcm.inventory().await.map_err(|refusal| Refused::Unheard(refusal.to_string()))?;
        let feeder = line.feeder();
        let hello = hello(&who, &inventory, feeder.is_some());
        let (out, outgoing) = mpsc::channel(QUEUE);
        let unheard = |why: &str| Refused::Unheard(why.to_owned());
        let first = message(attach_request::Message::Hello(hello));
        out.send(first).await.map_err(|_| unheard("the stream closed at once"))?;
        let mut inbound = line.attach(outgoing).await?;
        let mut early = Vec::new();
        let v1::Registered { epoch, revision, .. } = loop {
            let said = inbound.next().await.transpose().map_err(|e| unheard(e.message()))?;
            let sent_ns = said.as_ref().map_or(0, |said| said.sent_ns);
            match said.and_then(|said| said.message) {
                Some(attach_response::Message::Registered(r)) => {
                    // By this those are judged that lay here before.
                    lateness.lock().begin(r.term, sent_ns);
                    break r;
                }
                Some(attach_response::Message::Refused(info)) => {
                    return Err(Refused::ByGcm(convert::refusal(&info)));
                }
                Some(attach_response::Message::Order(order)) => early.push((order, sent_ns)),
                Some(attach_response::Message::Heartbeat(_)) => {}
                None => return Err(unheard("the stream ended before the process was registered")),
            }
        };
        let (answer, answers) = mpsc::channel(QUEUE);
        let mut tasks = JoinSet::new();
        if let Some(feeder) = feeder {
            let (process, instance) = (who.process.to_string(), who.instance.to_be_bytes().to_vec());
            let hello = v1::FeedHello { process, instance, epoch };
            tasks.spawn(feed(feeder, hello, lcm.clone()));
        }
        tasks.spawn(pump(lcm.clone(), news, answers, out.clone()));
        let (heard, lease) = watch::channel(clock::now());
        // By then the beats that were missed have ended the session, too.
        let lease = Lease::new(lease, BEAT * (LEASE + 1));
        let orders = Orders::new(lcm, told, quiet, answer, lease);
        let revision = who.revision.max(revision);
        let doubted = watch::Sender::new(false);
        Ok(Session { inbound, out, orders, early, tasks, lateness, heard, doubted, epoch, revision })
    }

    /// Carries out the GCM's orders until the GCM is lost; returns the reason.
    pub(super) async fn serve(&mut self) -> String {
        for (order, sent_ns) in std::mem::take(&mut self.early) {
            let lateness = self.lateness.lock().of(sent_ns);
            self.orders.carry_out(order, lateness).await;
        }
        let mut beat = tokio::time::interval(BEAT);
        beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let (mut silent, mut sequence, mut awake) = (0, 0, clock::now());
        // A process that stood still longer than its lease is lost for the GCM, and its orders are too late:
        // a Start that was given up must not be carried out now.
        let late = |awake: Instant| {
            let asleep = clock::since(awake);
            (asleep > BEAT * LEASE).then(|| format!("this process stood still for {} ms", asleep.as_millis()))
        };
        loop {
            tokio::select! {
                // Messages that arrived count before the silence does.
                biased;
                arrived = self.inbound.next() => {
                    let said = match arrived {
                        Some(Ok(said)) => said,
                        None => return "it closed the stream".into(),
                        Some(Err(e)) => return e.message().to_owned(),
                    };
                    if let Some(why) = late(awake) {
                        return why;
                    }
                    silent = 0;
                    self.heard.send_replace(clock::now());
                    let lateness = self.lateness.lock().of(said.sent_ns);
                    match said.message {
                        Some(attach_response::Message::Order(order)) => {
                            self.orders.carry_out(order, lateness).await;
                        }
                        Some(attach_response::Message::Refused(info)) => return info.text,
                        Some(attach_response::Message::Heartbeat(beat)) => {
                            self.revision = self.revision.max(beat.revision);
                            self.doubted.send_if_modified(|doubted| std::mem::replace(doubted, beat.doubted) != beat.doubted);
                        }
                        Some(attach_response::Message::Registered(_)) | None => {}
                    }
                }
                _ = beat.tick() => {
                    if let Some(why) = late(awake) {
                        return why;
                    }
                    if silent == LEASE {
                        return format!("silent for {} ms", (BEAT * LEASE).as_millis());
                    }
                    silent += 1;
                    sequence += 1;
                    let beat = attach_request::Message::Heartbeat(v1::Heartbeat { sequence, ..v1::Heartbeat::default() });
                    // A full queue means the GCM does not read: then its own lease ends.
                    let _ = self.out.try_send(message(beat));
                }
                Some(_) = self.tasks.join_next() => return "the stream does not take any more".into(),
            }
            awake = clock::now();
        }
    }
}

fn message(message: attach_request::Message) -> v1::AttachRequest {
    v1::AttachRequest { message: Some(message) }
}

fn hello(who: &Registration, inventory: &Inventory, feeds: bool) -> v1::Hello {
    v1::Hello {
        process: who.process.to_string(),
        instance: who.instance.to_be_bytes().to_vec(),
        endpoint: who.endpoint.clone(),
        pid: who.pid,
        inventory: Some(convert::inventory_out(inventory)),
        slice: Some(convert::slice_out(&who.slice)),
        epoch: who.epoch,
        revision: who.revision,
        feeds,
    }
}

/// Sends news and answers until the receiver is gone.
async fn pump(
    lcm: Arc<dyn Lcm>,
    mut news: broadcast::Receiver<News>,
    mut answers: mpsc::Receiver<v1::Answer>,
    out: Outgoing,
) {
    loop {
        let mut messages = Vec::new();
        tokio::select! {
            answer = answers.recv() => {
                let Some(answer) = answer else { return };
                while let Some(next) = waiting(&lcm, &mut news).await {
                    messages.extend(next);
                }
                messages.push(message(attach_request::Message::Answer(answer)));
            }
            next = news.recv() => match next {
                Ok(next) => messages.push(news_out(next)),
                Err(broadcast::error::RecvError::Lagged(_)) => messages = everything(&lcm).await,
                Err(broadcast::error::RecvError::Closed) => return,
            },
        }
        for message in messages {
            if out.send(message).await.is_err() {
                return;
            }
        }
    }
}

/// Returns the news that have come already; `None` when there are none.
async fn waiting(lcm: &Arc<dyn Lcm>, news: &mut broadcast::Receiver<News>) -> Option<Vec<v1::AttachRequest>> {
    match news.try_recv() {
        Ok(next) => Some(vec![news_out(next)]),
        Err(broadcast::error::TryRecvError::Lagged(_)) => Some(everything(lcm).await),
        Err(_) => None,
    }
}

fn news_out(next: News) -> v1::AttachRequest {
    let next = match next {
        // An LCM of this process answers late itself.
        News::State(report) | News::Late(_, _, report) => news::News::State(convert::report(&report)),
        News::Catalog(classes) => {
            news::News::Catalog(v1::Catalog { classes: classes.iter().map(|c| convert::class(c)).collect() })
        }
        News::Log(line) => news::News::Log(convert::line(line)),
        News::Half(half) => news::News::Proxy(convert::half(&half)),
        News::Warnings(Warnings { sentences, unfit }) => {
            news::News::Warnings(v1::ProcessWarnings { warnings: sentences, unfit })
        }
        News::StoppedHere(told) => news::News::StoppedHere(convert::stopped_here_out(&told)),
    };
    message(attach_request::Message::News(v1::News { news: Some(next) }))
}

/// Returns the status of everything, after a gap in the news.
async fn everything(lcm: &Arc<dyn Lcm>) -> Vec<v1::AttachRequest> {
    match lcm.inventory().await {
        Ok(inventory) => {
            let states = inventory.components.into_iter().map(News::State);
            let halves = inventory.halves.into_iter().map(News::Half);
            let whole = [News::Catalog(inventory.classes), News::Warnings(inventory.warnings)];
            let stopped = Some(inventory.stopped_here).filter(|told| told.number > 0);
            let stopped = stopped.into_iter().map(News::StoppedHere);
            states.chain(halves).chain(whole).chain(stopped).map(news_out).collect()
        }
        Err(refusal) => {
            log::warn!("the inventory cannot be had: {refusal}");
            Vec::new()
        }
    }
}
