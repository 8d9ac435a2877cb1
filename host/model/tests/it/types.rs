//! Types: identity, differences in words, copies by name. Also the generators of random types and values.

use proptest::prelude::*;
use serde_json::{Map, Value};
use std::sync::Arc;
use trocar_model::*;

use crate::scene::*;

/// A struct of these members, each name made its own.
fn lay_out(members: Vec<(String, Type, String)>) -> Type {
    let own = |(i, (name, ty, unit)): (usize, (String, Type, String))| (format!("{name}{i}"), ty, unit);
    laid_out(members.into_iter().enumerate().map(own))
}

/// Lays fields out one after the other, aligned, as `repr(C)` would.
pub(crate) fn laid_out(members: impl Iterator<Item = (String, Type, String)>) -> Type {
    let (mut at, mut align, mut fields) = (0usize, 1usize, Vec::new());
    for (name, ty, unit) in members {
        align = align.max(ty.align());
        at = at.next_multiple_of(ty.align());
        let size = ty.size();
        fields.push(field(&name, at, ty, &unit));
        at += size;
    }
    let size = at.next_multiple_of(align);
    Type::Struct(Arc::new(StructType { name: "S".into(), doc: String::new(), size, align, fields }))
}

fn enumeration() -> impl Strategy<Value = Type> {
    let repr = prop::sample::select(vec![Prim::U8, Prim::I16, Prim::I32, Prim::U32]);
    (repr, 1usize..5).prop_map(|(repr, n)| {
        let values = (0..n).map(|i| (format!("V{i}"), i as i64 * 3)).collect();
        Type::Enum(Arc::new(EnumType { name: "E".into(), repr, values }))
    })
}

pub(crate) fn any_type() -> impl Strategy<Value = Type> {
    let leaf = prop_oneof![
        6 => prop::sample::select(Prim::ALL.to_vec()).prop_map(Type::Prim),
        1 => (0usize..20).prop_map(|n| Type::Text { n }),
        1 => enumeration(),
    ];
    leaf.prop_recursive(3, 24, 4, |inner| {
        let member = ("[a-z]{1,4}", inner.clone(), "N|mN|m|");
        prop_oneof![
            (inner.clone(), 0usize..4).prop_map(|(item, n)| Type::Array { item: Box::new(item), n }),
            (inner, 0usize..4).prop_map(|(item, n)| Type::List { item: Box::new(item), n }),
            prop::collection::vec(member, 1..4).prop_map(lay_out),
        ]
    })
}

fn any_prim(p: Prim) -> BoxedStrategy<Value> {
    let big =
        |n: i128| if n.unsigned_abs() > 1 << 53 { Value::from(n.to_string()) } else { Value::from(n as i64) };
    match p {
        Prim::Bool => any::<bool>().prop_map(Value::from).boxed(),
        Prim::U8 => any::<u8>().prop_map(Value::from).boxed(),
        Prim::I8 => any::<i8>().prop_map(Value::from).boxed(),
        Prim::U16 => any::<u16>().prop_map(Value::from).boxed(),
        Prim::I16 => any::<i16>().prop_map(Value::from).boxed(),
        Prim::U32 => any::<u32>().prop_map(Value::from).boxed(),
        Prim::I32 => any::<i32>().prop_map(Value::from).boxed(),
        Prim::U64 | Prim::Stamp => any::<u64>().prop_map(move |n| big(n.into())).boxed(),
        Prim::I64 => any::<i64>().prop_map(move |n| big(n.into())).boxed(),
        Prim::F32 => any::<u32>().prop_map(|bits| float(f32::from_bits(bits).into())).boxed(),
        Prim::F64 => any::<u64>().prop_map(|bits| float(f64::from_bits(bits))).boxed(),
    }
}

fn float(n: f64) -> Value {
    match serde_json::Number::from_f64(n) {
        Some(n) => Value::Number(n),
        None if n.is_nan() => Value::from("NaN"),
        None if n > 0.0 => Value::from("Infinity"),
        None => Value::from("-Infinity"),
    }
}

/// A value of `ty` as it may be typed.
pub(crate) fn any_value(ty: &Type) -> BoxedStrategy<Value> {
    match ty {
        Type::Prim(p) => any_prim(*p),
        Type::Enum(e) => {
            prop::sample::select(e.values.clone()).prop_map(|(name, _)| Value::from(name)).boxed()
        }
        Type::Array { item, n } => prop::collection::vec(any_value(item), *n).prop_map(Value::from).boxed(),
        Type::List { item, n } => {
            prop::collection::vec(any_value(item), 0..=*n).prop_map(Value::from).boxed()
        }
        Type::Text { n } => {
            prop::collection::vec("[a-zé]", 0..=n / 2).prop_map(|v| Value::from(v.concat())).boxed()
        }
        Type::Struct(s) => s
            .fields
            .iter()
            .map(|f| {
                let name = f.name.clone();
                any_value(&f.ty).prop_map(move |v| (name.clone(), v)).boxed()
            })
            .collect::<Vec<_>>()
            .prop_map(|members| Value::Object(members.into_iter().collect::<Map<_, _>>()))
            .boxed(),
    }
}

#[test]
fn a_unit_that_differs_is_named_with_its_field() {
    assert_eq!(
        force("N").first_difference(&force("mN")).unwrap(),
        "field `f[…]` has unit N here and unit mN there"
    );
    let nested = |unit| structure("Contact", 32, vec![field("tip", 0, force(unit), "")]);
    assert_eq!(
        nested("N").first_difference(&nested("")).unwrap(),
        "field `tip.f[…]` has unit N here and no unit there"
    );
}

#[test]
fn a_missing_an_extra_and_a_retyped_field_are_named() {
    let a = structure("P", 16, vec![field("x", 0, f64_type(), "m"), field("y", 8, f64_type(), "m")]);
    let b = structure("P", 8, vec![field("x", 0, f64_type(), "m")]);
    let c = structure("P", 8, vec![field("x", 0, Type::Prim(Prim::I64), "m")]);
    assert_eq!(a.first_difference(&b).unwrap(), "field `y` is missing there");
    assert_eq!(b.first_difference(&a).unwrap(), "field `y` exists there only");
    assert_eq!(b.first_difference(&c).unwrap(), "field `x` is f64 here and i64 there");
}

#[test]
fn a_coordinate_frame_must_agree_as_a_unit_must() {
    let pose = |frame: &str| {
        let mut x = field("x", 0, f64_type(), "m");
        x.frame = frame.into();
        structure("Pose", 8, vec![x])
    };
    let difference = pose("retina").first_difference(&pose("camera")).unwrap();
    assert_eq!(difference, "field `x` is in frame retina here and frame camera there");
    assert_ne!(pose("retina").hash(), pose("camera").hash());
}

#[test]
fn moved_fields_are_found_and_can_be_copied_by_name() {
    let (here, there) = (force("N"), moved_force("N"));
    assert_eq!(
        here.first_difference(&there).unwrap(),
        "field `stamp` lies at byte 0 here and at byte 24 there",
        "an offset is only named where nothing else differs"
    );
    let copies = here.copy_plan(&there).unwrap();
    assert_eq!(copies, [CopyRun { from: 24, to: 0, len: 8 }, CopyRun { from: 0, to: 8, len: 24 }]);
    assert!(!here.can_adapt(&moved_force("mN")), "a unit is never adapted");
}

#[test]
fn documentation_and_the_name_of_a_struct_are_not_part_of_its_identity() {
    let a = structure("Force", 8, vec![field("f", 0, f64_type(), "N")]);
    let mut documented = field("f", 0, f64_type(), "N");
    documented.doc = "at the tip".into();
    let b = structure("TipForce", 8, vec![documented]);
    assert!(a.same(&b) && a.hash() == b.hash() && a.first_difference(&b).is_none());
}

#[test]
fn the_hash_is_fnv_1a_of_the_canonical_text() {
    assert_eq!(f64_type().canonical(), "f64");
    let want =
        "f64".bytes().fold(0xcbf2_9ce4_8422_2325u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3));
    assert_eq!(f64_type().hash(), want);
}

proptest! {
    #[test]
    fn types_have_the_same_canonical_text_only_when_they_are_equal(a in any_type(), b in any_type()) {
        prop_assert_eq!(a.canonical() == b.canonical(), a == b, "{} / {}", a.canonical(), b.canonical());
        prop_assert_eq!(a.first_difference(&b).is_none(), a == b);
        prop_assert!(a.first_difference(&a).is_none());
    }

    #[test]
    fn a_type_adapts_to_itself_in_one_run(ty in any_type()) {
        let plan = ty.copy_plan(&ty).unwrap();
        prop_assert_eq!(plan, vec![CopyRun { from: 0, to: 0, len: ty.size() }]);
    }
}
