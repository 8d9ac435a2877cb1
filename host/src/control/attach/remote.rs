//! The LCM of an attached process: each call is an order with a number, and waits for the answer with that
//! number.
//!
//! Invariant: no call outlives its deadline or the stream. An order without a waiting caller is forgotten,
//! but for a change: when it is done all the same, that is news.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

use async_trait::async_trait;
use parking_lot::Mutex;
use tokio::sync::{broadcast, mpsc, oneshot};
use tonic::Status;
use trocar_lcm_api::clock;
use trocar_model::{Change, ComponentId, Name, Phase, Refusal, StepTimes, Warnings};
use trocar_proto::v1::answer::Answer as A;
use trocar_proto::v1::order::Order as O;
use trocar_proto::v1::{self, attach_request, attach_response, news};

use super::own::Own;
use super::road::{Beside, FeedOutgoing, Road};
use crate::control::convert;
use crate::lcm::{
    Decision, Detail, Halted, Inventory, Invoke, Item, Lcm, LinkDetail, News, Order, PluginInfo, RemoteEnd,
    Reply, Report, Sample, Selection, Stop, When,
};

/// Time for questions that name no deadline.
const WITHIN: Duration = Duration::from_secs(2);
/// Time for the way back: the process gets that much less time.
const WAY: Duration = Duration::from_millis(20);
/// Items that may wait for their follower.
const ITEMS: usize = 256;
/// News that may wait for the GCM.
const NEWS: usize = 1024;

/// The way to an attached process.
pub(super) type Outgoing = mpsc::Sender<Result<v1::AttachResponse, Status>>;

pub(super) struct RemoteLcm {
    process: Name,
    own: Own,
    next: AtomicU64,
    beside: Beside,
    /// `None` once the stream is gone.
    link: Arc<Mutex<Option<Link>>>,
}

struct Link {
    out: Outgoing,
    news: broadcast::Sender<News>,
    waiting: HashMap<u64, Waiting>,
}

enum Waiting {
    /// An order to follow something brings the feed it will fill.
    Answer(oneshot::Sender<A>, Road, Option<Feed>),
    Feed(Feed, Road),
    /// A change whose caller has given it up.
    Late(Change, Decision),
}

/// A subscription.
struct Feed {
    tell: mpsc::Sender<Item>,
    /// Items lost since the last one that was delivered.
    lost: u64,
    /// Signals that the process has ended the feed, or never begun it; dropped when the follower is gone.
    over: oneshot::Sender<()>,
}

/// Forgets an order when its caller stops waiting. The answer to a change that was sent is still heard.
struct Forget<'a> {
    lcm: &'a RemoteLcm,
    id: u64,
    change: Option<&'a Change>,
    decision: Decision,
    is_sent: bool,
}

impl Drop for Forget<'_> {
    fn drop(&mut self) {
        if let Some(link) = self.lcm.link.lock().as_mut()
            && matches!(link.waiting.get(&self.id), Some(Waiting::Answer(..)))
        {
            link.waiting.remove(&self.id);
            // The process answers each order that it gets, if only with a refusal.
            if let Some(change) = self.change.filter(|_| self.is_sent) {
                link.waiting.insert(self.id, Waiting::Late(change.clone(), self.decision));
            }
        }
    }
}

impl RemoteLcm {
    /// `feeds`: it opens a Feed as well.
    pub(super) fn new(process: Name, out: Outgoing, feeds: bool) -> Arc<RemoteLcm> {
        let link = Link { out, news: broadcast::Sender::new(NEWS), waiting: HashMap::new() };
        let (next, link) = (AtomicU64::new(1), Arc::new(Mutex::new(Some(link))));
        Arc::new(RemoteLcm {
            own: Own::new(process.clone()),
            process,
            next,
            beside: Beside::new(feeds),
            link,
        })
    }

    /// Returns what of an inventory is the process's own.
    pub(super) fn own(&self, inventory: Inventory) -> Inventory {
        self.own.inventory(inventory)
    }

    /// Sends questions over this Feed from now on; returns its number.
    pub(super) fn feeds_over(&self, out: FeedOutgoing) -> u64 {
        let (number, before) = self.beside.open(out);
        if let Some(before) = before {
            self.feed_ended(before);
        }
        number
    }

    /// Until the Feed of this number is not the one any more, or the process is gone.
    pub(super) fn feed_over(&self, number: u64) -> impl Future<Output = ()> + Send + use<> {
        self.beside.over(number)
    }

    /// Answers what was asked over the Feed of this number, which has ended.
    pub(super) fn feed_ended(&self, number: u64) {
        self.beside.close(number);
        let Some(link) = &mut *self.link.lock() else { return };
        let over = |waiting: &Waiting| match waiting {
            Waiting::Answer(_, road, _) | Waiting::Feed(_, road) => road.is_feed(number),
            Waiting::Late(..) => false,
        };
        for (_, waiting) in link.waiting.extract_if(|_, waiting| over(waiting)) {
            match waiting {
                Waiting::Answer(_, _, Some(feed)) | Waiting::Feed(feed, _) => feed.end(),
                Waiting::Answer(_, _, None) | Waiting::Late(..) => {}
            }
        }
    }

    /// Something arrived on the stream.
    pub(super) fn hear(&self, said: v1::AttachRequest) {
        match said.message {
            Some(attach_request::Message::Answer(answer)) => self.answered(answer),
            Some(attach_request::Message::News(news)) => match news_in(news) {
                Ok(news) => {
                    let own = self.own.news(news);
                    if let (Some(news), Some(link)) = (own, self.link.lock().as_ref()) {
                        // The GCM that listens may just be letting go.
                        let _ = link.news.send(news);
                    }
                }
                Err(refusal) => log::warn!("news of process {} cannot be read: {refusal}", self.process),
            },
            Some(attach_request::Message::Heartbeat(_)) => {}
            Some(attach_request::Message::Hello(_)) | None => {
                log::warn!("process {} said something this version does not know", self.process);
            }
        }
    }

    /// Tells every waiting caller that the process is lost.
    pub(super) fn close(&self) {
        self.link.lock().take();
        self.beside.end();
    }

    fn lost(&self) -> Refusal {
        Refusal::lost(self.process.clone())
    }

    /// An answer arrived, over whichever stream.
    pub(super) fn answered(&self, answer: v1::Answer) {
        let mut guard = self.link.lock();
        let Some(link) = guard.as_mut() else { return };
        let Some(what) = answer.answer else { return };
        match (what, link.waiting.remove(&answer.id)) {
            (A::Item(item), Some(Waiting::Feed(mut feed, road))) => {
                feed.give(item);
                link.waiting.insert(answer.id, Waiting::Feed(feed, road));
            }
            (what, Some(Waiting::Answer(tell, road, feed))) => {
                match (&what, feed) {
                    // The items behind this answer must find their feed.
                    (A::Subscribed(_), Some(feed)) => {
                        link.waiting.insert(answer.id, Waiting::Feed(feed, road));
                    }
                    (_, Some(feed)) => feed.end(),
                    (_, None) => {}
                }
                // The caller may have given up meanwhile.
                let _ = tell.send(what);
            }
            (_, Some(Waiting::Feed(feed, _))) => feed.end(),
            (A::Report(told), Some(Waiting::Late(change, decision))) => match self.report_in(told) {
                // The GCM that listens may just be letting go.
                Ok(report) => _ = link.news.send(News::Late(Box::new(change), decision, report)),
                Err(refusal) => log::warn!("an answer of process {} cannot be read: {refusal}", self.process),
            },
            // It was not done.
            (_, Some(Waiting::Late(..))) => {}
            // No caller waits for it any more.
            (_, None) => {}
        }
    }

    fn report_in(&self, told: v1::ComponentReport) -> Result<Report, Refusal> {
        self.own.report(convert::report_in(told)?)
    }

    async fn ask(&self, order: O, deadline: Instant, what: &str) -> Result<A, Refusal> {
        self.ask_for(self.number(), (order, None), deadline.into(), what, (None, None)).await
    }

    /// Asks over the Feed, where there is one: the answer may be large.
    async fn ask_beside(&self, order: O, deadline: Instant, what: &str) -> Result<A, Refusal> {
        let road = self.beside.road(deadline).await;
        self.ask_for(self.number(), (order, None), deadline.into(), what, (road, None)).await
    }

    /// Orders a change.
    async fn change(&self, asked: O, change: &Change, order: Order, what: &str) -> Result<Report, Refusal> {
        match self.ask_for(self.number(), (asked, Some(change)), order, what, (None, None)).await? {
            A::Report(told) => self.report_in(told),
            _ => wrong(),
        }
    }

    /// `road`: the stream it goes by, if not Attach.
    async fn ask_for(
        &self,
        id: u64,
        (asked, change): (O, Option<&Change>),
        Order { deadline, decision, .. }: Order,
        what: &str,
        (road, feed): (Option<Road>, Option<Feed>),
    ) -> Result<A, Refusal> {
        let (tell, told) = oneshot::channel();
        let road = {
            let mut guard = self.link.lock();
            let link = guard.as_mut().ok_or_else(|| self.lost())?;
            let road = road.unwrap_or_else(|| Road::Attach(link.out.clone()));
            link.waiting.insert(id, Waiting::Answer(tell, road.clone(), feed));
            road
        };
        let late = || Refusal::LcmTimeout { process: self.process.clone(), what: what.to_owned() };
        let mut forget = Forget { lcm: self, id, change, decision, is_sent: false };
        let left = deadline.saturating_duration_since(clock::now()).saturating_sub(WAY);
        let deadline_ns = u64::try_from(left.as_nanos()).unwrap_or(u64::MAX);
        let Decision(decision) = decision;
        let order = v1::Order { id, deadline_ns, decision, order: Some(asked) };
        let exchange = async {
            if !road.send(order).await {
                return None;
            }
            forget.is_sent = true;
            told.await.ok()
        };
        match tokio::time::timeout_at(deadline.into(), exchange).await {
            Ok(Some(A::Refused(info))) => Err(convert::refusal(&info)),
            Ok(Some(answer)) => Ok(answer),
            // A Feed may end while its process goes on.
            Ok(None) if self.link.lock().is_some() && matches!(road, Road::Feed(..)) => Err(late()),
            Ok(None) => Err(self.lost()),
            Err(_) => Err(late()),
        }
    }

    fn number(&self) -> u64 {
        self.next.fetch_add(1, Ordering::Relaxed)
    }

    async fn question(&self, order: O, what: &str) -> Result<A, Refusal> {
        self.ask(order, clock::now() + WITHIN, what).await
    }

    async fn question_beside(&self, order: O, what: &str) -> Result<A, Refusal> {
        self.ask_beside(order, clock::now() + WITHIN, what).await
    }
}

pub(super) fn message(message: attach_response::Message) -> v1::AttachResponse {
    static BEGAN: LazyLock<Instant> = LazyLock::new(clock::now);
    // Never 0, which means that there is no stamp.
    let sent_ns = clock::since(*BEGAN).as_nanos() + 1;
    v1::AttachResponse { message: Some(message), sent_ns: u64::try_from(sent_ns).unwrap_or(u64::MAX) }
}

/// Gives a feed up as soon as its follower is gone, also a feed that is only asked for. Its own sender does
/// not outlive the feed, or the receiver would never end.
async fn mind(
    link: Arc<Mutex<Option<Link>>>,
    (id, road): (u64, Road),
    tell: mpsc::Sender<Item>,
    ended: oneshot::Receiver<()>,
) {
    tokio::select! {
        biased;
        by_process = ended => if by_process.is_ok() { return },
        () = tell.closed() => {}
    }
    match &mut *link.lock() {
        Some(link) => _ = link.waiting.remove(&id),
        // Without a process there is nothing to unsubscribe from.
        None => return,
    }
    let order = v1::Order { order: Some(O::Unsubscribe(id)), ..v1::Order::default() };
    // A stream that has ended followed nothing any more.
    road.send(order).await;
}

impl Feed {
    fn end(self) {
        // The task that minds the feed may have ended because its receiver is gone.
        let _ = self.over.send(());
    }

    /// Gives an item; one that does not fit is counted in the next item that does.
    fn give(&mut self, item: v1::SubscribeResponse) {
        let Ok(mut item) = convert::item_in(item) else {
            self.lost += 1;
            return;
        };
        let lost = item.skipped + self.lost;
        item.skipped = lost;
        match self.tell.try_send(item) {
            Ok(()) => self.lost = 0,
            Err(_) => self.lost = lost + 1,
        }
    }
}

fn news_in(news: v1::News) -> Result<News, Refusal> {
    Ok(match news.news.ok_or_else(|| convert::unreadable("news"))? {
        news::News::State(report) => News::State(convert::report_in(report)?),
        news::News::Catalog(catalog) => News::Catalog(convert::classes_in(catalog.classes)?),
        news::News::Log(line) => News::Log(convert::line_in(line)),
        news::News::Proxy(half) => News::Half(convert::half_in(half)?),
        news::News::Warnings(told) => {
            News::Warnings(Warnings { sentences: told.warnings, unfit: told.unfit })
        }
        news::News::StoppedHere(told) => News::StoppedHere(convert::stopped_here_in(told)?),
    })
}

fn wrong<T>() -> Result<T, Refusal> {
    Err(convert::unreadable("answer"))
}

#[async_trait]
impl Lcm for RemoteLcm {
    async fn apply(&self, change: Change, order: Order) -> Result<Report, Refusal> {
        let what = crate::gcm::asked(&change);
        self.change(O::Apply(convert::change_out(&change)), &change, order, &what).await
    }

    async fn stop(&self, stop: Stop, order: Order) -> Result<Vec<Halted>, Refusal> {
        let asked = (O::Stop(convert::stop_out(&stop)), None);
        match self.ask_for(self.number(), asked, order, "a Stop", (None, None)).await? {
            A::Halted(halted) => Ok(self.own.halted(convert::halted_in(halted)?)),
            _ => wrong(),
        }
    }

    async fn link(&self, end: RemoteEnd, deadline: Instant) -> Result<Report, Refusal> {
        let what = format!("connecting {} to {}", end.connection.client, end.connection.server);
        let change = Change::Connect { connection: end.connection.clone() };
        self.change(O::Link(convert::remote_out(&end)), &change, deadline.into(), &what).await
    }

    async fn invoke(&self, call: Invoke) -> Result<Reply, Refusal> {
        let (member, after_ns) = (call.member.clone(), call.deadline_ns);
        // The LCM keeps the deadline of the call; this time is for the way there and back.
        let deadline = clock::now() + Duration::from_nanos(after_ns) + 5 * WAY;
        match self.ask(O::Invoke(convert::invoke_out(call)), deadline, "").await {
            Ok(A::Reply(reply)) => Ok(convert::reply_in(reply)),
            Ok(_) => wrong(),
            Err(Refusal::LcmTimeout { .. }) => {
                Err(Refusal::Deadline { member, after_ns, may_still_run: true })
            }
            Err(Refusal::ProcessLost { .. }) => Err(Refusal::PeerLost { member }),
            Err(refusal) => Err(refusal),
        }
    }

    async fn read(
        &self,
        path: String,
        when: When,
        frame: bool,
        deadline: Instant,
    ) -> Result<Sample, Refusal> {
        let what = format!("reading {path}");
        let order = O::Read(v1::ReadRequest { path, row: convert::row(when), frame });
        match self.ask_beside(order, deadline, &what).await? {
            A::Sample(sample) => Ok(convert::sample_in(sample)),
            _ => wrong(),
        }
    }

    async fn subscribe(&self, selections: Vec<Selection>) -> Result<mpsc::Receiver<Item>, Refusal> {
        let selections = selections.into_iter().map(convert::selection_out).collect();
        let (tell, told) = mpsc::channel(ITEMS);
        let (over, ended) = oneshot::channel();
        let id = self.number();
        let feed = Feed { tell: tell.clone(), lost: 0, over };
        let order = O::Subscribe(v1::SubscribeRequest { selections });
        let road = match self.beside.road(clock::now() + WITHIN).await {
            Some(road) => road,
            None => self
                .link
                .lock()
                .as_ref()
                .map(|link| Road::Attach(link.out.clone()))
                .ok_or_else(|| self.lost())?,
        };
        tokio::spawn(mind(self.link.clone(), (id, road.clone()), tell, ended));
        let within = (clock::now() + WITHIN).into();
        match self.ask_for(id, (order, None), within, "a subscription", (Some(road), Some(feed))).await? {
            A::Subscribed(_) => Ok(told),
            _ => wrong(),
        }
    }

    async fn details(&self, ids: Vec<ComponentId>) -> Result<Vec<(ComponentId, Detail)>, Refusal> {
        let order = v1::DetailsOrder { paths: ids.iter().map(ToString::to_string).collect() };
        match self.question_beside(O::Details(order), "the figures of its components").await? {
            A::Details(told) => {
                let all = told.components.into_iter().map(convert::detail_in);
                Ok(self.own.details(all.collect::<Result<_, _>>()?))
            }
            _ => wrong(),
        }
    }

    async fn links(&self) -> Result<Vec<LinkDetail>, Refusal> {
        match self.question_beside(O::Links(v1::LinksOrder {}), "the figures of its connections").await? {
            A::Links(links) => links.links.into_iter().map(convert::link_in).collect(),
            _ => wrong(),
        }
    }

    async fn phases(
        &self,
        given: Option<Vec<(ComponentId, Phase)>>,
        deadline: Instant,
    ) -> Result<StepTimes, Refusal> {
        let order = O::Phases(convert::phases_out(given));
        match self.ask(order, deadline, "the phases of its components").await? {
            A::Steps(steps) => convert::steps_in(steps),
            _ => wrong(),
        }
    }

    async fn plugins(&self) -> Result<Vec<PluginInfo>, Refusal> {
        match self.question(O::Plugins(v1::PluginsOrder {}), "its list of plugins").await? {
            A::Plugins(plugins) => Ok(plugins.plugins.into_iter().map(convert::plugin_in).collect()),
            _ => wrong(),
        }
    }

    async fn recheck(&self, name: &str, deadline: Instant) -> Result<Vec<PluginInfo>, Refusal> {
        let order = O::Recheck(v1::RecheckOrder { name: name.into() });
        match self.ask(order, deadline, "another look at its plugins").await? {
            A::Plugins(plugins) => Ok(plugins.plugins.into_iter().map(convert::plugin_in).collect()),
            _ => wrong(),
        }
    }

    async fn inventory(&self) -> Result<Inventory, Refusal> {
        match self.question(O::Inventory(v1::InventoryOrder {}), "its inventory").await? {
            A::Inventory(inventory) => Ok(self.own.inventory(convert::inventory_in(inventory)?)),
            _ => wrong(),
        }
    }

    fn news(&self) -> broadcast::Receiver<News> {
        match self.link.lock().as_ref() {
            Some(link) => link.news.subscribe(),
            // A channel that has ended.
            None => broadcast::channel(1).1,
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::gcm::fake::name;

    fn numbered(told: Result<v1::AttachResponse, tonic::Status>) -> (u64, O) {
        match told.unwrap().message {
            Some(attach_response::Message::Order(v1::Order { id, order: Some(order), .. })) => (id, order),
            other => panic!("{other:?}"),
        }
    }

    fn answer(lcm: &RemoteLcm, id: u64, answer: A) {
        let answer = v1::Answer { id, answer: Some(answer) };
        lcm.hear(v1::AttachRequest { message: Some(attach_request::Message::Answer(answer)) });
    }

    fn waiting(lcm: &RemoteLcm) -> usize {
        lcm.link.lock().as_ref().unwrap().waiting.len()
    }

    fn asked(lcm: &Arc<RemoteLcm>) -> tokio::task::JoinHandle<Result<mpsc::Receiver<Item>, Refusal>> {
        let lcm = lcm.clone();
        let selection = Selection { path: "far/a/value".into(), ..Selection::default() };
        tokio::spawn(async move { lcm.subscribe(vec![selection]).await })
    }

    #[tokio::test]
    async fn a_subscription_that_ended_leaves_nothing_whoever_ended_it_and_when() {
        let (out, mut orders) = mpsc::channel(4);
        let lcm = RemoteLcm::new(name("far"), out, false);
        // Taken, and let go of.
        let following = asked(&lcm);
        let (id, _) = numbered(orders.recv().await.unwrap());
        answer(&lcm, id, A::Subscribed(v1::Subscribed {}));
        let feed = following.await.unwrap().unwrap();
        assert_eq!(waiting(&lcm), 1);
        drop(feed);
        assert_eq!(numbered(orders.recv().await.unwrap()), (0, O::Unsubscribe(id)));
        assert_eq!(waiting(&lcm), 0, "after its end");
        answer(&lcm, id, A::Item(v1::SubscribeResponse::default()));
        assert_eq!(waiting(&lcm), 0, "by an item that was under way");
        // The follower gives up before the answer.
        let following = asked(&lcm);
        let (id, _) = numbered(orders.recv().await.unwrap());
        following.abort();
        assert!(following.await.unwrap_err().is_cancelled());
        assert_eq!(numbered(orders.recv().await.unwrap()), (0, O::Unsubscribe(id)), "it may have begun");
        answer(&lcm, id, A::Subscribed(v1::Subscribed {}));
        assert_eq!(waiting(&lcm), 0, "of one that nobody waits for");
        // The process refuses, or ends the feed: there is nothing to give up.
        let following = asked(&lcm);
        let (id, _) = numbered(orders.recv().await.unwrap());
        answer(&lcm, id, A::Refused(convert::refusal_info(&Refusal::lost(name("far")))));
        assert_eq!(following.await.unwrap().unwrap_err().reason(), "PROCESS_LOST");
        let following = asked(&lcm);
        let (id, _) = numbered(orders.recv().await.unwrap());
        answer(&lcm, id, A::Subscribed(v1::Subscribed {}));
        let mut feed = following.await.unwrap().unwrap();
        answer(&lcm, id, A::Ended(v1::Ended {}));
        assert!(feed.recv().await.is_none());
        assert_eq!(waiting(&lcm), 0, "of one that its process has ended");
        drop(feed);
        // Every task that minds one has had its turn.
        for _ in 0..8 {
            tokio::task::yield_now().await;
        }
        assert!(orders.try_recv().is_err(), "it was given up although it was over");
    }
}
