//! Samples as messages of Foxglove's schemas, where one fits, so that viewers know what they see.
//!
//! Invariant: names and field numbers are those of the published schemas; a sample that does not hold what
//! its header says gives no message, never a wrong one.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet, OneofDescriptorProto,
};
use trocar_sdk::serde_json::Value as Json;
use trocar_sdk::{AnyType, Place};

use crate::wire;

/// A schema as MCAP takes it.
pub(crate) struct Schema {
    pub(crate) name: &'static str,
    pub(crate) descriptors: Vec<u8>,
}

/// Message that a sample becomes.
pub(crate) enum Shown {
    Image(ImagePlaces),
    /// And the frame it is in, empty where its output names none.
    Pose(PosePlaces, String),
    Transform(TransformPlaces),
    Joints(JointPlaces),
}

pub(crate) struct ImagePlaces {
    width: Place,
    height: Place,
    stride: Place,
    format: Place,
    /// Begin of the right image of a pair.
    right: Option<Place>,
}

pub(crate) struct PosePlaces {
    position: [Place; 3],
    orientation: [Place; 4],
}

/// A pose, and the bytes at which the names of two frames begin: of the one it is told in, and of the one it
/// places.
pub(crate) struct TransformPlaces {
    pose: PosePlaces,
    names: [usize; 2],
    room: usize,
}

/// Bytes at which the three lists begin, and how many each has room for.
pub(crate) struct JointPlaces {
    lists: [usize; 3],
    room: usize,
}

/// One image of a frame, as its header describes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Image<'a> {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Bytes from one row to the next.
    pub(crate) stride: u32,
    /// As Foxglove calls it.
    pub(crate) encoding: &'static str,
    pub(crate) bytes: &'a [u8],
    /// Place in the frame at which they begin.
    pub(crate) at: usize,
}

impl Shown {
    /// Returns the schema for samples of this type, with coordinates in this frame; none if no schema fits.
    pub(crate) fn of(ty: &AnyType, struct_name: &str, frame_id: &str) -> Option<Shown> {
        let place = |path: &str| ty.place(path);
        match (ty.format(), struct_name) {
            (Some("image" | "stereo"), _) => Some(Shown::Image(ImagePlaces {
                width: place("width")?,
                height: place("height")?,
                stride: place("stride")?,
                format: place("format")?,
                right: place("right_offset"),
            })),
            (None, "Pose") => Some(Shown::Pose(PosePlaces::of(ty, "")?, frame_id.to_owned())),
            (None, "Transform") => Some(Shown::Transform(TransformPlaces::of(ty)?)),
            (None, "JointState") => Some(Shown::Joints(joint_places(ty)?)),
            _ => None,
        }
    }

    pub(crate) fn schema(&self) -> Schema {
        match self {
            Shown::Image(_) => raw_image(),
            Shown::Pose(..) => pose_in_frame(),
            Shown::Transform(_) => frame_transform(),
            Shown::Joints(_) => joint_states(),
        }
    }

    /// Returns the number of images in each sample, 1 for everything else.
    pub(crate) fn images(&self) -> usize {
        if matches!(self, Shown::Image(ImagePlaces { right: Some(_), .. })) { 2 } else { 1 }
    }
}

/// Returns the frame in which a described struct has its coordinates: the first that one of its fields names,
/// empty without.
pub(crate) fn frame_id(description: &str, struct_name: &str) -> String {
    let described: Json = trocar_sdk::serde_json::from_str(description).unwrap_or_default();
    let types = described["types"].as_array().into_iter().flatten();
    let fields = types.filter(|ty| ty["name"] == struct_name).flat_map(|ty| ty["fields"].as_array());
    let frame = fields.flatten().find_map(|field| field["frame"].as_str());
    frame.unwrap_or_default().to_owned()
}

fn joint_places(ty: &AnyType) -> Option<JointPlaces> {
    use trocar_sdk::AnyShape::{List, Number, Struct};
    let Struct { fields, .. } = ty.part().shape() else { return None };
    let list = |name: &str| {
        let f = fields.iter().find(|f| f.name == name)?;
        let List { item, n } = f.part.shape() else { return None };
        matches!(item.shape(), Number("f64")).then_some((f.at, n))
    };
    let (position, velocity, effort) = (list("position")?, list("velocity")?, list("effort")?);
    Some(JointPlaces {
        lists: [position.0, velocity.0, effort.0],
        room: position.1.min(velocity.1).min(effort.1),
    })
}

/// Returns Foxglove's name for a pixel format of ours; none if it has none.
fn encoding(format: u32) -> Option<(&'static str, usize)> {
    Some(match format {
        1 => ("mono8", 1),
        2 => ("rgb8", 3),
        3 => ("bgr8", 3),
        4 => ("rgba8", 4),
        5 => ("mono16", 2),
        6 => ("bayer_rggb8", 1),
        7 => ("yuyv", 2),
        8 => ("16SC1", 2),
        9 => ("32FC1", 4),
        _ => return None,
    })
}

impl ImagePlaces {
    /// The images of a frame; none where its bytes do not hold what the header says.
    pub(crate) fn images<'a>(&self, header: &[u8], frame: &'a [u8]) -> Option<[Option<Image<'a>>; 2]> {
        let whole = |place: &Place| place.number(header).map(|n| n as u64);
        let (width, height) = (whole(&self.width)?, whole(&self.height)?);
        let (stride, format) = (whole(&self.stride)?, whole(&self.format)?);
        let (encoding, pixel) = encoding(u32::try_from(format).ok()?)?;
        let row = width.checked_mul(pixel as u64)?;
        if width == 0 || height == 0 || stride < row {
            return None;
        }
        let len = (height - 1).checked_mul(stride)?.checked_add(row)?;
        let one = |at: u64| {
            let at = usize::try_from(at).ok()?;
            let bytes = frame.get(at..at.checked_add(usize::try_from(len).ok()?)?)?;
            let number = |n| u32::try_from(n).ok();
            Some(Image {
                width: number(width)?,
                height: number(height)?,
                stride: number(stride)?,
                encoding,
                bytes,
                at,
            })
        };
        let first = one(0)?;
        let second = match &self.right {
            Some(right) => Some(one(whole(right)?)?),
            None => None,
        };
        Some([Some(first), second])
    }
}

impl Image<'_> {
    /// Encodes a `foxglove.RawImage` that the image's own bytes have to follow: rows stay as far apart as
    /// they are.
    pub(crate) fn encode(&self, stamp_ns: u64, to: &mut Vec<u8>) {
        wire::timestamp(to, 1, stamp_ns);
        wire::fixed32(to, 2, self.width);
        wire::fixed32(to, 3, self.height);
        wire::bytes(to, 4, self.encoding.as_bytes());
        wire::fixed32(to, 5, self.stride);
        wire::bytes_follow(to, 6, self.bytes.len());
    }
}

/// A `foxglove.CompressedImage`.
pub(crate) fn compressed(stamp_ns: u64, format: &str, data: &[u8], to: &mut Vec<u8>) {
    wire::timestamp(to, 1, stamp_ns);
    wire::bytes(to, 2, data);
    wire::bytes(to, 3, format.as_bytes());
}

impl PosePlaces {
    /// Returns the places of the pose below this path.
    fn of(ty: &AnyType, path: &str) -> Option<PosePlaces> {
        let place = |name: &str, n: usize| ty.place(&format!("{path}{name}/{n}"));
        let position = [0, 1, 2].map(|n| place("position", n));
        let orientation = [0, 1, 2, 3].map(|n| place("orientation", n));
        let ([Some(x), Some(y), Some(z)], [Some(i), Some(j), Some(k), Some(w)]) = (position, orientation)
        else {
            return None;
        };
        Some(PosePlaces { position: [x, y, z], orientation: [i, j, k, w] })
    }

    /// A `foxglove.PoseInFrame`.
    pub(crate) fn encode(&self, value: &[u8], frame_id: &str, stamp_ns: u64, to: &mut Vec<u8>) {
        wire::timestamp(to, 1, stamp_ns);
        wire::bytes(to, 2, frame_id.as_bytes());
        wire::message(to, 3, |to| self.encode_parts(value, 1, to));
    }

    /// Position and orientation as fields of these numbers, the second the one behind the first.
    fn encode_parts(&self, value: &[u8], number: u32, to: &mut Vec<u8>) {
        let all = |places: &[Place], to: &mut Vec<u8>| {
            for (n, place) in places.iter().enumerate() {
                wire::double(to, n as u32 + 1, place.number(value).unwrap_or(f64::NAN));
            }
        };
        wire::message(to, number, |to| all(&self.position, to));
        wire::message(to, number + 1, |to| all(&self.orientation, to));
    }
}

impl TransformPlaces {
    fn of(ty: &AnyType) -> Option<TransformPlaces> {
        use trocar_sdk::AnyShape::{Struct, Text};
        let Struct { fields, .. } = ty.part().shape() else { return None };
        let text = |name: &str| {
            let field = fields.iter().find(|field| field.name == name)?;
            let Text { n } = field.part.shape() else { return None };
            Some((field.at, n))
        };
        let (parent, child) = (text("parent")?, text("child")?);
        let room = parent.1.min(child.1);
        Some(TransformPlaces { pose: PosePlaces::of(ty, "pose/")?, names: [parent.0, child.0], room })
    }

    /// A `foxglove.FrameTransform`.
    pub(crate) fn encode(&self, value: &[u8], stamp_ns: u64, to: &mut Vec<u8>) {
        wire::timestamp(to, 1, stamp_ns);
        for (at, number) in self.names.iter().zip([2, 3]) {
            let text = value.get(at + 8..at + 8 + length(value, *at, self.room)).unwrap_or_default();
            // A name that is no text is none: the message would be none, too.
            wire::bytes(to, number, str::from_utf8(text).unwrap_or_default().as_bytes());
        }
        self.pose.encode_parts(value, 4, to);
    }
}

/// The length that begins here of a list or a text, at most `room`.
fn length(value: &[u8], at: usize, room: usize) -> usize {
    let bytes = value.get(at..at + 8).and_then(|b| b.first_chunk::<8>());
    bytes.map_or(0, |b| u64::from_le_bytes(*b).min(room as u64) as usize)
}

impl JointPlaces {
    /// A `foxglove.JointStates`.
    pub(crate) fn encode(&self, value: &[u8], stamp_ns: u64, to: &mut Vec<u8>) {
        let len = |at: usize| length(value, at, self.room);
        let item = |at: usize, n: usize| {
            let at = at + 8 + 8 * n;
            (value.get(at..at + 8)?).first_chunk::<8>().map(|b| f64::from_le_bytes(*b))
        };
        wire::timestamp(to, 1, stamp_ns);
        let joints = self.lists.iter().map(|at| len(*at)).max().unwrap_or(0);
        for joint in 0..joints {
            wire::message(to, 2, |to| {
                wire::message(to, 1, |to| {
                    to.extend_from_slice(b"joint_");
                    if joint >= 10 {
                        to.push(b'0' + (joint / 10 % 10) as u8);
                    }
                    to.push(b'0' + (joint % 10) as u8);
                });
                for (at, field) in self.lists.iter().zip([2, 3, 5]) {
                    if joint < len(*at)
                        && let Some(number) = item(*at, joint)
                    {
                        wire::double(to, field, number);
                    }
                }
            });
        }
    }
}

/// A `foxglove.Log` line of level INFO.
pub(crate) fn log_line(stamp_ns: u64, text: &str, who: &str) -> Vec<u8> {
    let mut to = Vec::new();
    wire::timestamp(&mut to, 1, stamp_ns);
    wire::number(&mut to, 2, 2);
    wire::bytes(&mut to, 3, text.as_bytes());
    wire::bytes(&mut to, 4, who.as_bytes());
    to
}

// ---- descriptors

fn field(name: &str, number: i32, kind: Type, of: &str) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.into()),
        number: Some(number),
        label: Some(Label::Optional as i32),
        r#type: Some(kind as i32),
        type_name: (!of.is_empty()).then(|| format!(".{of}")),
        ..FieldDescriptorProto::default()
    }
}

/// Fields with their numbers, behind the time that each of these messages begins with.
fn stamped(others: &[(&str, i32, Type, &str)]) -> Vec<FieldDescriptorProto> {
    let time = [("timestamp", 1, Type::Message, STAMP)];
    time.iter().chain(others).map(|(name, number, kind, of)| field(name, *number, *kind, of)).collect()
}

fn message(name: &str, fields: Vec<FieldDescriptorProto>) -> DescriptorProto {
    DescriptorProto { name: Some(name.into()), field: fields, ..DescriptorProto::default() }
}

fn timestamp_file() -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some("google/protobuf/timestamp.proto".into()),
        package: Some("google.protobuf".into()),
        message_type: vec![message(
            "Timestamp",
            vec![field("seconds", 1, Type::Int64, ""), field("nanos", 2, Type::Int32, "")],
        )],
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    }
}

const STAMP: &str = "google.protobuf.Timestamp";

fn schema(name: &'static str, messages: Vec<DescriptorProto>) -> Schema {
    let short = name.rsplit('.').next().unwrap_or(name);
    let file = FileDescriptorProto {
        name: Some(format!("foxglove/{short}.proto")),
        package: Some("foxglove".into()),
        dependency: vec!["google/protobuf/timestamp.proto".into()],
        message_type: messages,
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    };
    Schema { name, descriptors: FileDescriptorSet { file: vec![timestamp_file(), file] }.encode_to_vec() }
}

pub(crate) fn raw_image() -> Schema {
    let fields = stamped(&[
        ("width", 2, Type::Fixed32, ""),
        ("height", 3, Type::Fixed32, ""),
        ("encoding", 4, Type::String, ""),
        ("step", 5, Type::Fixed32, ""),
        ("data", 6, Type::Bytes, ""),
        ("frame_id", 7, Type::String, ""),
    ]);
    schema("foxglove.RawImage", vec![message("RawImage", fields)])
}

pub(crate) fn compressed_image() -> Schema {
    let fields = stamped(&[
        ("data", 2, Type::Bytes, ""),
        ("format", 3, Type::String, ""),
        ("frame_id", 4, Type::String, ""),
    ]);
    schema("foxglove.CompressedImage", vec![message("CompressedImage", fields)])
}

/// Descriptors of the parts of a pose.
fn vector_and_quaternion() -> [DescriptorProto; 2] {
    let numbers = |names: &[&str]| {
        names.iter().enumerate().map(|(n, name)| field(name, n as i32 + 1, Type::Double, "")).collect()
    };
    [message("Vector3", numbers(&["x", "y", "z"])), message("Quaternion", numbers(&["x", "y", "z", "w"]))]
}

fn pose_in_frame() -> Schema {
    let [vector, quaternion] = vector_and_quaternion();
    let pose = vec![
        field("position", 1, Type::Message, "foxglove.Vector3"),
        field("orientation", 2, Type::Message, "foxglove.Quaternion"),
    ];
    let fields = stamped(&[("frame_id", 2, Type::String, ""), ("pose", 3, Type::Message, "foxglove.Pose")]);
    let messages = vec![vector, quaternion, message("Pose", pose), message("PoseInFrame", fields)];
    schema("foxglove.PoseInFrame", messages)
}

fn frame_transform() -> Schema {
    let [vector, quaternion] = vector_and_quaternion();
    let fields = stamped(&[
        ("parent_frame_id", 2, Type::String, ""),
        ("child_frame_id", 3, Type::String, ""),
        ("translation", 4, Type::Message, "foxglove.Vector3"),
        ("rotation", 5, Type::Message, "foxglove.Quaternion"),
    ]);
    schema("foxglove.FrameTransform", vec![vector, quaternion, message("FrameTransform", fields)])
}

fn joint_states() -> Schema {
    let names = ["position", "velocity", "acceleration", "effort"];
    let mut joint = message("JointState", vec![field("name", 1, Type::String, "")]);
    for (n, name) in names.into_iter().enumerate() {
        let mut optional = field(name, n as i32 + 2, Type::Double, "");
        optional.proto3_optional = Some(true);
        optional.oneof_index = Some(n as i32);
        joint.field.push(optional);
        joint
            .oneof_decl
            .push(OneofDescriptorProto { name: Some(format!("_{name}")), ..OneofDescriptorProto::default() });
    }
    let mut joints = field("joints", 2, Type::Message, "foxglove.JointState");
    joints.label = Some(Label::Repeated as i32);
    let mut fields = stamped(&[]);
    fields.push(joints);
    schema("foxglove.JointStates", vec![joint, message("JointStates", fields)])
}

pub(crate) fn log() -> Schema {
    let levels = ["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"];
    let value = |(n, name): (usize, &str)| EnumValueDescriptorProto {
        name: Some(name.into()),
        number: Some(n as i32),
        ..EnumValueDescriptorProto::default()
    };
    let fields = stamped(&[
        ("level", 2, Type::Enum, "foxglove.Log.Level"),
        ("message", 3, Type::String, ""),
        ("name", 4, Type::String, ""),
        ("file", 5, Type::String, ""),
        ("line", 6, Type::Fixed32, ""),
    ]);
    let mut log = message("Log", fields);
    log.enum_type.push(EnumDescriptorProto {
        name: Some("Level".into()),
        value: levels.into_iter().enumerate().map(value).collect(),
        ..EnumDescriptorProto::default()
    });
    schema("foxglove.Log", vec![log])
}

#[cfg(test)]
#[path = "foxglove_tests.rs"]
mod tests;
