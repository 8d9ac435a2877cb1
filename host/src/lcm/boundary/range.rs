//! The declared range of an argument.
//!
//! Invariant: looked at on the bytes, wherever they lie, before a component sees them.

use trocar_model::{Arg, Prim, Type};

/// The declared range of a numeric argument, checked on the bytes before the component sees them.
#[derive(Clone, Debug)]
pub(in crate::lcm) struct RangeCheck {
    prim: Prim,
    count: usize,
    /// The count stands in a u64 before the items.
    list: bool,
    min: f64,
    max: f64,
}

impl RangeCheck {
    /// `None` when the argument has no declared range or is not made of numbers.
    pub(in crate::lcm) fn of(arg: &Arg) -> Option<RangeCheck> {
        if arg.min.is_none() && arg.max.is_none() {
            return None;
        }
        let (item, count, list) = match &arg.ty {
            Type::Prim(p) => (*p, 1, false),
            Type::Array { item, n } => match &**item {
                Type::Prim(p) => (*p, *n, false),
                _ => return None,
            },
            Type::List { item, n } => match &**item {
                Type::Prim(p) => (*p, *n, true),
                _ => return None,
            },
            _ => return None,
        };
        Some(RangeCheck {
            prim: item,
            count,
            list,
            min: arg.min.unwrap_or(f64::NEG_INFINITY),
            max: arg.max.unwrap_or(f64::INFINITY),
        })
    }

    /// As `holds`; false as well for what is too short for the argument's type.
    pub(in crate::lcm) fn holds_in(&self, arg: &[u8]) -> bool {
        let bytes = Type::Prim(self.prim).size() * self.count + if self.list { 8 } else { 0 };
        arg.len() >= bytes && self.holds(arg.as_ptr())
    }

    pub(super) fn holds(&self, arg: *const u8) -> bool {
        if self.prim == Prim::F64 && self.count == 1 && !self.list {
            // SAFETY: the argument is one f64; it may lie anywhere.
            let value = unsafe { arg.cast::<f64>().read_unaligned() };
            return value >= self.min && value <= self.max;
        }
        let size = Type::Prim(self.prim).size();
        let skip = if self.list { 8 } else { 0 };
        // SAFETY: the argument has the command's type: an optional length, then room for `count` items.
        let bytes = unsafe { std::slice::from_raw_parts(arg, skip + size * self.count) };
        let count = if self.list { (word(bytes, 8) as usize).min(self.count) } else { self.count };
        bytes[skip..].chunks_exact(size).take(count).all(|item| {
            let value = self.number(item);
            value >= self.min && value <= self.max
        })
    }

    fn number(&self, item: &[u8]) -> f64 {
        let raw = word(item, item.len());
        match self.prim {
            Prim::F64 => f64::from_bits(raw),
            Prim::F32 => f64::from(f32::from_bits(raw as u32)),
            Prim::I8 => f64::from(raw as i8),
            Prim::I16 => f64::from(raw as i16),
            Prim::I32 => f64::from(raw as i32),
            Prim::I64 => raw as i64 as f64,
            Prim::Bool | Prim::U8 | Prim::U16 | Prim::U32 | Prim::U64 | Prim::Stamp => raw as f64,
        }
    }
}

/// The first `n` (at most 8) bytes as a little-endian number.
fn word(bytes: &[u8], n: usize) -> u64 {
    bytes.iter().take(n).rev().fold(0, |acc, b| acc << 8 | u64::from(*b))
}
