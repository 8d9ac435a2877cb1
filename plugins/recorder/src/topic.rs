//! One input while it is recorded: what comes by it, how that is encoded, what of it is kept, what was lost.
//!
//! Invariant: kept + left out + lost = sent by the source since the recording began, as far as its count tells.

use std::collections::BTreeMap;

use trocar_sdk::{AnyShape, AnyType, AnyView};

use crate::block::{Kind, Way};
use crate::compress;
use crate::foxglove::{self, Image, Shown};
use crate::orders::{Channel, Codec};
use crate::tap::Tap;
use crate::typed::{self, Typed};

/// What a frame takes beside its bytes when it is encoded.
const AROUND: usize = 512;

/// One input.
#[derive(Default)]
pub(crate) struct Topic {
    /// `/process/component/port`, or the input's own name as long as nothing is known.
    pub(crate) name: String,
    /// Which of them are kept: each n-th.
    pub(crate) every: u64,
    /// Least time between two that are kept, ns.
    pub(crate) gap_ns: u64,
    pub(crate) kept: u64,
    pub(crate) left_out: u64,
    pub(crate) lost: u64,
    pub(crate) bytes: u64,
    /// The connection the last sample came by; 0 = none.
    source: u64,
    seq: u64,
    last_kept_ns: u64,
    since_kept: u64,
    encoder: Option<Encoder>,
}

struct Encoder {
    how: How,
    /// Our numbers of the channels: one, or one for each image of a pair.
    channels: [u32; 2],
    size: usize,
}

enum How {
    Typed(Typed),
    Shown(Shown),
    /// Pixels that the writer compresses.
    Pixels(foxglove::ImagePlaces),
    /// Events or commands of a component, each member a topic of its own.
    Tap(Tap),
}

/// A sample as its input gave it.
pub(crate) struct Seen<'a> {
    pub(crate) value: &'a [u8],
    pub(crate) bytes: &'a [u8],
    pub(crate) stamp_ns: u64,
    pub(crate) seq: u64,
}

impl<'a> Seen<'a> {
    pub(crate) fn of(view: &'a AnyView<'_>) -> Seen<'a> {
        Seen { value: view.value(), bytes: view.bytes(), stamp_ns: view.stamp().ns(), seq: view.seq() }
    }
}

impl Topic {
    pub(crate) fn is_known(&self, source: u64) -> bool {
        self.source == source && self.encoder.is_some()
    }

    /// All but its name and what is kept of it.
    pub(crate) fn forget(&mut self) {
        let name = std::mem::take(&mut self.name);
        *self = Topic { name, every: self.every, gap_ns: self.gap_ns, ..Topic::default() };
    }

    /// Counts from here.
    pub(crate) fn begin(&mut self) {
        (self.kept, self.left_out, self.lost, self.bytes) = (0, 0, 0, 0);
        (self.last_kept_ns, self.since_kept) = (0, 0);
    }

    /// Another name, so other channels.
    pub(crate) fn rename(&mut self, name: &str) {
        if self.name != name {
            self.name = name.to_owned();
            self.encoder = None;
        }
    }

    /// Another connection: finds out what comes by it. `add` gives a channel its number.
    pub(crate) fn connected(
        &mut self,
        source: u64,
        description: &str,
        (codec, sample): (Codec, &Seen<'_>),
        add: &mut dyn FnMut(Channel) -> u32,
    ) {
        if self.source != source {
            self.seq = 0;
        }
        self.source = source;
        self.encoder = None;
        if let Some(tap) = Tap::of(description, &self.name, add) {
            self.encoder = Some(Encoder { size: sample.value.len(), how: How::Tap(tap), channels: [0, 0] });
            return;
        }
        let Ok(ty) = AnyType::of_port(description) else { return };
        if ty.size() != sample.value.len() {
            return;
        }
        let hash = typed::hash(description);
        let name = match ty.part().shape() {
            AnyShape::Struct { name, .. } => name,
            _ => "",
        };
        let typed = Typed::of(&ty, hash);
        let mut metadata: BTreeMap<String, String> = BTreeMap::from([
            ("trocar.type".to_owned(), description.to_owned()),
            ("trocar.type_hash".to_owned(), format!("{hash:016x}")),
        ]);
        for (path, unit) in &typed.units {
            metadata.insert(format!("unit:{path}"), unit.clone());
        }
        let mut channel = |topic: String, schema: &str, data: &[u8]| {
            add(Channel {
                topic,
                schema: schema.to_owned(),
                schema_encoding: "protobuf",
                schema_data: data.to_vec(),
                encoding: "protobuf",
                metadata: metadata.clone(),
            })
        };
        let shown = Shown::of(&ty, name).filter(|shown| match shown {
            // A format no viewer has a word for is kept as what it is.
            Shown::Image(places) => places.images(sample.value, sample.bytes).is_some(),
            _ => true,
        });
        let (how, channels) = match shown {
            None => {
                let id = channel(self.name.clone(), &typed.name, &typed.descriptors);
                (How::Typed(typed), [id, id])
            }
            Some(shown) => {
                let mut schema = shown.schema();
                let encoding = match &shown {
                    Shown::Image(places) => places
                        .images(sample.value, sample.bytes)
                        .and_then(|[first, _]| first)
                        .map_or("", |image| image.encoding),
                    _ => "",
                };
                let compressed = compress::takes(codec, encoding);
                if compressed {
                    schema = foxglove::compressed_image();
                }
                let channels = if shown.images() == 2 {
                    ["left", "right"]
                        .map(|eye| channel(format!("{}/{eye}", self.name), schema.name, &schema.descriptors))
                } else {
                    let id = channel(self.name.clone(), schema.name, &schema.descriptors);
                    [id, id]
                };
                let how = match shown {
                    Shown::Image(places) if compressed => How::Pixels(places),
                    shown => How::Shown(shown),
                };
                (how, channels)
            }
        };
        self.encoder = Some(Encoder { how, channels, size: ty.size() });
    }

    /// Looks at a sample that is not recorded, so that what came before a recording is no loss of it.
    pub(crate) fn pass(&mut self, seen: &Seen<'_>) {
        self.seq = seen.seq;
    }

    /// Keeps a sample, unless it is to be left out or there is no room.
    pub(crate) fn take(&mut self, seen: &Seen<'_>, now_ns: u64, way: &mut Way) {
        if self.seq != 0 && seen.seq > self.seq {
            self.lost += seen.seq - self.seq - 1;
        }
        self.seq = seen.seq;
        self.since_kept += 1;
        let stamp_ns = if seen.stamp_ns == 0 { now_ns } else { seen.stamp_ns };
        let soon = self.last_kept_ns != 0 && stamp_ns < self.last_kept_ns.saturating_add(self.gap_ns);
        if self.last_kept_ns != 0 && (self.since_kept < self.every || soon) {
            self.left_out += 1;
            return;
        }
        let Some(encoder) = &self.encoder else {
            self.lost += 1;
            return;
        };
        let needed = seen.bytes.len() + 2 * seen.value.len() + AROUND;
        if seen.value.len() != encoder.size || !way.has_room(needed) {
            self.lost += 1;
            return;
        }
        let before = way.block().len();
        if encoder.write(seen, now_ns, stamp_ns, way) {
            self.kept += 1;
            self.bytes += (way.block().len().saturating_sub(before)) as u64;
            (self.last_kept_ns, self.since_kept) = (stamp_ns.max(1), 0);
        } else {
            self.lost += 1;
        }
    }
}

impl Encoder {
    fn write(&self, seen: &Seen<'_>, now_ns: u64, stamp_ns: u64, way: &mut Way) -> bool {
        let head = |channel: u32| (channel, seen.seq, now_ns, stamp_ns);
        let [first, second] = self.channels;
        match &self.how {
            How::Typed(typed) => {
                way.block().push(head(first), Kind::Ready, |to| typed.encode(seen.value, seen.bytes, to));
            }
            How::Tap(tap) => return tap.write(seen, (now_ns, stamp_ns), way),
            How::Shown(Shown::Pose(places)) => {
                way.block().push(head(first), Kind::Ready, |to| places.encode(seen.value, stamp_ns, to));
            }
            How::Shown(Shown::Joints(places)) => {
                way.block().push(head(first), Kind::Ready, |to| places.encode(seen.value, stamp_ns, to));
            }
            How::Shown(Shown::Image(places)) | How::Pixels(places) => {
                let Some(images) = places.images(seen.value, seen.bytes) else { return false };
                let compress = matches!(self.how, How::Pixels(_));
                for (image, channel) in images.iter().flatten().zip([first, second]) {
                    push_image(image, head(channel), compress, stamp_ns, way);
                }
            }
        }
        true
    }
}

fn push_image(image: &Image<'_>, head: (u32, u64, u64, u64), compress: bool, stamp_ns: u64, way: &mut Way) {
    if compress {
        let Image { width, height, stride, encoding, bytes } = *image;
        let kind = Kind::Pixels { width, height, stride, encoding };
        way.block().push(head, kind, |to| to.extend_from_slice(bytes));
    } else {
        way.block().push(head, Kind::Ready, |to| image.encode(stamp_ns, to));
    }
}
