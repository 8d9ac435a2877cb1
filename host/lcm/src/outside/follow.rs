//! Subscriptions: states, events and outputs followed until the receiver is dropped.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use serde_json::json;
use tokio::sync::{broadcast, mpsc};
use trocar_lcm_api::{Item, ItemKind, News, Report, Selection};
use trocar_model::{ComponentId, MemberId, PortId, Refusal};
use trocar_plugin_api::rate::RateLimit;
use trocar_rt::os;

use super::super::instance::Instance;
use super::Shows;
use super::event::Event;
use super::output::{Output, Want};

/// Most items that wait for a slow receiver.
const ITEMS: usize = 256;
/// Items per second of an output when no rate is asked for.
const DEFAULT_RATE_HZ: f64 = 30.0;
/// Longest pause between looks at an output without new samples, whatever the rate.
const LONGEST_PAUSE: Duration = Duration::from_millis(33);
/// Most pictures per second of one output, Hz: the eye sees no more.
const MOST_PICTURES_HZ: f64 = 60.0;

/// Source of the items of one selection.
enum Feed {
    State {
        instance: Arc<Instance>,
        news: broadcast::Receiver<News>,
    },
    Event(Event),
    /// An output, and the rate at which it is looked at.
    Output(Output, RateLimit),
}

/// Opens every selection, or none, and follows them until the receiver is dropped.
pub(crate) fn subscribe(
    lcm: &impl Shows,
    selections: Vec<Selection>,
) -> Result<mpsc::Receiver<Item>, Refusal> {
    let feeds = selections
        .iter()
        .map(|s| open(lcm, s).map(|feed| (s.path.clone(), feed)))
        .collect::<Result<Vec<_>, _>>()?;
    let (tell, told) = mpsc::channel(ITEMS);
    for (path, feed) in feeds {
        let teller = Teller { path, tell: tell.clone(), lost: AtomicU64::new(0) };
        tokio::spawn(async move {
            match feed {
                Feed::State { instance, news } => follow_state(teller, instance, news).await,
                Feed::Event(event) => follow_event(teller, event).await,
                Feed::Output(output, rate) => follow_output(teller, output, rate).await,
            }
        });
    }
    Ok(told)
}

fn open(lcm: &impl Shows, selection: &Selection) -> Result<Feed, Refusal> {
    let path = selection.path.as_str();
    match path.split('/').count() {
        2 => {
            let news = lcm.news();
            Ok(Feed::State { instance: lcm.component(&ComponentId::parse(path)?)?, news })
        }
        3 => {
            let port = PortId::parse(path)?;
            let rate = if selection.max_rate_hz > 0.0 { selection.max_rate_hz } else { DEFAULT_RATE_HZ };
            let (want, most) = match selection.thumbnail_width {
                0 => (Want::Value, 1000.0),
                width => (Want::Picture(width, selection.eye), MOST_PICTURES_HZ),
            };
            Ok(Feed::Output(Output::open(lcm, &port, want)?, RateLimit::new(rate.clamp(0.01, most))))
        }
        _ => Ok(Feed::Event(Event::open(lcm, &MemberId::parse(path)?)?)),
    }
}

/// Hands items to the receiver; items that a full channel cannot take are counted in the next one.
struct Teller {
    path: String,
    tell: mpsc::Sender<Item>,
    lost: AtomicU64,
}

impl Teller {
    fn give(&self, item: Item) {
        let skipped = item.skipped + self.lost.swap(0, Ordering::Relaxed);
        let item = Item { path: self.path.clone(), skipped, ..item };
        if self.tell.try_send(item).is_err() {
            self.lost.fetch_add(skipped + 1, Ordering::Relaxed);
        }
    }

    /// Waits for the next look; true when the receiver is gone.
    async fn rests(&self, pause: Duration) -> bool {
        tokio::select! {
            () = self.tell.closed() => true,
            () = tokio::time::sleep(pause) => false,
        }
    }
}

async fn follow_state(teller: Teller, instance: Arc<Instance>, mut news: broadcast::Receiver<News>) {
    // The present state comes first: a receiver that has it misses nothing after it.
    teller.give(standing(&instance.report(false)));
    loop {
        tokio::select! {
            () = teller.tell.closed() => return,
            received = news.recv() => match received {
                Ok(News::State(report)) if report.id == instance.id => teller.give(standing(&report)),
                Ok(_) => {}
                Err(broadcast::error::RecvError::Lagged(n)) => {
                    teller.lost.fetch_add(n, Ordering::Relaxed);
                }
                Err(broadcast::error::RecvError::Closed) => return,
            },
        }
    }
}

/// A component's state as an item.
fn standing(report: &Report) -> Item {
    Item {
        path: String::new(),
        kind: ItemKind::State,
        value: json!({
            "state": report.state.to_string(),
            "health": report.health.to_string(),
            "fault": report.fault,
        }),
        stamp_ns: os::now_ns(),
        seq: 0,
        skipped: 0,
        jpeg: Vec::new(),
    }
}

async fn follow_event(teller: Teller, mut event: Event) {
    loop {
        let next = tokio::select! {
            () = teller.tell.closed() => return,
            next = event.next() => next,
        };
        let Some((heard, seq, skipped)) = next else { return };
        teller.give(Item {
            path: String::new(),
            kind: ItemKind::Event,
            value: heard.value.clone(),
            stamp_ns: heard.stamp_ns,
            seq,
            skipped,
            jpeg: Vec::new(),
        });
    }
}

async fn follow_output(teller: Teller, mut output: Output, mut rate: RateLimit) {
    // Items lie on a grid: a late timer or a long look slows nothing down.
    let mut pause = Duration::ZERO;
    while !teller.rests(pause).await {
        if output.shared().instance.is_closed() {
            return;
        }
        let looked_ns = os::now_ns();
        let Some(newest) = output.newest().await else { return };
        let Some((shown, skipped)) = newest else {
            pause = LONGEST_PAUSE.min(Duration::from_nanos(rate.gap_ns()));
            continue;
        };
        rate.keep(looked_ns);
        pause = Duration::from_nanos(rate.due_ns().saturating_sub(os::now_ns()));
        let mut value = match &shown.value {
            Ok(value) => value.clone(),
            Err(refusal) => {
                log::error!("following {}: {refusal}", teller.path);
                continue;
            }
        };
        if shown.frame_bytes > 0
            && let Some(object) = value.as_object_mut()
        {
            object.insert("frame_bytes".into(), shown.frame_bytes.into());
        }
        teller.give(Item {
            path: String::new(),
            kind: ItemKind::Stream,
            value,
            stamp_ns: shown.meta.stamp_ns,
            seq: shown.meta.seq,
            skipped,
            jpeg: output.picture(&shown),
        });
    }
}
