//! Large answers and many go beside the stream of orders and heartbeats, and holds neither up.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use trocar_model::ProcessState;
use trocar_proto::v1;

use super::super::{Begin, Dialler, Uplink};
use super::{System, create, start, stop};
use crate::control::attach::LEASE;
use crate::gcm::Registration;
use crate::gcm::fake::{FakeLcm, comes, name};

/// Bytes of a picture.
const PICTURE: usize = 1 << 20;
/// The connections of a process, in the order in which it opens them.
const ATTACH: u64 = 1;
const FEED: u64 = 2;

/// A way to a port on which single connections can be held up, or cut.
struct Detour {
    addr: SocketAddr,
    opened: watch::Sender<u64>,
    held: watch::Sender<Option<u64>>,
    cut: watch::Sender<Option<u64>>,
    /// Bytes of connections from [`FEED`] on.
    beside: Arc<AtomicU64>,
    /// Pieces that have passed on [`ATTACH`].
    orders: watch::Sender<u64>,
}

impl Detour {
    async fn to(there: SocketAddr) -> Detour {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let detour = Detour {
            addr: listener.local_addr().unwrap(),
            opened: watch::Sender::new(0),
            held: watch::Sender::new(None),
            cut: watch::Sender::new(None),
            beside: Arc::default(),
            orders: watch::Sender::new(0),
        };
        let (opened, held, cut) = (detour.opened.clone(), detour.held.subscribe(), detour.cut.subscribe());
        let (beside, orders) = (detour.beside.clone(), detour.orders.clone());
        tokio::spawn(async move {
            while let Ok((caller, _)) = listener.accept().await {
                let port = TcpStream::connect(there).await.unwrap();
                let mut number = 0;
                opened.send_modify(|all| {
                    *all += 1;
                    number = *all;
                });
                let ((from, back), (answers, to)) = (caller.into_split(), port.into_split());
                let (beside, orders) = (beside.clone(), orders.clone());
                let count = move |bytes: usize| match number {
                    ATTACH => orders.send_modify(|pieces| *pieces += 1),
                    _ => _ = beside.fetch_add(bytes as u64, Ordering::Relaxed),
                };
                let (held, mut cut) = (held.clone(), cut.clone());
                tokio::spawn(async move {
                    tokio::select! {
                        () = passes(from, to, held, number, count) => {}
                        () = passes(answers, back, watch::channel(None).1, number, |_| ()) => {}
                        _ = cut.wait_for(|cut| *cut == Some(number)) => {}
                    }
                });
            }
        });
        detour
    }
}

async fn passes(
    mut from: OwnedReadHalf,
    mut to: OwnedWriteHalf,
    mut held: watch::Receiver<Option<u64>>,
    number: u64,
    count: impl Fn(usize),
) {
    let mut room = vec![0; 1 << 16];
    loop {
        // A sender that is gone holds nothing up.
        let _ = held.wait_for(|held| *held != Some(number)).await;
        let Ok(read @ 1..) = from.read(&mut room).await else { return };
        count(read);
        if to.write_all(&room[..read]).await.is_err() {
            return;
        }
    }
}

/// A GCM's system with a process "gui" that is attached by a detour.
async fn attached() -> (System, Arc<FakeLcm>, Detour, Uplink) {
    let (s, lcm) = (System::start().await, FakeLcm::new("gui"));
    let detour = Detour::to(s.server.addr()).await;
    let who = Registration::new(name("gui"), "127.0.0.1:7".into());
    let uplink = Uplink::start(detour.addr.to_string(), Dialler::local(), who, lcm.clone(), Begin::AtOnce)
        .await
        .unwrap();
    (s, lcm, detour, uplink)
}

async fn pictures(s: &System) -> tonic::Streaming<v1::SubscribeResponse> {
    let selections = vec![v1::Selection { path: "gui/a/frames".into(), ..Default::default() }];
    s.interact().subscribe(v1::SubscribeRequest { selections }).await.unwrap().into_inner()
}

#[tokio::test]
async fn pictures_that_are_held_up_hold_up_no_order_and_no_heartbeat() {
    let (s, lcm, detour, _uplink) = attached().await;
    let mut items = pictures(&s).await;
    assert!(lcm.show(PICTURE));
    assert_eq!(comes("a picture", items.message()).await.unwrap().unwrap().jpeg.len(), PICTURE);
    assert!(detour.beside.load(Ordering::Relaxed) > PICTURE as u64, "they have a connection of their own");
    detour.held.send_replace(Some(FEED));
    // Fills all that can be under way, again and again.
    let filling = tokio::spawn({
        let lcm = lcm.clone();
        async move {
            loop {
                lcm.show(PICTURE);
                tokio::task::yield_now().await;
            }
        }
    });
    let mut gcm = s.gcm();
    gcm.create(create("gui/a")).await.unwrap();
    for _ in 0..100 {
        gcm.start(start("gui/a")).await.unwrap();
        gcm.stop(stop("gui/a")).await.unwrap();
    }
    // Its beats come through: more of them than a session could miss.
    let session = s.gcm.graph().processes[&name("gui")].epoch;
    let mut orders = detour.orders.subscribe();
    for _ in 0..2 * LEASE {
        orders.mark_unchanged();
        comes("the next beat", orders.changed()).await.unwrap();
        let process = &s.gcm.graph().processes[&name("gui")];
        assert_eq!((process.state, process.epoch), (ProcessState::Attached, session));
    }
    filling.abort();
    detour.held.send_replace(None);
    assert_eq!(comes("pictures go on", items.message()).await.unwrap().unwrap().jpeg.len(), PICTURE);
}

#[tokio::test]
async fn a_feed_that_is_cut_ends_what_was_followed_over_it_and_is_opened_again() {
    let (s, lcm, detour, _uplink) = attached().await;
    let mut items = pictures(&s).await;
    detour.cut.send_replace(Some(FEED));
    assert!(comes("its followers are told", items.message()).await.unwrap().is_none());
    comes("what fed them has ended", lcm.unfollowed()).await;
    lcm.end_feeds();
    comes("another Feed", async { _ = detour.opened.subscribe().wait_for(|all| *all > FEED).await }).await;
    let mut items = pictures(&s).await;
    assert!(lcm.show(PICTURE));
    assert_eq!(comes("a picture", items.message()).await.unwrap().unwrap().jpeg.len(), PICTURE);
    assert_eq!(s.gcm.graph().processes[&name("gui")].state, ProcessState::Attached, "all the while");
    assert!(*detour.opened.borrow() > ATTACH);
}

#[tokio::test]
async fn a_process_that_opens_no_feed_is_asked_over_its_attach() {
    use tokio::sync::mpsc;
    use tokio_stream::wrappers::ReceiverStream;
    use v1::attach_service_client::AttachServiceClient;
    use v1::{attach_request, attach_response};

    let s = System::start().await;
    let mut client = AttachServiceClient::new(s.channel.clone());
    let (out, said) = mpsc::channel(16);
    let hello = v1::Hello { process: "old".into(), instance: vec![1; 16], ..Default::default() };
    let message = |message| v1::AttachRequest { message: Some(message) };
    out.send(message(attach_request::Message::Hello(hello))).await.unwrap();
    let mut orders = client.attach(ReceiverStream::new(said)).await.unwrap().into_inner();
    let reading = tokio::spawn({
        let mut interact = s.interact();
        async move { interact.read(v1::ReadRequest { path: "old/a/out".into(), ..Default::default() }).await }
    });
    let id = loop {
        let said = comes("the question", orders.message()).await.unwrap().unwrap();
        if let Some(attach_response::Message::Order(order)) = said.message {
            assert!(matches!(order.order, Some(v1::order::Order::Read(_))), "{order:?}");
            break order.id;
        }
    };
    let sample = v1::ReadResponse { seq: 5, ..Default::default() };
    let answer = v1::Answer { id, answer: Some(v1::answer::Answer::Sample(sample)) };
    out.send(message(attach_request::Message::Answer(answer))).await.unwrap();
    assert_eq!(comes("the answer", reading).await.unwrap().unwrap().into_inner().seq, 5);
}
