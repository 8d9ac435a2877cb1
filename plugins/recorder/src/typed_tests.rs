//! Payloads of every kind become messages that protobuf itself reads back, by the descriptors in the file.

use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use trocar_sdk::serde_json::json;

use super::*;

const ALL: &str = r#"{"plain": {"ref": "All"}, "types": [
  {"name": "In", "size": 16, "fields": [
    {"name": "n", "at": 0, "type": "i16"}, {"name": "m", "at": 2, "type": "u16"}, {"name": "k", "at": 4, "type": "f32"},
    {"name": "long", "at": 8, "type": "i64"}]},
  {"name": "Kind", "enum": "u32", "values": [{"name": "A", "value": 1}, {"name": "B", "value": 2}]},
  {"name": "All", "size": 216, "fields": [
    {"name": "stamp", "at": 0, "type": "stamp"},
    {"name": "p", "at": 8, "unit": "m", "type": {"array": "f64", "n": 3}},
    {"name": "kind", "at": 32, "type": {"ref": "Kind"}},
    {"name": "yes", "at": 36, "type": "bool"}, {"name": "small", "at": 37, "type": "i8"}, {"name": "pad", "at": 38, "type": {"array": "u8", "n": 2}},
    {"name": "inner", "at": 40, "type": {"ref": "In"}},
    {"name": "list", "at": 56, "type": {"list": "f64", "n": 2}},
    {"name": "who", "at": 80, "type": {"text": 16}},
    {"name": "ins", "at": 104, "type": {"list": {"ref": "In"}, "n": 3}},
    {"name": "grid", "at": 160, "type": {"array": {"array": "f32", "n": 2}, "n": 3}},
    {"name": "shorts", "at": 184, "type": {"array": "i16", "n": 4}},
    {"name": "names", "at": 192, "type": {"array": {"text": 4}, "n": 1}}, {"name": "rest", "at": 208, "type": "u64"}]}]}"#;

fn read(typed: &Typed, bytes: &[u8]) -> DynamicMessage {
    let pool = DescriptorPool::decode(typed.descriptors.as_slice()).expect("descriptors that hold together");
    let message = pool.get_message_by_name(&typed.name).expect("its own name");
    DynamicMessage::decode(message, bytes).expect("a message")
}

#[test]
fn every_kind_of_field_comes_back_as_it_went() {
    let ty = AnyType::of_port(ALL).expect("a description");
    let value = json!({"stamp": 7, "p": [1.5, -2.0, 3.0], "kind": "B", "yes": true, "small": -3, "pad": [1, 2],
        "inner": {"n": -5, "m": 6, "k": 0.5, "long": -9}, "list": [2.5], "who": "eye",
        "ins": [{"n": 1, "m": 2, "k": 3.0, "long": 4}, {"n": -1, "m": 0, "k": -3.0, "long": 0}],
        "grid": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], "shorts": [1, -2, 300, -400], "names": ["abc"], "rest": 11});
    let bytes = ty.to_bytes(&value).expect("a value of the type");
    let typed = Typed::of(&ty, hash(ALL));
    let mut to = Vec::new();
    typed.encode(&bytes, 0, &mut to);
    let message = read(&typed, &to);
    let got = |name: &str| message.get_field_by_name(name).expect(name).into_owned();
    let doubles = |value: Value| -> Vec<f64> {
        value.as_list().expect("a list").iter().map(|v| v.as_f64().expect("a double")).collect()
    };
    assert_eq!(got("stamp"), Value::U64(7));
    assert_eq!(doubles(got("p")), [1.5, -2.0, 3.0]);
    assert_eq!(got("kind"), Value::EnumNumber(2));
    assert_eq!((got("yes"), got("small")), (Value::Bool(true), Value::I32(-3)));
    assert_eq!(doubles(got("list")), [2.5]);
    assert_eq!(got("who"), Value::String("eye".into()));
    assert_eq!(got("pad"), Value::Bytes(vec![1, 2].into()));
    let grid = got("grid");
    let grid: Vec<f32> = grid.as_list().expect("a list").iter().filter_map(Value::as_f32).collect();
    assert_eq!(grid, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let shorts = got("shorts");
    assert_eq!(shorts.as_list().map(<[Value]>::to_vec), Some([1, -2, 300, -400].map(Value::I32).to_vec()));
    assert_eq!(got("names").as_list(), Some(&[Value::String("abc".into())][..]));
    assert_eq!(got("rest"), Value::U64(11));
    let ins = got("ins");
    let ins = ins.as_list().expect("a list");
    let second = ins[1].as_message().expect("a message");
    assert_eq!(ins.len(), 2);
    assert_eq!(second.get_field_by_name("n").expect("n").into_owned(), Value::I32(-1));
    let inner = got("inner");
    let inner = inner.as_message().expect("a message");
    assert_eq!(inner.get_field_by_name("long").expect("long").into_owned(), Value::I64(-9));
    assert_eq!(typed.units, [("p".to_owned(), "m".to_owned())]);
    assert!(typed.name.ends_with(".All") && typed.name.contains(&format!("{:016x}", hash(ALL))));
}

#[test]
fn frames_carry_their_bytes_and_plain_numbers_a_value() {
    let text = r#"{"frame": {"ref": "H"}, "format": "spectra", "types": [
        {"name": "H", "size": 8, "fields": [{"name": "data", "at": 0, "type": "u64"}]}]}"#;
    let typed = Typed::of(&AnyType::of_port(text).expect("a description"), 1);
    let mut to = Vec::new();
    typed.encode(&5u64.to_le_bytes(), 3, &mut to);
    to.extend([1, 2, 3]);
    let message = read(&typed, &to);
    let got = |name: &str| message.get_field_by_name(name).expect(name).into_owned();
    assert_eq!((got("data"), got("frame_data")), (Value::U64(5), Value::Bytes(vec![1, 2, 3].into())));
    let typed = Typed::of(&AnyType::of_port(r#"{"plain": "f64", "types": []}"#).expect("a number"), 2);
    let mut to = Vec::new();
    typed.encode(&2.5f64.to_le_bytes(), 0, &mut to);
    assert_eq!(read(&typed, &to).get_field_by_name("value").expect("value").into_owned(), Value::F64(2.5));
}

#[test]
fn any_bytes_can_be_encoded_and_documentation_is_no_part_of_a_type() {
    let ty = AnyType::of_port(ALL).expect("a description");
    let typed = Typed::of(&ty, 3);
    for seed in 0..200u32 {
        let mut state = seed.wrapping_mul(2_654_435_761) | 1;
        let bytes: Vec<u8> = (0..ty.size())
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 17;
                state ^= state << 5;
                if seed < 20 { 255 } else { state as u8 }
            })
            .collect();
        let mut to = Vec::new();
        typed.encode(&bytes, 0, &mut to);
        read(&typed, &to);
        typed.encode(&bytes[..bytes.len() / 2], 0, &mut Vec::new());
    }
    let documented = ALL.replace(r#""name": "stamp","#, r#""doc": "When.", "name": "stamp","#);
    assert_eq!(hash(ALL), hash(&documented));
    assert_ne!(hash(ALL), hash(&ALL.replace("\"m\"", "\"mm\"")));
}
