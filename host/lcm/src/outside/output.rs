//! An output for all readers outside: one reader, whose samples they share.
//!
//! Invariant: a frame is held only while it is copied or scaled, for all who want it; never by a thread that
//! steps.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use parking_lot::{Mutex, MutexGuard};
use serde_json::Value;
use tokio::sync::Semaphore;
use trocar_lcm_api::{Eye, Sample};
use trocar_loader::convert::back;
use trocar_model::{PortId, PortType, Ports, Refusal, Type};
use trocar_rt::os;
use trocar_rt::stream::{Meta, Payload, Queue, StreamReader, stream_link};

use super::super::boundary::{Consumer, OUTSIDE, OutCell, OutLink};
use super::super::instance::Instance;
use super::super::thumbnail;
use super::{Shows, shown};

/// Most bytes of a frame that are handed out: a message of the GCM holds somewhat more.
const MOST_FRAME_BYTES: usize = 24 << 20;
/// Limits the outputs whose pictures are made at once: a page full of them takes no more of the machine than
/// this.
static MAKING: Semaphore = Semaphore::const_new(2);

/// Part of a sample that a reader wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Want {
    Value,
    /// Also the image in its frame, so many pixels wide, as an eye sees it.
    Picture(u32, Eye),
    /// Also all bytes of its frame.
    Frame,
}

/// A reader of an output.
pub(super) struct Output {
    shared: Arc<SharedOutput>,
    want: Want,
    /// Number of the last sample written before this reader came.
    before_seq: u64,
    /// Numbers of the last sample given to this reader, at the shared reader and at the output; 0 = none yet.
    look: u64,
    last_seq: u64,
}

/// The output, read once for all readers outside. Readers that want frames share a link of their own, which
/// is read at their rates alone.
pub(super) struct SharedOutput {
    pub(super) instance: Arc<Instance>,
    /// Name of the port.
    name: String,
    cell: Arc<OutCell>,
    ty: Type,
    link: Arc<OutLink>,
    of_frames: bool,
    /// Wanted parts of each sample, and the number of readers for each.
    wants: Mutex<BTreeMap<Want, usize>>,
    reader: Arc<tokio::sync::Mutex<Reader>>,
}

struct Reader {
    stream: StreamReader,
    looks: u64,
    newest: Option<Arc<Shown>>,
}

/// A sample as it is handed out.
pub(super) struct Shown {
    look: u64,
    pub(super) meta: Meta,
    pub(super) value: Result<Value, Refusal>,
    encoded: Vec<u8>,
    pub(super) frame_bytes: u64,
    /// Present if a reader wanted it.
    frame: Option<Vec<u8>>,
    /// JPEGs by width and eye, if a reader wanted one; empty where the frame is no image.
    pictures: BTreeMap<(u32, Eye), Vec<u8>>,
}

impl Output {
    pub(super) fn open(lcm: &impl Shows, port: &PortId, want: Want) -> Result<Output, Refusal> {
        let instance = lcm.component(&port.component)?;
        let cell = cell_of(&instance, port)?;
        let Some(passing) = cell.passing() else {
            return Err(Refusal::NotImplemented {
                what: format!("reading the untyped output {port} while nothing is connected to it"),
                hint: "connect it to a typed input first: it takes that type".into(),
            });
        };
        let of_frames = want != Want::Value && matches!(passing, PortType::Frame { .. });
        let key = (instance.number, port.port.to_string(), of_frames);
        let holds = |shared: &SharedOutput| Arc::ptr_eq(&shared.cell, &cell) && cell.has(&shared.link);
        let make = || SharedOutput::open(instance.clone(), port, &cell, &passing, of_frames).map(Arc::new);
        let shared = lcm.outside().outputs.join(key, holds, make)?;
        *shared.wants().entry(want).or_default() += 1;
        let before_seq = cell.seq.load(Ordering::Relaxed);
        Ok(Output { shared, want, before_seq, look: 0, last_seq: 0 })
    }

    pub(super) fn shared(&self) -> &SharedOutput {
        &self.shared
    }

    /// The newest sample that this reader was not given yet, and how many were left out before it. `None`
    /// when the process ends.
    pub(super) async fn newest(&mut self) -> Option<Option<(Arc<Shown>, u64)>> {
        let newest = self.shared.look().await?;
        let is_new = |shown: &Arc<Shown>| {
            shown.look > self.look && shown.meta.seq > self.before_seq && shown.has(self.want)
        };
        Some(newest.filter(is_new).map(|shown| {
            let before = std::mem::replace(&mut self.last_seq, shown.meta.seq);
            self.look = shown.look;
            // Numbers do not advance where a component writes from two threads at once.
            let skipped = if before == 0 { 0 } else { shown.meta.seq.saturating_sub(before + 1) };
            (shown, skipped)
        }))
    }

    /// The wanted picture of a sample; empty if none is wanted, or if it is no image.
    pub(super) fn picture(&self, shown: &Shown) -> Vec<u8> {
        match self.want {
            Want::Picture(width, eye) => shown.pictures.get(&(width, eye)).cloned().unwrap_or_default(),
            Want::Value | Want::Frame => Vec::new(),
        }
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        let mut wants = self.shared.wants();
        if let Some(n) = wants.get_mut(&self.want) {
            *n -= 1;
        }
        wants.retain(|_, n| *n > 0);
    }
}

impl SharedOutput {
    fn open(
        instance: Arc<Instance>,
        port: &PortId,
        cell: &Arc<OutCell>,
        passing: &PortType,
        of_frames: bool,
    ) -> Result<SharedOutput, Refusal> {
        let (ty, payload) = match passing {
            PortType::Frame { header, .. } => (header.clone(), Payload::Frame),
            PortType::Plain(ty) => (ty.clone(), Payload::Plain { bytes: ty.size() }),
            PortType::Any => return Err(Refusal::Internal { text: format!("{port} passes no type") }),
        };
        let (writer, stream) = stream_link(payload, Queue::Latest);
        let link = Arc::new(OutLink::new(OUTSIDE, writer, Consumer::Outside, true));
        cell.add(link.clone(), passing, &back::port(passing).into());
        let reader = Arc::new(tokio::sync::Mutex::new(Reader { stream, looks: 0, newest: None }));
        let (name, cell) = (port.port.to_string(), cell.clone());
        Ok(SharedOutput { instance, name, cell, ty, link, of_frames, wants: Mutex::default(), reader })
    }

    fn wants(&self) -> MutexGuard<'_, BTreeMap<Want, usize>> {
        self.wants.lock()
    }

    /// The newest sample that any reader has looked at. Pictures are made on a thread for such work: they
    /// take milliseconds, and other followers share this one. `None` when the process ends.
    async fn look(self: &Arc<Self>) -> Option<Option<Arc<Shown>>> {
        let mut reader = self.reader.clone().lock_owned().await;
        if !reader.stream.latest().is_some_and(|sample| sample.fresh) {
            return Some(reader.newest.clone());
        }
        if !self.of_frames {
            return Some(reader.take(self));
        }
        let _turn = MAKING.acquire().await.ok()?;
        let shared = self.clone();
        tokio::task::spawn_blocking(move || reader.take(&shared)).await.ok()
    }
}

impl Drop for SharedOutput {
    fn drop(&mut self) {
        self.cell.remove(|l| Arc::ptr_eq(l, &self.link));
        self.instance.reclaim();
    }
}

impl Reader {
    /// Takes the new sample, with all parts that any reader wants.
    fn take(&mut self, shared: &SharedOutput) -> Option<Arc<Shown>> {
        let wants: Vec<Want> = shared.wants().keys().copied().collect();
        let sample = self.stream.current()?;
        self.looks += 1;
        let value = shown(&shared.instance, "show an output", &shared.ty, sample.data);
        let mut frame = None;
        let mut images = Vec::new();
        for want in wants {
            match want {
                Want::Frame if sample.bytes.len() <= MOST_FRAME_BYTES => frame = Some(sample.bytes.to_vec()),
                Want::Picture(width, eye) => {
                    let small = |v| thumbnail::small(v, sample.bytes, width, eye);
                    images.push(((width, eye), value.as_ref().ok().and_then(small)));
                }
                Want::Value | Want::Frame => {}
            }
        }
        let (meta, encoded) = (sample.meta, sample.data.to_vec());
        let frame_bytes = sample.bytes.len() as u64;
        self.stream.release();
        let jpeg = |image: Option<_>| image.as_ref().map(thumbnail::jpeg).unwrap_or_default();
        let pictures = images.into_iter().map(|(wanted, image)| (wanted, jpeg(image))).collect();
        let look = self.looks;
        self.newest = Some(Arc::new(Shown { look, meta, value, encoded, frame_bytes, frame, pictures }));
        self.newest.clone()
    }
}

impl Shown {
    /// False for a sample taken before a reader wanted that part.
    fn has(&self, want: Want) -> bool {
        match want {
            Want::Value => true,
            Want::Picture(width, eye) => self.pictures.contains_key(&(width, eye)),
            Want::Frame => self.frame.is_some() || self.is_too_large(),
        }
    }

    fn is_too_large(&self) -> bool {
        self.frame_bytes > MOST_FRAME_BYTES as u64
    }

    /// The sample for a caller that reads once.
    ///
    /// # Errors
    /// The bytes are no value of their type; or the frame is larger than can be handed out, and the caller
    /// wanted the frame.
    pub(super) fn sample(&self, of: &SharedOutput) -> Result<Sample, Refusal> {
        if of.of_frames && self.frame.is_none() && self.is_too_large() {
            return Err(Refusal::ArgumentInvalid {
                what: format!("Read {}/{}", of.instance.id, of.name),
                why: format!(
                    "its frames have {} bytes, and at most {MOST_FRAME_BYTES} are handed out: follow it with a thumbnail_width",
                    self.frame_bytes
                ),
                field: "frame".into(),
            });
        }
        Ok(Sample {
            value: self.value.clone()?,
            encoded: self.encoded.clone(),
            stamp_ns: self.meta.stamp_ns,
            age_ns: os::now_ns().saturating_sub(self.meta.stamp_ns),
            seq: self.meta.seq,
            frame_bytes: self.frame_bytes,
            frame: self.frame.clone().unwrap_or_default(),
        })
    }
}

fn cell_of(instance: &Instance, port: &PortId) -> Result<Arc<OutCell>, Refusal> {
    let set = instance.described.now();
    let ports = &set.ports;
    if let Some(index) = ports.outputs.iter().position(|o| o.name == port.port.as_str()) {
        return Ok(set.slots.output(index).clone());
    }
    if let Some(what) = no_output(ports, port.port.as_str()) {
        let outputs: Vec<&str> = ports.own_outputs().map(|o| o.name.as_str()).collect();
        let there = if outputs.is_empty() { "none".to_owned() } else { outputs.join(", ") };
        return Err(Refusal::ArgumentInvalid {
            what: format!("Read {port}"),
            why: format!("it is {what}, and only outputs can be read; outputs there: {there}"),
            field: "path".into(),
        });
    }
    Err(Refusal::InterfaceNotFound {
        port: port.clone(),
        known: ports.own_outputs().map(|o| o.name.clone()).collect(),
    })
}

/// The kind of the port of that name, if it is a port but no output.
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
