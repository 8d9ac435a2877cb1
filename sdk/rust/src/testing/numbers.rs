//! The numbers in a payload, for tests that hold for all of them.
//!
//! Invariant: floating point numbers alone, in the order of the fields; of a list only the items it has.

use crate::payload::{Payload, as_bytes};
use trocar_plugin_api::desc::{Prim, TypeDesc, TypeKind};

/// All floating point numbers of a payload: of a sample, an event, or a
/// [`Bench::state`](super::Bench::state).
///
/// ```
/// use trocar_sdk::{prelude::*, testing::numbers};
/// #[derive(Payload, Clone, Copy)]
/// #[repr(C)]
/// struct Force { stamp: Stamp, f: [f64; 3] }
/// assert_eq!(numbers(&Force { stamp: Stamp::from_ns(7), f: [1.0, 2.0, 3.0] }), [1.0, 2.0, 3.0]);
/// ```
pub fn numbers<T: Payload>(value: &T) -> Vec<f64> {
    let mut found = Vec::new();
    walk(T::DESC, as_bytes(value), &mut found);
    found
}

fn walk(ty: &TypeDesc, bytes: &[u8], found: &mut Vec<f64>) {
    match &ty.kind {
        TypeKind::Prim(Prim::F64) => found.extend(bytes.first_chunk().map(|b| f64::from_ne_bytes(*b))),
        TypeKind::Prim(Prim::F32) => {
            found.extend(bytes.first_chunk().map(|b| f64::from(f32::from_ne_bytes(*b))));
        }
        TypeKind::Array { item, n } => items(item, bytes, *n, found),
        TypeKind::List { item, n } => {
            if let Some((len, bytes)) = bytes.split_first_chunk() {
                items(item, bytes, (u64::from_ne_bytes(*len) as usize).min(*n), found);
            }
        }
        TypeKind::Struct { fields, .. } => {
            fields.iter().for_each(|field| walk(field.ty, bytes.get(field.at..).unwrap_or_default(), found));
        }
        TypeKind::Prim(_) | TypeKind::Text { .. } | TypeKind::Enum { .. } => {}
    }
}

fn items(item: &TypeDesc, bytes: &[u8], n: usize, found: &mut Vec<f64>) {
    bytes.chunks_exact(item.size.max(1)).take(n).for_each(|bytes| walk(item, bytes, found));
}

#[cfg(test)]
mod tests {
    use super::numbers;
    use crate::data::{Distance, JointState};
    use crate::values::{List, Stamp};

    #[test]
    fn the_numbers_of_a_payload_are_its_floating_point_numbers_as_far_as_lists_go() {
        let position = List::of(&[1.0, 2.0]);
        assert_eq!(numbers(&JointState { position, ..JointState::default() }), [1.0, 2.0]);
        let distance = Distance { stamp: Stamp::from_ns(7), distance: 3.0, ..Distance::default() };
        assert_eq!(numbers(&distance), [3.0, 0.0, 0.0, 0.0]);
        assert_eq!(numbers(&[1.5f32, 2.0]), [1.5, 2.0]);
    }
}
