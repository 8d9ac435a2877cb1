//! Types known only while running: described, read, written, and safe for any bytes and any description.
#![allow(clippy::unwrap_used)]
#![forbid(unsafe_code)]

use proptest::prelude::*;
use trocar_plugin_api::desc::PluginDesc;
use trocar_plugin_api::manifest::Manifest;
use trocar_sdk::serde_json::{self, Value, json};
use trocar_sdk::{AnyCommand, AnyType, as_bytes, from_bytes, prelude::*};

named_values! {
    pub struct Mode: i16 { IDLE = 0, BUSY = 7, BROKEN = -1 }
}

#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
struct Inner {
    #[unit("m")]
    #[frame("retina")]
    tip: [f64; 3],
    label: Text<8>,
    mode: Mode,
    on: Flag,
    small: i8,
    #[unit("N")]
    f: f32,
}

#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
struct Outer {
    stamp: Stamp,
    big: u64,
    one: Inner,
    many: List<Inner, 2>,
    counts: [u16; 4],
    reserved: [u8; 8],
}

#[derive(Component)]
struct Typed {
    #[input]
    x: In<Outer>,
}
impl Component for Typed {
    fn step(&mut self, _: &Tick) -> Result {
        let _ = self.x.latest();
        Ok(())
    }
}

fn manifest() -> Manifest {
    const PLUGIN: PluginDesc = PluginDesc {
        name: "t",
        version: "0.0.0",
        vendor: "",
        license: "",
        doc: "",
        built_with: "",
        unload: false,
        classes: &[Typed::DESC],
    };
    const LEN: usize = trocar_plugin_api::render::<0>(&PLUGIN).1;
    Manifest::parse(&trocar_plugin_api::render::<LEN>(&PLUGIN).0).unwrap()
}

fn outer() -> AnyType {
    let text = json!({"plain": {"ref": "Outer"}, "types": manifest().types}).to_string();
    AnyType::of_port(&text).unwrap()
}

fn sample() -> Outer {
    let inner = |tip: f64| Inner {
        tip: [tip, -0.5, 1e-9],
        label: Text::new("tip µ"),
        mode: Mode::BUSY,
        on: true.into(),
        small: -3,
        f: 0.1,
    };
    Outer {
        stamp: Stamp::from_ns(5),
        big: u64::MAX,
        one: inner(1.0),
        many: List::of(&[inner(2.0)]),
        counts: [1, 2, 3, u16::MAX],
        reserved: [0; 8],
    }
}

#[test]
fn a_payload_reads_as_json_as_the_tools_spell_it() {
    let value = outer().to_json(as_bytes(&sample())).unwrap();
    assert_eq!(value["big"], "18446744073709551615");
    assert_eq!(value["one"]["mode"], "BUSY");
    assert_eq!(value["one"]["f"], 0.1);
    assert_eq!(value["one"]["label"], "tip µ");
    assert_eq!(value["many"].as_array().unwrap().len(), 1);
    assert_eq!(value["counts"], json!([1, 2, 3, 65535]));
    assert_eq!((&value["one"]["on"], &value["one"]["small"]), (&json!(true), &json!(-3)));
}

#[test]
fn units_and_coordinate_frames_of_nested_payloads_are_in_the_manifest() {
    let manifest = manifest();
    let tip = &manifest.named("Inner").unwrap().fields[0];
    assert_eq!((tip.name.as_str(), tip.unit.as_str(), tip.frame.as_str()), ("tip", "m", "retina"));
    assert_eq!(manifest.named("Mode").unwrap().values.len(), 3);
    let names: Vec<&str> = manifest.types.iter().map(|t| t.name.as_str()).collect();
    assert_eq!(names, ["Mode", "Inner", "Outer"], "each type once, items before what contains them");
}

#[test]
fn what_was_read_writes_back_to_the_same_value() {
    let ty = outer();
    let bytes = ty.to_bytes(&ty.to_json(as_bytes(&sample())).unwrap()).unwrap();
    assert_eq!(from_bytes::<Outer>(&bytes), Some(sample()));
}

#[test]
fn numbers_are_found_once_and_read_without_searching() {
    let ty = outer();
    let bytes = as_bytes(&sample()).to_vec();
    let number = |path: &str| ty.place(path).and_then(|place| place.number(&bytes));
    assert_eq!(number("one/tip/1"), Some(-0.5));
    assert_eq!(number("counts/3"), Some(65535.0));
    assert_eq!(
        (number("one/mode"), number("one/small"), number("one/on")),
        (Some(7.0), Some(-3.0), Some(1.0))
    );
    for nowhere in ["", "one", "one/tip/3", "many/0/f", "one/label", "counts/-1", "two"] {
        assert_eq!(number(nowhere), None, "{nowhere}");
    }
    assert_eq!(ty.place("counts/3").unwrap().number(&bytes[..20]), None, "too few bytes");
    assert_eq!((ty.unit("one/tip/2"), ty.unit("one/f"), ty.unit("big")), ("m", "N", ""));
}

#[test]
fn stamps_lists_texts_and_gaps_may_be_left_out() {
    let ty = outer();
    let mut value = ty.to_json(as_bytes(&sample())).unwrap();
    for left_out in ["stamp", "many", "reserved"] {
        assert!(value.as_object_mut().unwrap().remove(left_out).is_some(), "{left_out}");
    }
    let want = Outer { stamp: Stamp::INVALID, many: List::default(), ..sample() };
    assert_eq!(from_bytes::<Outer>(&ty.to_bytes(&value).unwrap()), Some(want));
}

#[test]
fn a_value_that_does_not_fit_is_refused_with_its_place() {
    let ty = outer();
    let good = ty.to_json(as_bytes(&sample())).unwrap();
    for (pointer, bad, says) in [
        ("/one/tip", json!([1, 2]), "one/tip: 3 items"),
        ("/one/tip/1", json!("x"), "one/tip/1: \"x\" is no f64"),
        ("/one/mode", json!("SLEEPING"), "IDLE, BUSY, BROKEN"),
        ("/one/small", json!(200), "200 is no i8"),
        ("/one/f", json!(1e300), "is no f32"),
        ("/one/label", json!("much too long"), "at most 8 bytes"),
        ("/many", json!([{}, {}, {}]), "at most 2 items"),
        ("/counts/0", json!(1.5), "is no u16"),
        ("/one/on", json!(1), "is no bool"),
        ("/one", json!({"tipp": 1}), "has no field `tipp`"),
        ("/one", json!({}), "field `tip` of Inner is missing"),
    ] {
        let mut value = good.clone();
        *value.pointer_mut(pointer).unwrap() = bad;
        let why = ty.to_bytes(&value).unwrap_err().to_string();
        assert!(why.contains(says), "{pointer}: {why}");
    }
}

#[test]
fn frames_and_commands_are_described_too() {
    let frame =
        AnyType::of_port(r#"{"frame": "u32", "format": "image", "max_bytes": 0, "types": []}"#).unwrap();
    assert_eq!((frame.format(), frame.size()), (Some("image"), 4));
    let command = AnyCommand::of_function(
        &json!({"name": "servo", "kind": "write_return", "ret": "f64", "ret_unit": "N",
                "arg": {"name": "x", "type": {"array": "f32", "n": 3}, "unit": "mm"}, "types": []})
        .to_string(),
    )
    .unwrap();
    assert_eq!((command.arg_size(), command.ret_size()), (12, 8));
    assert_eq!((command.arg_unit.as_str(), command.ret_unit.as_str()), ("mm", "N"));
    let void = AnyCommand::of_function(r#"{"name": "stop", "kind": "void"}"#).unwrap();
    assert_eq!((void.arg_size(), void.ret_size(), void.arg), (0, 0, None));
}

#[test]
fn descriptions_that_contradict_themselves_or_never_end_are_refused() {
    let field = |at: u64, ty: Value| json!({"name": "x", "at": at, "type": ty});
    let named = |size: u64, fields: Value| json!([{"name": "A", "size": size, "align": 8, "fields": fields}]);
    let a = json!({"ref": "A"});
    for (plain, types) in [
        (json!("f65"), json!([])),
        (a.clone(), json!([])),
        (a.clone(), named(8, json!([field(8, json!("f64"))]))),
        (a.clone(), named(8, json!([field(u64::MAX, json!("f64"))]))),
        (a.clone(), named(8, json!([field(0, a.clone())]))),
        (a.clone(), named(0, json!([]))),
        (json!({"array": "f64", "n": u64::MAX}), json!([])),
        (json!({"list": "u8", "n": -1}), json!([])),
        (json!({"text": u64::MAX}), json!([])),
        (json!({"array": {"array": "u8", "n": 0}, "n": 1_000_000}), json!([])),
        (json!(3), json!([])),
    ] {
        let text = json!({"plain": plain, "types": types}).to_string();
        assert!(AnyType::of_port(&text).is_err(), "{text}");
    }
    for text in ["", "{}", "[]", "null", "\"any\""] {
        assert!(AnyType::of_port(text).is_err(), "{text}");
    }
}

proptest! {
    /// Lengths, flags, names and numbers of any kind.
    #[test]
    fn any_bytes_are_safe_to_read(bytes in prop::collection::vec(any::<u8>(), size_of::<Outer>())) {
        let ty = outer();
        let value = ty.to_json(&bytes).unwrap();
        prop_assert!(serde_json::to_string(&value).is_ok());
        let typed: Outer = from_bytes(&bytes).unwrap();
        prop_assert_eq!(value["many"].as_array().unwrap().len(), typed.many.len());
        prop_assert!(typed.many.len() <= 2 && typed.one.label.len() <= 8);
        // Values that the reading made valid stay as they are.
        let again = ty.to_bytes(&value);
        if let Ok(again) = again {
            prop_assert_eq!(ty.to_json(&again).unwrap(), value);
        }
    }

    #[test]
    fn bytes_of_another_size_are_no_value(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        prop_assert_eq!(outer().to_json(&bytes).is_some(), bytes.len() == size_of::<Outer>());
    }

    #[test]
    fn any_text_is_safe_as_a_description(text in "\\PC{0,40}") {
        let _ = (AnyType::of_port(&text), AnyCommand::of_function(&text));
    }
}
