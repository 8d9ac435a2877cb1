//! Copies by name: a value arrives whole in whatever order its fields lie.

use proptest::prelude::*;
use trocar_model::*;

use crate::scene::*;
use crate::types::{any_type, any_value, laid_out};

/// The same type with the fields of every struct in it in another order.
fn shuffled(ty: &Type, seed: &mut u64) -> Type {
    match ty {
        Type::Array { item, n } => Type::Array { item: shuffled(item, seed).into(), n: *n },
        Type::List { item, n } => Type::List { item: shuffled(item, seed).into(), n: *n },
        Type::Struct(s) => {
            let mut fields: Vec<_> =
                s.fields.iter().map(|f| (f.name.clone(), shuffled(&f.ty, seed), f.unit.clone())).collect();
            for last in (1..fields.len()).rev() {
                *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                fields.swap(last, (*seed >> 33) as usize % (last + 1));
            }
            laid_out(fields.into_iter())
        }
        other => other.clone(),
    }
}

/// Returns what a client of `to` sees of `bytes`.
fn copied(to: &Type, from: &Type, bytes: &[u8]) -> Vec<u8> {
    let mut shown = vec![0; to.size()];
    for run in to.copy_plan(from).unwrap() {
        shown[run.to..run.to + run.len].copy_from_slice(&bytes[run.from..run.from + run.len]);
    }
    shown
}

/// A type, the same in another order, and a value of both.
fn two_orders() -> impl Strategy<Value = (Type, Type, serde_json::Value)> {
    (any_type(), any::<u64>()).prop_flat_map(|(from, mut seed)| {
        let to = shuffled(&from, &mut seed);
        let value = any_value(&from);
        (Just(from), Just(to), value)
    })
}

proptest! {
    #[test]
    fn a_value_whose_fields_lie_in_another_order_arrives_whole((from, to, value) in two_orders()) {
        let sent = encode(&from, &value).unwrap();
        let shown = decode(&to, &copied(&to, &from, &sent)).unwrap();
        // NaN is a text here, so equal bits are equal values.
        prop_assert_eq!(shown, decode(&from, &sent).unwrap());
    }

    #[test]
    fn a_copy_plan_stays_within_both_types_and_writes_no_byte_twice((from, to, _) in two_orders()) {
        let mut written = vec![false; to.size()];
        for run in to.copy_plan(&from).unwrap() {
            prop_assert!(run.from + run.len <= from.size() && run.to + run.len <= to.size(), "{:?}", run);
            for byte in &mut written[run.to..run.to + run.len] {
                prop_assert!(!std::mem::replace(byte, true), "{:?} is written twice", run);
            }
        }
    }

    #[test]
    fn two_types_of_no_kin_are_copied_within_their_bounds_or_not_at_all(a in any_type(), b in any_type()) {
        for run in a.copy_plan(&b).unwrap_or_default() {
            prop_assert!(run.from + run.len <= b.size() && run.to + run.len <= a.size(), "{:?}", run);
        }
    }
}

fn point(order: [&str; 2]) -> Type {
    structure("Point", 16, vec![field(order[0], 0, f64_type(), "m"), field(order[1], 8, f64_type(), "m")])
}

#[test]
fn structs_in_structs_arrays_and_lists_are_turned_item_by_item() {
    let (here, there) = (point(["x", "y"]), point(["y", "x"]));
    let turned =
        |at: usize| [CopyRun { from: at + 8, to: at, len: 8 }, CopyRun { from: at, to: at + 8, len: 8 }];
    let array = |item: &Type| Type::Array { item: item.clone().into(), n: 2 };
    assert_eq!(array(&here).copy_plan(&array(&there)).unwrap(), [turned(0), turned(16)].concat());
    let list = |item: &Type| Type::List { item: item.clone().into(), n: 2 };
    let length = CopyRun { from: 0, to: 0, len: 8 };
    let want = [vec![length], turned(8).to_vec(), turned(24).to_vec()].concat();
    assert_eq!(list(&here).copy_plan(&list(&there)).unwrap(), want);
    let nested = |point: &Type, at: usize, other: usize| {
        let fields = vec![field("tip", at, point.clone(), ""), field("load", other, f64_type(), "N")];
        structure("Tool", 24, fields)
    };
    let (here, there) = (nested(&here, 0, 16), nested(&there, 8, 0));
    let want = [(16, 0), (8, 8), (0, 16)].map(|(from, to)| CopyRun { from, to, len: 8 });
    assert_eq!(here.copy_plan(&there).unwrap(), want);
}

#[test]
fn arrays_and_lists_of_another_length_or_with_a_field_of_another_unit_are_not_adapted() {
    let of = |n: usize, item: Type| Type::List { item: item.into(), n };
    assert!(!of(2, point(["x", "y"])).can_adapt(&of(3, point(["y", "x"]))));
    let mm = structure("P", 16, vec![field("y", 0, f64_type(), "mm"), field("x", 8, f64_type(), "m")]);
    assert!(!of(2, point(["x", "y"])).can_adapt(&of(2, mm.clone())) && !point(["x", "y"]).is_scattered(&mm));
}

#[test]
fn more_runs_than_a_step_has_time_for_are_refused_with_that_reason() {
    let cloud = |n: usize, order| Type::Array { item: point(order).into(), n };
    let most = MAX_COPIES / 2;
    assert_eq!(
        cloud(most, ["x", "y"]).copy_plan(&cloud(most, ["y", "x"])).map(|plan| plan.len()),
        Some(MAX_COPIES)
    );
    let (here, there) = (cloud(most + 1, ["x", "y"]), cloud(most + 1, ["y", "x"]));
    assert!(!here.can_adapt(&there) && here.is_scattered(&there));
    let ports = |ty: Type| PortType::Plain(ty);
    let client = Ports { inputs: vec![input("i", ports(here))], ..Ports::default() };
    let server = Ports { outputs: vec![output("o", ports(there))], ..Ports::default() };
    let options = ConnectOptions { adapt: true, ..ConnectOptions::default() };
    let refusal = bindings(&client, &port("a/c/i"), &server, &port("a/s/o"), &options).unwrap_err();
    let text = refusal.to_string();
    let told =
        "; adapt: true cannot help, it would have to copy more than 1024 runs of bytes for each sample";
    assert!(
        text.contains("field `[…].x` lies at byte 0 here and at byte 8 there") && text.ends_with(told),
        "{text}"
    );
    assert!(!refusal.help().contains("Or ask with adapt"), "{}", refusal.help());
}

#[test]
fn a_type_that_cannot_be_is_answered_at_once() {
    let nothing = |order: [&str; 2]| {
        let empty = || Type::Array { item: f64_type().into(), n: 0 };
        structure("Empty", 0, vec![field(order[0], 0, empty(), ""), field(order[1], 0, empty(), "")])
    };
    let endless = |item: Type| Type::Array { item: item.into(), n: usize::MAX };
    assert_eq!(endless(nothing(["a", "b"])).copy_plan(&endless(nothing(["b", "a"]))), Some(vec![]));
    assert!(endless(point(["x", "y"])).is_scattered(&endless(point(["y", "x"]))));
}
