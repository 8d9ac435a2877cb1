//! What the outside sees: a state row or an output read once, events, states and outputs followed.
//!
//! Invariant: costs the component nothing but a push into a bounded queue; whoever reads too slowly loses items, counted.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::sync::{Semaphore, broadcast, mpsc};
use trocar_model::{ComponentId, MemberId, PortId, PortType, Ports, Refusal, Type, ValueError, decode};
use trocar_plugin_api::rate::RateLimit;
use trocar_rt::mailbox::{EntryHead, Mailbox};
use trocar_rt::os;
use trocar_rt::stream::{Payload as StreamPayload, Queue, StreamReader, stream_link};

use super::api::{Item, ItemKind, News, Report, Sample, Selection, When};
use super::boundary::{Consumer, EventCell, EventSink, OUTSIDE, OutCell, OutLink, Tap};
use super::convert::back;
use super::instance::Instance;
use super::local::LocalLcm;
use super::rows;
use super::thumbnail::{self, Small};

/// Items a slow receiver may have waiting.
const ITEMS: usize = 256;
/// Events one follower may have waiting between two looks.
const TAP_DEPTH: usize = 256;
/// Most bytes of a frame that are handed out: a message of the GCM holds some more.
const MOST_FRAME_BYTES: usize = 24 << 20;
/// How often followers look at their queues.
const LOOK: Duration = Duration::from_millis(5);
/// Items per second of an output when nothing else is asked.
const DEFAULT_RATE_HZ: f64 = 30.0;
/// Longest pause between looks at an output that has given nothing new, whatever the rate.
const LONGEST_PAUSE: Duration = Duration::from_millis(33);
/// Pictures per second of one output, Hz: nobody sees more.
const MOST_PICTURES_HZ: f64 = 60.0;
/// Pictures made at once: a page full of them takes no more of the machine than this.
static MAKING: Semaphore = Semaphore::const_new(2);

/// The bytes of a value come from the plugin, and so does what is wrong with them.
pub(super) fn misfit(instance: &Instance, e: &ValueError) -> String {
    format!("its class {} made a value that does not fit the type: {e}", instance.info.full_name())
}

fn not_shown(instance: &Instance, entry: &'static str, e: &ValueError) -> Refusal {
    Refusal::ComponentRefused { id: instance.id.clone(), entry, text: misfit(instance, e) }
}

pub(super) fn wrong_kind(member: &MemberId, is: String, wanted: &str) -> Refusal {
    Refusal::WrongKind { member: member.clone(), is, wanted: wanted.to_owned() }
}

/// The state row of `process/component`, or the next sample of `process/component/output`.
pub(super) async fn read(
    lcm: &LocalLcm,
    path: &str,
    when: When,
    frame: bool,
    deadline: Instant,
) -> Result<Sample, Refusal> {
    if path.split('/').count() == 2 {
        let instance = lcm.instance(&ComponentId::parse(path)?)?;
        return state_row(&instance, when);
    }
    let port = PortId::parse(path)?;
    if when != When::Newest {
        return Err(Refusal::ArgumentInvalid {
            what: format!("Read {path}"),
            why: format!("an output keeps no rows, only the state of `{}` does", port.component),
            field: "path".into(),
        });
    }
    let mut output = Output::open(lcm.instance(&port.component)?, &port)?;
    let began = Instant::now();
    loop {
        if let Some((sample, ..)) = output.newest(Want { frame, width: 0 })? {
            return Ok(sample);
        }
        if Instant::now() >= deadline {
            let state = output.instance.state();
            return Err(Refusal::NoSample { port, state, after_ns: began.elapsed().as_nanos() as u64 });
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

fn state_row(instance: &Instance, when: When) -> Result<Sample, Refusal> {
    let ports = instance.ports();
    let mut sample = Sample { value: json!({}), ..Sample::default() };
    let misfit = |e: &ValueError| not_shown(instance, "show its state", e);
    if let Some(ty) = &ports.state
        && let Some(row) = rows::read(&instance.rows, ty, &instance.id, when, misfit)?
    {
        sample.value = decode(ty, &row.bytes).map_err(|e| misfit(&e))?;
        sample.stamp_ns = row.stamp_ns;
        sample.age_ns = os::now_ns().saturating_sub(row.stamp_ns);
        sample.seq = row.tick;
        sample.encoded = row.bytes;
    }
    Ok(sample)
}

/// What the port of that name is, where it is one but no output.
fn no_output(ports: &Ports, name: &str) -> Option<&'static str> {
    if ports.inputs.iter().any(|p| p.name == name) {
        Some("an input")
    } else if ports.required.iter().any(|p| p.name == name) {
        Some("a required interface")
    } else if ports.provided.iter().any(|p| p.name == name) {
        Some("a provided interface")
    } else {
        None
    }
}

/// What is wanted of a frame beside its header.
#[derive(Clone, Copy, Default)]
struct Want {
    /// All its bytes.
    frame: bool,
    /// The image in it, so many pixels wide; 0 = none.
    width: u32,
}

/// A reader from outside on one output; the link goes with it.
struct Output {
    instance: Arc<Instance>,
    /// Of the port.
    name: String,
    cell: Arc<OutCell>,
    ty: Type,
    reader: StreamReader,
    link: Arc<OutLink>,
    last_seq: u64,
}

impl Output {
    fn open(instance: Arc<Instance>, port: &PortId) -> Result<Output, Refusal> {
        let set = instance.described.now();
        let ports = &set.ports;
        let Some(index) = ports.outputs.iter().position(|o| o.name == port.port.as_str()) else {
            if let Some(what) = no_output(ports, port.port.as_str()) {
                let outputs: Vec<&str> = ports.own_outputs().map(|o| o.name.as_str()).collect();
                let there = if outputs.is_empty() { "none".to_owned() } else { outputs.join(", ") };
                return Err(Refusal::ArgumentInvalid {
                    what: format!("Read {port}"),
                    why: format!("it is {what}, and only outputs can be read; outputs there: {there}"),
                    field: "path".into(),
                });
            }
            return Err(Refusal::InterfaceNotFound {
                port: port.clone(),
                known: ports.own_outputs().map(|o| o.name.clone()).collect(),
            });
        };
        let cell = set.slots.output(index).clone();
        let Some(passing) = cell.passing() else {
            return Err(Refusal::NotImplemented {
                what: format!("reading the untyped output {port} while nothing is connected to it"),
                hint: "connect it to a typed input first: it takes that type".into(),
            });
        };
        let (ty, payload) = match &passing {
            PortType::Frame { header, .. } => (header.clone(), StreamPayload::Frame),
            PortType::Plain(ty) => (ty.clone(), StreamPayload::Plain { bytes: ty.size() }),
            PortType::Any => return Err(Refusal::Internal { text: format!("{port} passes no type") }),
        };
        let (writer, reader) = stream_link(payload, Queue::Latest);
        let link = Arc::new(OutLink::new(OUTSIDE, writer, Consumer::Outside, true));
        cell.add(link.clone(), &passing, &back::port(&passing).into());
        Ok(Output { instance, name: port.port.to_string(), cell, ty, reader, link, last_seq: 0 })
    }

    /// The newest sample not shown yet, how many were left out before it, and the image in it, where one is wanted.
    ///
    /// # Errors
    /// It is no value of its type; its frame is wanted and more than can be handed out.
    fn newest(&mut self, want: Want) -> Result<Option<(Sample, u64, Option<Small>)>, Refusal> {
        let Want { frame, width } = want;
        let Some(sample) = self.reader.latest().filter(|s| s.fresh) else { return Ok(None) };
        let value =
            decode(&self.ty, sample.data).map_err(|e| not_shown(&self.instance, "show an output", &e))?;
        // Numbers stand still where a component writes from two threads at once.
        let skipped = if self.last_seq == 0 { 0 } else { sample.meta.seq.saturating_sub(self.last_seq + 1) };
        self.last_seq = sample.meta.seq;
        let image = if width > 0 { thumbnail::small(&value, sample.bytes, width) } else { None };
        let shown = Sample {
            value,
            encoded: sample.data.to_vec(),
            stamp_ns: sample.meta.stamp_ns,
            age_ns: os::now_ns().saturating_sub(sample.meta.stamp_ns),
            seq: sample.meta.seq,
            frame_bytes: sample.bytes.len() as u64,
            frame: if frame && sample.bytes.len() <= MOST_FRAME_BYTES {
                sample.bytes.to_vec()
            } else {
                Vec::new()
            },
        };
        self.reader.release();
        if frame && shown.frame_bytes > MOST_FRAME_BYTES as u64 {
            return Err(Refusal::ArgumentInvalid {
                what: format!("Read {}/{}", self.instance.id, self.name),
                why: format!(
                    "its frames have {} bytes, and at most {MOST_FRAME_BYTES} are handed out: follow it with a thumbnail_width",
                    shown.frame_bytes
                ),
                field: "frame".into(),
            });
        }
        Ok(Some((shown, skipped, image)))
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        self.cell.remove(|l| Arc::ptr_eq(l, &self.link));
        self.instance.reclaim();
    }
}

/// A reader from outside on one event; the tap goes with it.
struct EventFeed {
    instance: Arc<Instance>,
    member: MemberId,
    cell: Arc<EventCell>,
    ty: Option<Type>,
    tap: Arc<Tap>,
    sink: Arc<EventSink>,
    seq: u64,
    dropped: u64,
    /// A payload that does not fit was told of.
    warned: bool,
}

impl EventFeed {
    fn open(instance: Arc<Instance>, member: &MemberId) -> Result<EventFeed, Refusal> {
        let (cell, ty) = event_of(&instance, member)?;
        let tap = Arc::new(Tap { mailbox: Mailbox::new(TAP_DEPTH, ty.as_ref().map_or(0, Type::size), 0) });
        let sink = Arc::new(EventSink::Tap(tap.clone()));
        cell.edit(|sinks| sinks.push(sink.clone()));
        Ok(EventFeed {
            instance,
            member: member.clone(),
            cell,
            ty,
            tap,
            sink,
            seq: 0,
            dropped: 0,
            warned: false,
        })
    }

    /// Nothing more can come: the component is gone or made anew, or described itself without this event.
    fn is_over(&self) -> bool {
        self.instance.is_closed()
            || !event_of(&self.instance, &self.member).is_ok_and(|(cell, _)| Arc::ptr_eq(&cell, &self.cell))
    }

    fn drain(&mut self, path: &str, mut give: impl FnMut(Item)) {
        let dropped = self.tap.mailbox.stats().dropped;
        let mut skipped = dropped - self.dropped;
        self.dropped = dropped;
        let show = |head: EntryHead, payload: &[u8]| {
            self.seq += 1 + skipped;
            let value = match &self.ty {
                Some(ty) => decode(ty, &payload[..ty.size()]).unwrap_or_else(|e| {
                    if !std::mem::replace(&mut self.warned, true) {
                        let said = misfit(&self.instance, &e);
                        self.instance.warn(&format!("event {}: {said}; null is shown for it", self.member));
                    }
                    Value::Null
                }),
                None => Value::Null,
            };
            give(Item {
                path: path.to_owned(),
                kind: ItemKind::Event,
                value,
                stamp_ns: head.stamp_ns,
                seq: self.seq,
                skipped: std::mem::take(&mut skipped),
                jpeg: Vec::new(),
            });
        };
        self.tap.mailbox.drain(show, |_| ());
    }
}

/// Where an event is sent from now, and the type of its payload.
fn event_of(instance: &Instance, member: &MemberId) -> Result<(Arc<EventCell>, Option<Type>), Refusal> {
    let set = instance.described.now();
    let ports = &set.ports;
    let port = member.port.port.as_str();
    let Some(interface) = ports.provided.iter().position(|p| p.name == port) else {
        return Err(Refusal::InterfaceNotFound {
            port: member.port.clone(),
            known: ports.provided.iter().map(|p| p.name.clone()).collect(),
        });
    };
    // One name may be both: the read `operating_state` of an arm tells what its event of that name told last.
    let events = &ports.provided[interface].events;
    let Some(i) = events.iter().position(|e| e.name == member.member.as_str()) else {
        let commands = &ports.provided[interface].commands;
        if let Some(command) = commands.iter().find(|c| c.name == member.member.as_str()) {
            return Err(wrong_kind(member, format!("a {} command", command.kind.name()), "an event"));
        }
        return Err(Refusal::MemberNotFound {
            member: member.clone(),
            known: events.iter().map(|e| e.name.clone()).collect(),
        });
    };
    Ok((set.slots.event(ports.first_event(interface) + i).clone(), events[i].payload.clone()))
}

impl Drop for EventFeed {
    fn drop(&mut self) {
        self.cell.edit(|sinks| sinks.retain(|s| !Arc::ptr_eq(s, &self.sink)));
        self.instance.reclaim();
    }
}

/// What one selection follows.
enum Feed {
    State {
        instance: Arc<Instance>,
        news: broadcast::Receiver<News>,
    },
    Event(EventFeed),
    /// With how often it is looked at and the width of pictures, 0 = none.
    Output(Box<Output>, RateLimit, u32),
}

/// Opens every selection, or none, and follows them until the receiver is dropped.
pub(super) fn subscribe(lcm: &LocalLcm, selections: Vec<Selection>) -> Result<mpsc::Receiver<Item>, Refusal> {
    let feeds = selections
        .iter()
        .map(|s| open(lcm, s).map(|feed| (s.path.clone(), feed)))
        .collect::<Result<Vec<_>, _>>()?;
    let (tell, told) = mpsc::channel(ITEMS);
    for (path, feed) in feeds {
        tokio::spawn(follow(path, feed, Teller { tell: tell.clone(), lost: AtomicU64::new(0) }));
    }
    Ok(told)
}

fn open(lcm: &LocalLcm, selection: &Selection) -> Result<Feed, Refusal> {
    let path = selection.path.as_str();
    match path.split('/').count() {
        2 => {
            let news = lcm.news_receiver();
            Ok(Feed::State { instance: lcm.instance(&ComponentId::parse(path)?)?, news })
        }
        3 => {
            let port = PortId::parse(path)?;
            let rate = if selection.max_rate_hz > 0.0 { selection.max_rate_hz } else { DEFAULT_RATE_HZ };
            let width = selection.thumbnail_width;
            let most = if width > 0 { MOST_PICTURES_HZ } else { 1000.0 };
            let rate = RateLimit::new(rate.clamp(0.01, most));
            Ok(Feed::Output(Box::new(Output::open(lcm.instance(&port.component)?, &port)?), rate, width))
        }
        _ => {
            let member = MemberId::parse(path)?;
            Ok(Feed::Event(EventFeed::open(lcm.instance(&member.port.component)?, &member)?))
        }
    }
}

/// Hands items to the receiver; what a full channel cannot take is counted into the next one.
struct Teller {
    tell: mpsc::Sender<Item>,
    lost: AtomicU64,
}

impl Teller {
    fn give(&self, mut item: Item) {
        item.skipped += self.lost.swap(0, Ordering::Relaxed);
        let skipped = item.skipped;
        if self.tell.try_send(item).is_err() {
            self.lost.fetch_add(skipped + 1, Ordering::Relaxed);
        }
    }
}

async fn follow(path: String, feed: Feed, teller: Teller) {
    match feed {
        Feed::State { instance, mut news } => {
            // The present state first: whoever has it knows that nothing after it is missed.
            teller.give(standing(&path, &instance.report(false)));
            loop {
                tokio::select! {
                    () = teller.tell.closed() => return,
                    received = news.recv() => match received {
                        Ok(News::State(report)) if report.id == instance.id => teller.give(standing(&path, &report)),
                        Ok(_) => {}
                        Err(broadcast::error::RecvError::Lagged(n)) => {
                            teller.lost.fetch_add(n, Ordering::Relaxed);
                        }
                        Err(broadcast::error::RecvError::Closed) => return,
                    },
                }
            }
        }
        Feed::Event(mut feed) => {
            while !rest(&teller, LOOK).await {
                // Asked first: what it sent before its end is still given.
                let over = feed.is_over();
                feed.drain(&path, |item| teller.give(item));
                if over {
                    return;
                }
            }
        }
        Feed::Output(mut output, mut rate, width) => {
            // Items lie on a grid: a late timer or a long look slows nothing down.
            let mut pause = Duration::ZERO;
            while !rest(&teller, pause).await {
                if output.instance.is_closed() {
                    return;
                }
                let looked_ns = os::now_ns();
                let Some((back, newest)) = look(output, width).await else { return };
                output = back;
                pause = match &newest {
                    Ok(None) => LONGEST_PAUSE.min(Duration::from_nanos(rate.gap_ns())),
                    _ => {
                        rate.keep(looked_ns);
                        Duration::from_nanos(rate.due_ns().saturating_sub(os::now_ns()))
                    }
                };
                match newest {
                    Ok(Some((sample, skipped, jpeg))) => {
                        let mut value = sample.value;
                        if sample.frame_bytes > 0
                            && let Some(object) = value.as_object_mut()
                        {
                            object.insert("frame_bytes".into(), sample.frame_bytes.into());
                        }
                        teller.give(Item {
                            path: path.clone(),
                            kind: ItemKind::Stream,
                            value,
                            stamp_ns: sample.stamp_ns,
                            seq: sample.seq,
                            skipped,
                            jpeg,
                        });
                    }
                    Ok(None) => {}
                    Err(refusal) => log::error!("following {path}: {refusal}"),
                }
            }
        }
    }
}

type Look = Result<Option<(Sample, u64, Vec<u8>)>, Refusal>;

/// The newest sample with its picture, which is made on a thread for such work: it takes milliseconds, and other followers share
/// this one. The frame is held only while it is scaled. None when the process ends.
async fn look(mut output: Box<Output>, width: u32) -> Option<(Box<Output>, Look)> {
    if width == 0 {
        let newest = output
            .newest(Want::default())
            .map(|n| n.map(|(sample, skipped, _)| (sample, skipped, Vec::new())));
        return Some((output, newest));
    }
    let _turn = MAKING.acquire().await.ok()?;
    let make = move || {
        let newest = output.newest(Want { frame: false, width }).map(|newest| {
            newest.map(|(sample, skipped, image)| {
                (sample, skipped, image.as_ref().map(thumbnail::jpeg).unwrap_or_default())
            })
        });
        (output, newest)
    };
    tokio::task::spawn_blocking(make).await.ok()
}

/// A component's state as an item.
fn standing(path: &str, report: &Report) -> Item {
    Item {
        path: path.to_owned(),
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

/// Waits for the next look; true when the receiver is gone.
async fn rest(teller: &Teller, pause: Duration) -> bool {
    tokio::select! {
        () = teller.tell.closed() => true,
        () = tokio::time::sleep(pause) => false,
    }
}
