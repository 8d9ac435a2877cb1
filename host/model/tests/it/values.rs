//! JSON ↔ bytes: values that fit, values that do not, and why.

use proptest::prelude::*;
use serde_json::{Value, json};
use std::sync::Arc;
use trocar_model::*;

use crate::scene::*;
use crate::types::{any_type, any_value};

fn why(ty: &Type, value: Value) -> String {
    match encode(ty, &value) {
        Ok(bytes) => panic!("{value} was encoded as {bytes:?}"),
        Err(e) => e.to_string(),
    }
}

fn prim(p: Prim) -> Type {
    Type::Prim(p)
}

#[test]
fn fields_lie_where_the_description_says_little_endian() {
    let bytes = encode(&force("N"), &json!({"stamp": 258, "f": [1.0, 0, -2]})).unwrap();
    assert_eq!(bytes[..8], [2, 1, 0, 0, 0, 0, 0, 0]);
    assert_eq!(bytes[8..16], 1.0f64.to_le_bytes());
    assert_eq!(bytes[24..32], (-2.0f64).to_le_bytes());
}

#[test]
fn large_integers_travel_as_strings() {
    let bytes = encode(&prim(Prim::U64), &json!("18446744073709551615")).unwrap();
    assert_eq!(bytes, [255; 8]);
    assert_eq!(decode(&prim(Prim::U64), &bytes).unwrap(), json!("18446744073709551615"));
    assert_eq!(decode(&prim(Prim::I64), &i64::MIN.to_le_bytes()).unwrap(), json!("-9223372036854775808"));
    assert_eq!(decode(&prim(Prim::I64), &7i64.to_le_bytes()).unwrap(), json!(7));
    assert!(
        why(&prim(Prim::U64), json!(9_007_199_254_740_992.0)).contains("write a whole number as a text"),
        "a double may have lost digits there: 2^53 + 1 becomes it"
    );
    assert_eq!(encode(&prim(Prim::U64), &json!(9_007_199_254_740_991.0)).unwrap()[6], 0x1f);
}

#[test]
fn a_whole_number_may_arrive_as_a_double() {
    assert_eq!(encode(&prim(Prim::I32), &json!(30.0)).unwrap(), 30i32.to_le_bytes());
    assert_eq!(why(&prim(Prim::I32), json!(30.5)), "30.5 is not a whole number (i32)");
}

#[test]
fn numbers_that_do_not_fit_name_the_limits() {
    assert_eq!(why(&prim(Prim::U8), json!(256)), "256 does not fit u8, which holds 0 to 255");
    assert_eq!(why(&prim(Prim::U32), json!(-1)), "-1 does not fit u32, which holds 0 to 4294967295");
    assert!(why(&prim(Prim::F32), json!(1e300)).ends_with("does not fit f32"));
}

#[test]
fn what_json_cannot_write_as_a_number_is_a_text() {
    for (text, want) in [("NaN", f64::NAN), ("Infinity", f64::INFINITY), ("-Infinity", f64::NEG_INFINITY)] {
        let bytes = encode(&f64_type(), &json!(text)).unwrap();
        assert_eq!(bytes, want.to_le_bytes(), "{text}");
        assert_eq!(decode(&f64_type(), &bytes).unwrap(), json!(text));
    }
}

#[test]
fn a_short_float_reads_short() {
    assert_eq!(decode(&prim(Prim::F32), &0.1f32.to_le_bytes()).unwrap(), json!(0.1));
}

#[test]
fn enums_are_names_or_numbers() {
    let values = vec![("IDLE".to_owned(), 0), ("MOVING".to_owned(), 3)];
    let mode = Type::Enum(Arc::new(EnumType { name: "Mode".into(), repr: Prim::U16, values }));
    assert_eq!(encode(&mode, &json!("MOVING")).unwrap(), [3, 0]);
    assert_eq!(encode(&mode, &json!(3)).unwrap(), [3, 0]);
    assert_eq!(decode(&mode, &[3, 0]).unwrap(), json!("MOVING"));
    assert_eq!(decode(&mode, &[9, 0]).unwrap(), json!(9), "a flag combination has no name");
    assert_eq!(why(&mode, json!("MOVNG")), "Mode has no value `MOVNG`; did you mean `MOVING`?");
    assert_eq!(why(&mode, json!("x")), "Mode has no value `x`; it has IDLE, MOVING");
}

#[test]
fn missing_and_unknown_fields_are_named() {
    assert_eq!(why(&force("N"), json!({"stamp": 1})), "/f: field `f` of Force is missing ([f64; 3] in N)");
    assert!(encode(&force("N"), &json!({"f": [0, 0, 0]})).is_ok(), "a stamp may be left out");
    assert_eq!(
        why(&force("N"), json!({"f": [0, 0, 0], "stmp": 1})),
        "/stmp: Force has no field `stmp`; did you mean `stamp`?"
    );
    assert_eq!(
        why(&force("N"), json!({"f": [0, "x", 0]})),
        "/f/1: \"x\" is not a number (texts allowed: \"NaN\", \"Infinity\", \"-Infinity\")"
    );
    assert_eq!(why(&force("N"), json!({"f": [0, 0]})), "/f: it has 2 items; exactly 3 are wanted");
    assert_eq!(why(&force("N"), json!(3)), "3 is not an object with the fields of Force");
}

#[test]
fn a_gap_that_a_payload_names_may_be_left_out() {
    let fields = vec![
        field("kind", 0, prim(Prim::U32), ""),
        field("reserved", 4, prim(Prim::U32), ""),
        field("stiffness", 8, f64_type(), "1/s"),
    ];
    let fixture = structure("Fixture", 16, fields);
    let bytes = encode(&fixture, &json!({"kind": 1, "stiffness": 0})).unwrap();
    assert_eq!(bytes, [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(encode(&fixture, &json!({"kind": 1, "reserved": 7, "stiffness": 0})).unwrap()[4], 7);
    assert_eq!(
        why(&fixture, json!({"kind": 1})),
        "/stiffness: field `stiffness` of Fixture is missing (f64 in 1/s)"
    );
}

#[test]
fn lists_and_texts_are_bounded_and_their_tails_are_zero() {
    let list = Type::List { item: Box::new(f64_type()), n: 2 };
    assert_eq!(encode(&list, &json!([1.0])).unwrap()[16..], [0; 8]);
    assert_eq!(why(&list, json!([1, 2, 3])), "it has 3 items; there is room for 2");
    let text = Type::Text { n: 8 };
    assert_eq!(why(&text, json!("aaaaaaaaa")), "the text has 9 bytes; there is room for 8");
    assert_eq!(why(&text, json!(8)), "8 is not a text");
}

#[test]
fn bytes_that_are_no_value_of_the_type_are_refused() {
    let text = Type::Text { n: 8 };
    let error = |ty: &Type, bytes: &[u8]| decode(ty, bytes).unwrap_err().to_string();
    assert_eq!(error(&prim(Prim::Bool), &[2]), "byte 2 is neither false (0) nor true (1)");
    assert_eq!(error(&prim(Prim::U32), &[0; 3]), "3 bytes are not a u32, which has 4");
    let mut long = [0; 16];
    long[0] = 9;
    assert_eq!(error(&text, &long), "its length says 9 bytes of text; there is room for 8");
    let mut latin1 = [0; 16];
    (latin1[0], latin1[8], latin1[9]) = (2, b'a', 0xe9);
    assert_eq!(error(&text, &latin1), "the text is not UTF-8 at byte 1");
}

#[test]
fn a_description_that_is_wrong_about_itself_harms_nobody() {
    let liar = structure("Liar", 8, vec![field("x", 4, f64_type(), "m")]);
    assert!(decode(&liar, &[0; 8]).is_err() && encode(&liar, &json!({"x": 1})).is_err());
    let huge = Type::Array { item: Box::new(f64_type()), n: usize::MAX };
    assert!(encode(&huge, &json!([])).unwrap_err().what.contains("can be converted"));
    let nothing = Type::Array { item: Box::new(structure("Unit", 0, vec![])), n: usize::MAX };
    assert!(decode(&nothing, &[]).is_err(), "items without size must not be counted for ever");
}

fn limited(unit: &str) -> Arg {
    Arg {
        name: "v".into(),
        doc: String::new(),
        ty: f64_type(),
        unit: unit.into(),
        min: Some(0.0),
        max: Some(100.0),
    }
}

#[test]
fn a_value_outside_the_declared_range_names_the_limit_with_its_unit() {
    let check = |v: Value| check_range(&limited("mm"), &v);
    assert_eq!(check(json!(300)).unwrap_err(), "v 300 is above maximum 100 mm");
    assert_eq!(check(json!(-0.5)).unwrap_err(), "v -0.5 is below minimum 0 mm");
    let of = |ty: Type, v: Value| check_range(&Arg { ty, ..limited("mm") }, &v);
    let list = |item: Type| Type::List { item: Box::new(item), n: 4 };
    let array = |item: Type| Type::Array { item: Box::new(item), n: 2 };
    let point = || {
        structure("P", 16, vec![field("t", 0, Type::Prim(Prim::Stamp), ""), field("x", 8, f64_type(), "m")])
    };
    let far = json!({ "t": 900, "x": 101 });
    for (ty, value, name) in [
        (list(f64_type()), json!([1, 2, 101]), "v[2]"),
        (array(array(f64_type())), json!([[0, 0], [0, 101]]), "v[1][1]"),
        (point(), far.clone(), "v.x"),
        (list(point()), json!([{ "t": 900, "x": 1 }, far]), "v[1].x"),
    ] {
        assert_eq!(of(ty, value).unwrap_err(), format!("{name} 101 is above maximum 100 mm"));
    }
    assert_eq!(of(point(), json!({ "t": 900, "x": 1 })), Ok(()), "a stamp is no number of it");
    assert_eq!(of(Type::Text { n: 8 }, json!("300")), Ok(()));
    assert_eq!(check(json!("Infinity")).unwrap_err(), "v Infinity is above maximum 100 mm");
    assert!(check(json!("NaN")).is_err(), "NaN is within no range");
    assert_eq!(check(json!(100)), Ok(()));
}

proptest! {
    #[test]
    fn what_is_encoded_is_decoded_to_the_same(
        (ty, value) in any_type().prop_flat_map(|ty| { let v = any_value(&ty); (Just(ty), v) })
    ) {
        let bytes = encode(&ty, &value).unwrap();
        prop_assert_eq!(bytes.len(), ty.size());
        let back = decode(&ty, &bytes).unwrap();
        prop_assert_eq!(encode(&ty, &back).unwrap(), bytes, "{} came back as {}", value, back);
    }

    #[test]
    fn no_bytes_make_decode_panic_and_what_it_reads_it_can_write(
        (ty, bytes) in any_type().prop_flat_map(|ty| {
            let size = ty.size();
            (Just(ty), prop::collection::vec(any::<u8>(), size..=size))
        })
    ) {
        if let Ok(value) = decode(&ty, &bytes) {
            prop_assert!(encode(&ty, &value).is_ok(), "{} was decoded but does not encode", value);
        }
        let _ = decode(&ty, &bytes[..bytes.len() / 2]);
    }

    #[test]
    fn no_json_makes_encode_panic(ty in any_type(), other in any_type().prop_flat_map(|t| any_value(&t))) {
        let _ = encode(&ty, &other);
    }
}
