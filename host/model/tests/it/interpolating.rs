//! Values between two rows: blended ones, others, and that the result is always a value of the type.

use std::sync::Arc;

use proptest::prelude::*;
use serde_json::{Value, json};
use trocar_model::*;

use crate::scene::*;

fn prim(p: Prim) -> Type {
    Type::Prim(p)
}

fn array(item: Type, n: usize) -> Type {
    Type::Array { item: Box::new(item), n }
}

fn between(ty: &Type, a: Value, b: Value, fraction: f64) -> Value {
    let (a, b) = (encode(ty, &a).unwrap(), encode(ty, &b).unwrap());
    decode(ty, &interpolate(ty, &a, &b, fraction).unwrap()).unwrap()
}

/// One of each kind.
fn row() -> Type {
    let mode = Type::Enum(Arc::new(EnumType {
        name: "Mode".into(),
        repr: Prim::U32,
        values: vec![("off".into(), 0), ("on".into(), 1)],
    }));
    structure(
        "Row",
        136,
        vec![
            field("stamp", 0, prim(Prim::Stamp), "ns"),
            field("x", 8, prim(Prim::F64), "m"),
            field("n", 16, prim(Prim::I64), ""),
            field("mode", 24, mode, ""),
            field("small", 28, prim(Prim::F32), ""),
            field("orientation", 32, array(prim(Prim::F64), 4), ""),
            field("list", 64, Type::List { item: Box::new(prim(Prim::F64)), n: 3 }, "m"),
            field("name", 96, Type::Text { n: 32 }, ""),
        ],
    )
}

fn value(stamp: u64, x: f64, n: i64, mode: &str, q: [f64; 4], list: &[f64], name: &str) -> Value {
    json!({"stamp": stamp, "x": x, "n": n, "mode": mode, "small": x, "orientation": q, "list": list, "name": name})
}

#[test]
fn floats_and_stamps_are_blended_and_everything_else_is_the_nearer_row() {
    let a = value(1000, 1.0, 10, "off", [0.0, 0.0, 0.0, 1.0], &[1.0, 2.0], "a");
    let b = value(2000, 3.0, 20, "on", [0.0, 0.0, 0.0, 1.0], &[3.0, 6.0], "b");
    let got = between(&row(), a.clone(), b.clone(), 0.25);
    assert_eq!(got, value(1250, 1.5, 10, "off", [0.0, 0.0, 0.0, 1.0], &[1.5, 3.0], "a"));
    let got = between(&row(), a, b, 0.75);
    assert_eq!(got, value(1750, 2.5, 20, "on", [0.0, 0.0, 0.0, 1.0], &[2.5, 5.0], "b"));
}

#[test]
fn what_has_no_middle_is_the_nearer_row() {
    assert_eq!(
        between(&prim(Prim::Stamp), json!(0), json!(1000), 0.4),
        json!(0),
        "an invalid stamp has no middle"
    );
    assert_eq!(between(&prim(Prim::F64), json!("NaN"), json!(1), 0.6), json!(1.0));
    assert_eq!(between(&prim(Prim::F64), json!(1), json!("Infinity"), 0.4), json!(1.0));
    let list = Type::List { item: Box::new(prim(Prim::F64)), n: 3 };
    assert_eq!(
        between(&list, json!([1]), json!([3, 4]), 0.4),
        json!([1.0]),
        "lists of other lengths do not blend"
    );
    assert_eq!(between(&prim(Prim::Bool), json!(true), json!(false), 0.4), json!(true));
}

#[test]
fn large_numbers_neither_overflow_nor_lose_their_last_digits() {
    let middle = between(&prim(Prim::F64), json!(-1.7e308), json!(1.7e308), 0.5);
    assert_eq!(middle, json!(0.0));
    let (x, y) = (9_223_372_036_854_775_000_u64, 9_223_372_036_854_775_002_u64);
    let middle = between(&prim(Prim::Stamp), json!(x.to_string()), json!(y.to_string()), 0.5);
    assert_eq!(middle, json!((x + 1).to_string()));
    assert_eq!(between(&prim(Prim::Stamp), json!(3000), json!(1000), 0.25), json!(2500), "also backwards");
}

#[test]
fn an_orientation_turns_along_the_shorter_arc_and_stays_a_unit_quaternion() {
    let pose = structure("Pose", 32, vec![field("orientation", 0, array(prim(Prim::F64), 4), "")]);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let turned = |b: [f64; 4]| {
        let got = between(&pose, json!({"orientation": [0, 0, 0, 1]}), json!({"orientation": b}), 0.5);
        let q: Vec<f64> =
            got["orientation"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        q
    };
    let eighth = (std::f64::consts::FRAC_PI_8.sin(), std::f64::consts::FRAC_PI_8.cos());
    for b in [[0.0, 0.0, half, half], [0.0, 0.0, -half, -half]] {
        let q = turned(b);
        assert!((q[2] - eighth.0).abs() < 1e-12 && (q[3] - eighth.1).abs() < 1e-12, "{q:?} from {b:?}");
    }
    assert_eq!(turned([0.0, 0.0, 2.0, 0.0]), [0.0, 0.0, 1.0, 0.5], "four other floats are blended like any");
    let axes = structure("Axes", 32, vec![field("axes", 0, array(prim(Prim::F64), 4), "")]);
    let got = between(&axes, json!({"axes": [0, 0, 0, 1]}), json!({"axes": [0, 0, 1, 0]}), 0.5);
    assert_eq!(got["axes"], json!([0.0, 0.0, 0.5, 0.5]), "and so are those that are no orientation");
}

#[test]
fn rows_of_a_wrong_length_and_fractions_outside_are_refused() {
    let (ty, row) = (prim(Prim::F64), [0; 8]);
    assert!(
        interpolate(&ty, &row[..7], &row, 0.5).unwrap_err().to_string().contains("7 bytes are not a f64")
    );
    for fraction in [-0.1, 1.1, f64::NAN, f64::INFINITY] {
        assert!(
            interpolate(&ty, &row, &row, fraction).unwrap_err().to_string().contains("is not a fraction")
        );
    }
    let liar = structure("Liar", 8, vec![field("x", 4, prim(Prim::F64), "")]);
    assert!(interpolate(&liar, &row, &row, 0.5).unwrap_err().to_string().contains("beyond its own size"));
}

fn any_value() -> impl Strategy<Value = Value> {
    let unit = (-1.0f64..1.0, -1.0f64..1.0, -1.0f64..1.0).prop_map(|(x, y, z)| {
        let n = (x * x + y * y + z * z + 1.0).sqrt();
        [x / n, y / n, z / n, 1.0 / n]
    });
    let number = prop_oneof![-1e300f64..1e300, -1.0f64..1.0];
    (
        1u64..1 << 52,
        number,
        any::<i32>(),
        any::<bool>(),
        unit,
        prop::collection::vec(-1e9f64..1e9, 0..4),
        "[a-zé]{0,8}",
    )
        .prop_map(|(stamp, x, n, on, q, list, name)| {
            let mut row = value(stamp, x, n.into(), if on { "on" } else { "off" }, q, &list, &name);
            row["small"] = json!(1.5);
            row
        })
}

proptest! {
    #[test]
    fn what_lies_between_two_rows_is_a_row_between_them(a in any_value(), b in any_value(), fraction in 0.0f64..=1.0) {
        let ty = row();
        let (bytes_a, bytes_b) = (encode(&ty, &a).unwrap(), encode(&ty, &b).unwrap());
        let got = decode(&ty, &interpolate(&ty, &bytes_a, &bytes_b, fraction).unwrap()).unwrap();
        for key in ["x", "stamp"] {
            let (x, y, z) = (a[key].as_f64().unwrap(), b[key].as_f64().unwrap(), got[key].as_f64().unwrap());
            let slack = 1e-9 * x.abs().max(y.abs());
            prop_assert!(z >= x.min(y) - slack && z <= x.max(y) + slack, "{} is not between {} and {}", z, x, y);
        }
        let nearer = if fraction < 0.5 { &a } else { &b };
        for key in ["n", "mode", "name"] {
            prop_assert_eq!(&got[key], &nearer[key]);
        }
        let norm: f64 = got["orientation"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap().powi(2)).sum();
        prop_assert!((norm - 1.0).abs() < 1e-9, "an orientation of length {}", norm.sqrt());
    }

    #[test]
    fn the_ends_are_exactly_the_rows(a in prop::collection::vec(any::<u8>(), 136), b in prop::collection::vec(any::<u8>(), 136)) {
        prop_assert_eq!(interpolate(&row(), &a, &b, 0.0).unwrap(), a.clone());
        prop_assert_eq!(interpolate(&row(), &a, &b, 1.0).unwrap(), b.clone());
        // Bytes that are no row at all are no reason to panic.
        prop_assert!(interpolate(&row(), &a, &b, 0.3).is_ok());
    }
}
