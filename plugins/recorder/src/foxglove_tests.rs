//! Messages as viewers read them: each against its own descriptors.

use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use trocar_sdk::serde_json::json;

use super::*;

fn read(schema: &Schema, bytes: &[u8]) -> DynamicMessage {
    let pool = DescriptorPool::decode(schema.descriptors.as_slice()).expect("descriptors that hold together");
    let message = pool.get_message_by_name(schema.name).expect("its own name");
    DynamicMessage::decode(message, bytes).expect("a message")
}

fn got(message: &DynamicMessage, name: &str) -> Value {
    message.get_field_by_name(name).expect(name).into_owned()
}

const IMAGE: &str = r#"{"frame": {"ref": "ImageHeader"}, "format": "image", "types": [
    {"name": "PixelFormat", "enum": "u32", "values": [{"name": "RGB8", "value": 2}]},
    {"name": "ImageHeader", "size": 32, "fields": [{"name": "stamp", "at": 0, "type": "stamp"}, {"name": "index", "at": 8, "type": "u64"},
     {"name": "width", "at": 16, "type": "u32"}, {"name": "height", "at": 20, "type": "u32"}, {"name": "stride", "at": 24, "type": "u32"},
     {"name": "format", "at": 28, "type": {"ref": "PixelFormat"}}]}]}"#;

#[test]
fn an_image_is_a_raw_image_and_one_that_promises_too_much_is_none() {
    let ty = AnyType::of_port(IMAGE).expect("a description");
    let Some(Shown::Image(places)) = Shown::of(&ty, "ImageHeader", "") else { panic!("an image") };
    let header = |height: u32, stride: u32| {
        ty.to_bytes(&json!({"stamp": 1, "index": 2, "width": 2, "height": height, "stride": stride, "format": "RGB8"}))
            .expect("a header")
    };
    let pixels: Vec<u8> = (0..14).collect();
    let [Some(image), None] = places.images(&header(2, 8), &pixels).expect("an image") else { panic!("one") };
    let mut to = Vec::new();
    image.encode(1_500_000_000, &mut to);
    to.extend_from_slice(image.bytes);
    let message = read(&raw_image(), &to);
    assert_eq!((got(&message, "width"), got(&message, "step")), (Value::U32(2), Value::U32(8)));
    assert_eq!(got(&message, "encoding"), Value::String("rgb8".into()));
    assert_eq!(got(&message, "data"), Value::Bytes(pixels.clone().into()));
    let stamp = got(&message, "timestamp");
    let stamp = stamp.as_message().expect("a timestamp");
    assert_eq!((got(stamp, "seconds"), got(stamp, "nanos")), (Value::I64(1), Value::I32(500_000_000)));
    for (height, stride) in [(3, 8), (2, 5), (0, 8), (u32::MAX, u32::MAX)] {
        assert!(places.images(&header(height, stride), &pixels).is_none(), "{height} rows, {stride} B apart");
    }
}

#[test]
fn poses_and_joints_are_what_viewers_draw() {
    let text = r#"{"plain": {"ref": "Pose"}, "types": [{"name": "Pose", "size": 64, "fields": [{"name": "stamp", "at": 0, "type": "stamp"},
        {"name": "position", "at": 8, "type": {"array": "f64", "n": 3}, "frame": "retina"}, {"name": "orientation", "at": 32, "type": {"array": "f64", "n": 4}}]}]}"#;
    let ty = AnyType::of_port(text).expect("a description");
    let shown = Shown::of(&ty, "Pose", &frame_id(text, "Pose")).expect("a pose");
    let Shown::Pose(places, frame_id) = &shown else { panic!("a pose") };
    let value = ty
        .to_bytes(&json!({"position": [1.0, 2.0, 3.0], "orientation": [0.0, 0.0, 0.0, 1.0]}))
        .expect("a pose");
    let mut to = Vec::new();
    places.encode(&value, frame_id, 9, &mut to);
    let message = read(&shown.schema(), &to);
    assert_eq!(got(&message, "frame_id"), Value::String("retina".into()));
    let pose = got(&message, "pose");
    let position = got(pose.as_message().expect("a pose"), "position");
    assert_eq!(got(position.as_message().expect("a vector"), "z"), Value::F64(3.0));

    let text = r#"{"plain": {"ref": "JointState"}, "types": [{"name": "JointState", "size": 80, "fields": [{"name": "stamp", "at": 0, "type": "stamp"},
        {"name": "position", "at": 8, "type": {"list": "f64", "n": 2}}, {"name": "velocity", "at": 32, "type": {"list": "f64", "n": 2}},
        {"name": "effort", "at": 56, "type": {"list": "f64", "n": 2}}]}]}"#;
    let ty = AnyType::of_port(text).expect("a description");
    let shown = Shown::of(&ty, "JointState", "").expect("joints");
    let Shown::Joints(places) = &shown else { panic!("joints") };
    let value =
        ty.to_bytes(&json!({"position": [1.0, 2.0], "velocity": [3.0], "effort": []})).expect("joints");
    let mut to = Vec::new();
    places.encode(&value, 9, &mut to);
    let message = read(&shown.schema(), &to);
    let joints = got(&message, "joints");
    let joints = joints.as_list().expect("a list");
    let second = joints[1].as_message().expect("a joint");
    assert_eq!((joints.len(), got(second, "name")), (2, Value::String("joint_1".into())));
    assert_eq!(got(second, "position"), Value::F64(2.0));
    assert!(!second.has_field_by_name("velocity") && !second.has_field_by_name("effort"));
}

#[test]
fn a_transform_is_one_of_frames_with_their_names() {
    let text = r#"{"plain": {"ref": "Transform"}, "types": [{"name": "Transform", "size": 144, "fields": [
        {"name": "pose", "at": 0, "type": {"ref": "Pose"}}, {"name": "parent", "at": 64, "type": {"text": 32}},
        {"name": "child", "at": 104, "type": {"text": 32}}]},
        {"name": "Pose", "size": 64, "fields": [{"name": "stamp", "at": 0, "type": "stamp"},
        {"name": "position", "at": 8, "type": {"array": "f64", "n": 3}}, {"name": "orientation", "at": 32, "type": {"array": "f64", "n": 4}}]}]}"#;
    let ty = AnyType::of_port(text).expect("a description");
    let shown = Shown::of(&ty, "Transform", "").expect("a transform");
    let Shown::Transform(places) = &shown else { panic!("a transform") };
    let mut value = ty
        .to_bytes(&json!({"pose": {"position": [1.0, 2.0, 3.0], "orientation": [0.0, 0.0, 0.0, 1.0]},
            "parent": "base", "child": "tip"}))
        .expect("a transform");
    let of = |value: &[u8]| {
        let mut to = Vec::new();
        places.encode(value, 9, &mut to);
        read(&shown.schema(), &to)
    };
    let message = of(&value);
    assert_eq!(got(&message, "parent_frame_id"), Value::String("base".into()));
    assert_eq!(got(&message, "child_frame_id"), Value::String("tip".into()));
    let part = |name: &str, field: &str| got(got(&message, name).as_message().expect(name), field);
    assert_eq!((part("translation", "y"), part("rotation", "w")), (Value::F64(2.0), Value::F64(1.0)));
    // A length beyond the room, and bytes that are no text, are no way out of the sample.
    value[64..72].copy_from_slice(&u64::MAX.to_le_bytes());
    value[72] = 0xff;
    assert_eq!(got(&of(&value), "parent_frame_id"), Value::String(String::new()));
}

#[test]
fn a_marker_is_a_line_of_a_log() {
    let message = read(&log(), &log_line(5, "touched", "host/rec"));
    assert_eq!(got(&message, "message"), Value::String("touched".into()));
    assert_eq!(got(&message, "level"), Value::EnumNumber(2));
}
