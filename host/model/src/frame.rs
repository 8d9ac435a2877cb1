//! Coordinate frames of whole values: a port, argument or result that says in which frame its payload is.
//!
//! Invariant: a frame of the whole value is the same as that frame at each field that holds coordinates. So
//! two ends are compared field by field wherever their authors have named it. `trocar-plugin-api` asks the
//! same when a plugin is compiled.

use std::sync::Arc;

use crate::types::{Field, StructType};
use crate::{Prim, Type};

impl Type {
    /// Returns this type with everything that holds coordinates in `frame`; fields that name a frame keep
    /// theirs. `None` when no field is left to get it: coordinates are the arrays of floating point numbers
    /// in structs, such as the position and orientation of a pose.
    pub fn in_frame(&self, frame: &str) -> Option<Type> {
        match self {
            Type::Array { item, n } => Some(Type::Array { item: Box::new(item.in_frame(frame)?), n: *n }),
            Type::List { item, n } => Some(Type::List { item: Box::new(item.in_frame(frame)?), n: *n }),
            Type::Struct(s) => {
                let mut said = false;
                let fields = s.fields.iter().map(|f| match field(f, frame) {
                    Some(framed) => {
                        said = true;
                        framed
                    }
                    None => f.clone(),
                });
                let fields = fields.collect();
                let (name, doc) = (s.name.clone(), s.doc.clone());
                said.then(|| {
                    Type::Struct(Arc::new(StructType { name, doc, size: s.size, align: s.align, fields }))
                })
            }
            Type::Prim(_) | Type::Text { .. } | Type::Enum(_) => None,
        }
    }
}

fn field(field: &Field, frame: &str) -> Option<Field> {
    if !field.frame.is_empty() {
        return None;
    }
    let ty = if is_vector(&field.ty) { field.ty.clone() } else { field.ty.in_frame(frame)? };
    Some(Field { ty, frame: frame.to_owned(), ..field.clone() })
}

/// Numbers side by side, of one row or of several.
fn is_vector(ty: &Type) -> bool {
    match ty {
        Type::Array { item, .. } => matches!(**item, Type::Prim(Prim::F32 | Prim::F64)) || is_vector(item),
        _ => false,
    }
}
