//! The encoding of one input's samples: as messages that viewers know, or as messages of their own type.
//!
//! Invariant: a sample is encoded by the type of its connection, or not at all.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use trocar_sdk::{AnyShape, AnyType};

use crate::block::{HeldPart, Kind, Piece};
use crate::compress;
use crate::foxglove::{self, Image, Shown};
use crate::orders::{Channel, Codec};
use crate::seen::Seen;
use crate::tap::Tap;
use crate::typed::{self, Typed};
use crate::way::Way;

/// Encodes the samples of one input, by the type of the connection they come by.
pub(crate) struct Encoder {
    how: How,
    /// Our numbers of the channels: one, or one for each image of a pair.
    channels: [u32; 2],
    /// Bytes of a sample's value.
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

/// The bytes of a frame, and the frame if it is held.
pub(crate) struct Frame<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) held: Option<Arc<HeldPart>>,
}

impl<'a> Frame<'a> {
    fn piece(&self, range: Range<usize>) -> Piece<'a> {
        match &self.held {
            Some(part) => Piece::Held(part.clone(), range),
            None => Piece::Copied(&self.bytes[range]),
        }
    }
}

impl Encoder {
    /// Returns none where the description is none of a type, or another one's than that of `sample`. `add`
    /// gives a channel its number.
    pub(crate) fn of(
        description: &str,
        topic: &str,
        (codec, sample): (Codec, &Seen<'_>),
        add: &mut dyn FnMut(Channel) -> u32,
    ) -> Option<Encoder> {
        let size = sample.value.len();
        if let Some(tap) = Tap::of(description, topic, add) {
            return Some(Encoder { size, how: How::Tap(tap), channels: [0, 0] });
        }
        let ty = AnyType::of_port(description).ok().filter(|ty| ty.size() == size)?;
        let hash = typed::hash(description);
        let name = match ty.part().shape() {
            AnyShape::Struct { name, .. } => name,
            _ => "",
        };
        let typed = Typed::of(&ty, hash);
        let metadata = metadata(description, hash, &typed);
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
        let shown =
            Shown::of(&ty, name, &foxglove::frame_id(description, name)).filter(|shown| match shown {
                // A format without a name in viewers is kept as it is.
                Shown::Image(places) => places.images(sample.value, sample.bytes).is_some(),
                _ => true,
            });
        let (how, channels) = match shown {
            None => {
                let id = channel(topic.to_owned(), &typed.name, &typed.descriptors);
                (How::Typed(typed), [id, id])
            }
            Some(shown) => as_shown(shown, topic, (codec, sample), &mut channel),
        };
        Some(Encoder { how, channels, size })
    }

    /// Bytes of the values that it encodes.
    pub(crate) fn size(&self) -> usize {
        self.size
    }

    /// Encodes a sample and returns the number of bytes; none if the sample is not what its type says.
    pub(crate) fn write(
        &self,
        seen: &Seen<'_>,
        frame: &Frame<'_>,
        (now_ns, stamp_ns): (u64, u64),
        way: &mut Way,
    ) -> Option<usize> {
        let head = |channel: u32| (channel, seen.seq, now_ns, stamp_ns);
        let [first, second] = self.channels;
        let value = seen.value;
        Some(match &self.how {
            How::Typed(typed) => {
                let len = frame.bytes.len();
                let write = |to: &mut Vec<u8>| typed.encode(value, len, to);
                way.block().push_with(head(first), Kind::Ready, write, frame.piece(0..len))
            }
            How::Tap(tap) => return tap.write(seen, (now_ns, stamp_ns), way),
            How::Shown(Shown::Pose(places, frame_id)) => {
                way.block().push(head(first), Kind::Ready, |to| places.encode(value, frame_id, stamp_ns, to))
            }
            How::Shown(Shown::Transform(places)) => {
                way.block().push(head(first), Kind::Ready, |to| places.encode(value, stamp_ns, to))
            }
            How::Shown(Shown::Joints(places)) => {
                way.block().push(head(first), Kind::Ready, |to| places.encode(value, stamp_ns, to))
            }
            How::Shown(Shown::Image(places)) | How::Pixels(places) => {
                let images = places.images(value, frame.bytes)?;
                let compress = matches!(self.how, How::Pixels(_));
                let each = images.iter().flatten().zip([first, second]);
                each.map(|(image, channel)| {
                    let piece = frame.piece(image.at..image.at + image.bytes.len());
                    push_image(image, piece, head(channel), compress, way)
                })
                .sum()
            }
        })
    }
}

/// Metadata of a channel: the type as the host describes it, and the units by path.
fn metadata(description: &str, hash: u64, typed: &Typed) -> BTreeMap<String, String> {
    let own = [("trocar.type", description.to_owned()), ("trocar.type_hash", format!("{hash:016x}"))];
    let units = typed.units.iter().map(|(path, unit)| (format!("unit:{path}"), unit.clone()));
    own.into_iter().map(|(key, value)| (key.to_owned(), value)).chain(units).collect()
}

/// Encodes as a message that viewers know, with a topic for each image of a pair; images are compressed where
/// the codec takes their pixels.
fn as_shown(
    shown: Shown,
    topic: &str,
    (codec, sample): (Codec, &Seen<'_>),
    channel: &mut dyn FnMut(String, &str, &[u8]) -> u32,
) -> (How, [u32; 2]) {
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
        ["left", "right"].map(|eye| channel(format!("{topic}/{eye}"), schema.name, &schema.descriptors))
    } else {
        let id = channel(topic.to_owned(), schema.name, &schema.descriptors);
        [id, id]
    };
    let how = match shown {
        Shown::Image(places) if compressed => How::Pixels(places),
        shown => How::Shown(shown),
    };
    (how, channels)
}

/// `head`: with the image's stamp last.
fn push_image(
    image: &Image<'_>,
    piece: Piece<'_>,
    head: (u32, u64, u64, u64),
    compress: bool,
    way: &mut Way,
) -> usize {
    if compress {
        let Image { width, height, stride, encoding, .. } = *image;
        way.block().push_with(head, Kind::Pixels { width, height, stride, encoding }, |_| (), piece)
    } else {
        way.block().push_with(head, Kind::Ready, |to| image.encode(head.3, to), piece)
    }
}
