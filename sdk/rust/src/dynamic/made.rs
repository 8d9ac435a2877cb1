//! Types that are put together while running: of payloads, arrays, texts and structs, for outputs that a
//! configuration makes.
//!
//! Invariant: such a type is laid out as a `#[repr(C)]` payload without padding, or it is refused here, so
//! that a host takes its description as it takes that of a class.

use super::{AnyType, Field, MAX_SIZE, Node, Shape};
use crate::error::Result;
use crate::payload::Payload;
use serde_json::{Value as Json, json};
use trocar_plugin_api::desc::{TypeDesc, TypeKind};
use trocar_plugin_api::units;

impl AnyType {
    /// The type of a payload that is known when compiling: `AnyType::of::<Pose>()`, `AnyType::of::<f64>()`.
    pub fn of<T: Payload>() -> AnyType {
        AnyType { node: described(T::DESC), format: None }
    }

    /// `n` of these, side by side.
    ///
    /// # Errors
    /// No item, or more than fit into a value.
    pub fn array(item: AnyType, n: usize) -> Result<AnyType> {
        let size = item.node.size.saturating_mul(n);
        fits(AnyType { node: Node { shape: Shape::Array { item: item.node.into(), n }, size }, format: None })
    }

    /// Text of up to `n` bytes, [`crate::Text`].
    ///
    /// # Errors
    /// `n` is not a multiple of 8, or more than fits into a value.
    pub fn text(n: usize) -> Result<AnyType> {
        if n == 0 || !n.is_multiple_of(8) {
            return Err(format!("a text of {n} bytes: give a multiple of 8, such as 64").into());
        }
        let size = n.saturating_add(8);
        fits(AnyType { node: Node { shape: Shape::Text { n }, size }, format: None })
    }

    /// A struct of these fields: name, type, unit (empty without one). It may have the name of a struct that
    /// some other program declares with the same fields: both connect.
    ///
    /// # Errors
    /// There is no field, a name comes twice, a unit is not known, or a field would lie behind a gap: give
    /// larger ones first.
    ///
    /// ```
    /// use trocar_sdk::{AnyType, Stamp};
    /// let fields = [("stamp", AnyType::of::<Stamp>(), ""), ("fz", AnyType::of::<f64>(), "N")];
    /// let force = AnyType::structure("Force", fields).unwrap();
    /// assert_eq!((force.size(), force.unit("fz")), (16, "N"));
    /// let gap = [("on", AnyType::of::<u8>(), ""), ("fz", AnyType::of::<f64>(), "N")];
    /// assert!(AnyType::structure("Gap", gap).unwrap_err().to_string().contains("behind a gap"));
    /// ```
    pub fn structure<'a>(
        name: &str,
        fields: impl IntoIterator<Item = (&'a str, AnyType, &'a str)>,
    ) -> Result<AnyType> {
        let (mut at, mut align) = (0usize, 1);
        let mut made: Vec<Field> = Vec::new();
        for (field, ty, unit) in fields {
            if made.iter().any(|f| f.name == field) {
                return Err(format!("{name}: the field `{field}` is there twice").into());
            }
            units::check(unit).map_err(|why| format!("{name}: field `{field}`: {why}"))?;
            let own = ty.node.align();
            if !at.is_multiple_of(own) {
                return Err(format!(
                    "{name}: field `{field}` would lie behind a gap: give larger fields first"
                )
                .into());
            }
            made.push(Field { name: field.to_owned(), at, unit: unit.to_owned(), node: ty.node.clone() });
            (at, align) = (at.saturating_add(ty.node.size), align.max(own));
        }
        if !at.is_multiple_of(align) {
            let gap = align - at % align;
            return Err(format!(
                "{name}: {gap} B are missing at the end: add a field `reserved`, an array of u8"
            )
            .into());
        }
        let shape = Shape::Struct { name: name.to_owned(), fields: made };
        fits(AnyType { node: Node { shape, size: at }, format: None })
    }

    /// As a port of plain samples is described; [`AnyType::of_port`] reads it.
    pub fn to_port(&self) -> Json {
        let mut types = Vec::new();
        let plain = told(&self.node, &mut types);
        json!({ "plain": plain, "types": types })
    }
}

fn fits(ty: AnyType) -> Result<AnyType> {
    match ty.size() {
        1..=MAX_SIZE => Ok(ty),
        size => Err(format!("a type of {size} bytes: it has 1 to {MAX_SIZE} bytes").into()),
    }
}

fn described(ty: &TypeDesc) -> Node {
    let shape = match &ty.kind {
        TypeKind::Prim(prim) => Shape::Prim(*prim),
        TypeKind::Enum { name, repr, values } => Shape::Enum {
            name: (*name).to_owned(),
            repr: *repr,
            values: values.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect(),
        },
        TypeKind::Array { item, n } => Shape::Array { item: described(item).into(), n: *n },
        TypeKind::List { item, n } => Shape::List { item: described(item).into(), n: *n },
        TypeKind::Text { n } => Shape::Text { n: *n },
        TypeKind::Struct { name, fields, .. } => {
            let field = |f: &trocar_plugin_api::desc::FieldDesc| Field {
                name: f.name.to_owned(),
                at: f.at,
                unit: f.unit.to_owned(),
                node: described(f.ty),
            };
            Shape::Struct { name: (*name).to_owned(), fields: fields.iter().map(field).collect() }
        }
    };
    Node { shape, size: ty.size }
}

/// The spelling of a type; the structs and enums it names go to `types`.
fn told(node: &Node, types: &mut Vec<Json>) -> Json {
    match &node.shape {
        Shape::Prim(prim) => json!(prim.name()),
        Shape::Array { item, n } => json!({ "array": told(item, types), "n": n }),
        Shape::List { item, n } => json!({ "list": told(item, types), "n": n }),
        Shape::Text { n } => json!({ "text": n }),
        Shape::Enum { name, repr, values } => {
            let values: Vec<Json> = values.iter().map(|(n, v)| json!({ "name": n, "value": v })).collect();
            let named = json!({ "name": name, "size": node.size, "align": node.align(), "enum": repr.name(),
                                "values": values });
            refer(name, named, types)
        }
        Shape::Struct { name, fields } => {
            let mut all = Vec::new();
            for f in fields {
                let mut field = json!({ "name": f.name, "at": f.at, "type": told(&f.node, types) });
                if !f.unit.is_empty() {
                    field["unit"] = json!(f.unit);
                }
                all.push(field);
            }
            let named = json!({ "name": name, "size": node.size, "align": node.align(), "fields": all });
            refer(name, named, types)
        }
    }
}

fn refer(name: &str, named: Json, types: &mut Vec<Json>) -> Json {
    if !types.contains(&named) {
        types.push(named);
    }
    json!({ "ref": name })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::data::{JointConfiguration, OperatingState, Pose};

    #[test]
    fn a_payload_is_described_as_its_plugin_describes_it() {
        fn same<T: Payload>() {
            let made = AnyType::of::<T>();
            let read = AnyType::of_port(&made.to_port().to_string()).unwrap();
            assert_eq!((&read, made.size()), (&made, size_of::<T>()));
            let (types, ty) = crate::testing::manifest::described(T::DESC);
            let noted = AnyType::of_port(&json!({ "plain": ty, "types": types }).to_string()).unwrap();
            assert_eq!(noted, made);
        }
        same::<Pose>();
        same::<OperatingState>();
        same::<JointConfiguration>();
        same::<[f32; 3]>();
    }

    #[test]
    fn a_struct_with_a_gap_a_double_name_or_an_unknown_unit_is_refused() {
        let of = |fields: Vec<(&str, AnyType, &str)>| AnyType::structure("T", fields);
        let (f64s, u8s) = (AnyType::of::<f64>, AnyType::of::<u8>);
        for (fields, why) in [
            (vec![], "1 to"),
            (vec![("a", f64s(), ""), ("a", f64s(), "")], "`a` is there twice"),
            (vec![("a", f64s(), "newton")], "did you mean `N`"),
            (vec![("a", u8s(), ""), ("b", f64s(), "")], "`b` would lie behind a gap"),
            (vec![("a", f64s(), ""), ("b", u8s(), "")], "7 B are missing"),
        ] {
            assert!(of(fields).unwrap_err().to_string().contains(why), "{why}");
        }
        assert!(AnyType::text(7).is_err() && AnyType::array(f64s(), 0).is_err());
        assert!(AnyType::array(f64s(), usize::MAX).is_err());
    }
}
