//! The parts of a type known only while running, for code that walks through it: encoders of other formats,
//! forms.
//!
//! Invariant: places and sizes are those that were checked when the description was read.

use super::{AnyType, Node, Shape};

/// One part of a type: the whole, a field, an item.
#[derive(Clone, Copy, Debug)]
pub struct AnyPart<'a> {
    node: &'a Node,
}

/// Kind of a part.
#[derive(Clone, Debug)]
pub enum AnyShape<'a> {
    /// "bool", "u8", … "f64", or "stamp".
    Number(&'static str),
    /// Named integers, carried by this number.
    Enum {
        /// The integer's primitive, such as "u32".
        number: &'static str,
        /// Names and their numbers.
        values: &'a [(String, i64)],
    },
    /// Items side by side.
    Array {
        /// Type of one item.
        item: AnyPart<'a>,
        /// Number of items.
        n: usize,
    },
    /// A length as u64, then room for `n` items.
    List {
        /// Type of one item.
        item: AnyPart<'a>,
        /// Most items.
        n: usize,
    },
    /// A length in bytes as u64, then room for `n` bytes of UTF-8.
    Text {
        /// Most bytes.
        n: usize,
    },
    /// Fields, each at its own place.
    Struct {
        /// The struct's name.
        name: &'a str,
        /// The fields in the order of their declaration.
        fields: Vec<AnyField<'a>>,
    },
}

/// A field of a struct.
#[derive(Clone, Copy, Debug)]
pub struct AnyField<'a> {
    /// The field's name.
    pub name: &'a str,
    /// Bytes from the begin of the struct.
    pub at: usize,
    /// Empty without one.
    pub unit: &'a str,
    /// The field's type.
    pub part: AnyPart<'a>,
}

impl AnyType {
    /// The type as its parts. Walking allocates: not for `step`, once per connection.
    pub fn part(&self) -> AnyPart<'_> {
        AnyPart { node: &self.node }
    }
}

impl<'a> AnyPart<'a> {
    /// Bytes.
    pub fn size(&self) -> usize {
        self.node.size
    }

    /// Kind of this part, with the parts inside it. Allocates for a struct.
    pub fn shape(&self) -> AnyShape<'a> {
        match &self.node.shape {
            Shape::Prim(prim) => AnyShape::Number(prim.name()),
            Shape::Enum { repr, values, .. } => AnyShape::Enum { number: repr.name(), values },
            Shape::Array { item, n } => AnyShape::Array { item: AnyPart { node: item }, n: *n },
            Shape::List { item, n } => AnyShape::List { item: AnyPart { node: item }, n: *n },
            Shape::Text { n } => AnyShape::Text { n: *n },
            Shape::Struct { name, fields } => AnyShape::Struct {
                name,
                fields: fields
                    .iter()
                    .map(|f| AnyField {
                        name: &f.name,
                        at: f.at,
                        unit: &f.unit,
                        part: AnyPart { node: &f.node },
                    })
                    .collect(),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_type_is_walked_down_to_its_numbers() {
        let text = r#"{"plain": {"ref": "A"}, "types": [{"name": "A", "size": 40, "fields": [
            {"name": "t", "at": 0, "type": "stamp"},
            {"name": "p", "at": 8, "unit": "m", "type": {"array": "f64", "n": 2}},
            {"name": "who", "at": 24, "type": {"text": 8}}]}]}"#;
        let ty = AnyType::of_port(text).expect("a description");
        let AnyShape::Struct { name, fields } = ty.part().shape() else { panic!("a struct") };
        assert_eq!((name, fields.len(), ty.part().size()), ("A", 3, 40));
        assert_eq!((fields[1].name, fields[1].at, fields[1].unit), ("p", 8, "m"));
        assert!(matches!(fields[0].part.shape(), AnyShape::Number("stamp")));
        let AnyShape::Array { item, n: 2 } = fields[1].part.shape() else { panic!("two numbers") };
        assert!(matches!(item.shape(), AnyShape::Number("f64")));
        assert!(matches!(fields[2].part.shape(), AnyShape::Text { n: 8 }));
    }
}
