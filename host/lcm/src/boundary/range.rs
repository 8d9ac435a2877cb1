//! The declared range of an argument.
//!
//! Invariant: the bytes are checked, wherever they lie, before a component sees them; a declared limit holds
//! for every number of the argument, however deep.

use trocar_model::{Arg, Prim, Type};

/// The declared range of an argument's numbers, checked on the bytes before the component sees them.
#[derive(Clone, Debug)]
pub(crate) struct RangeCheck {
    ty: Type,
    /// Size of one argument.
    bytes: usize,
    /// True when the argument is a single f64, as most are.
    single: bool,
    min: f64,
    max: f64,
}

impl RangeCheck {
    /// `None` when the argument has no declared range.
    pub(crate) fn of(arg: &Arg) -> Option<RangeCheck> {
        if arg.min.is_none() && arg.max.is_none() {
            return None;
        }
        Some(RangeCheck {
            bytes: arg.ty.size(),
            single: arg.ty == Type::Prim(Prim::F64),
            ty: arg.ty.clone(),
            min: arg.min.unwrap_or(f64::NEG_INFINITY),
            max: arg.max.unwrap_or(f64::INFINITY),
        })
    }

    /// As `holds`; also false for bytes too short for the argument's type.
    pub(crate) fn holds_in(&self, arg: &[u8]) -> bool {
        arg.len() >= self.bytes && self.all(&self.ty, &arg[..self.bytes])
    }

    pub(super) fn holds(&self, arg: *const u8) -> bool {
        if self.single {
            // SAFETY: the argument is one f64; it may lie anywhere.
            return self.contains(unsafe { arg.cast::<f64>().read_unaligned() });
        }
        // SAFETY: the argument has the command's type.
        let bytes = unsafe { std::slice::from_raw_parts(arg, self.bytes) };
        self.all(&self.ty, bytes)
    }

    /// A NaN is in no range.
    fn contains(&self, value: f64) -> bool {
        value >= self.min && value <= self.max
    }

    /// Tells whether all numbers of a value are in the range. Stamps, flags, texts and enums do not count as
    /// numbers.
    fn all(&self, ty: &Type, bytes: &[u8]) -> bool {
        match ty {
            Type::Prim(prim) => number(*prim, bytes).is_none_or(|value| self.contains(value)),
            Type::Array { item, n } => self.items(item, *n, bytes),
            Type::List { item, n } => {
                let len = usize::try_from(word(bytes, 8)).unwrap_or(usize::MAX);
                self.items(item, len.min(*n), bytes.get(8..).unwrap_or_default())
            }
            Type::Struct(s) => {
                s.fields.iter().all(|f| bytes.get(f.at..).is_none_or(|bytes| self.all(&f.ty, bytes)))
            }
            Type::Text { .. } | Type::Enum(_) => true,
        }
    }

    fn items(&self, item: &Type, count: usize, bytes: &[u8]) -> bool {
        let size = item.size();
        size == 0 || bytes.chunks_exact(size).take(count).all(|bytes| self.all(item, bytes))
    }
}

/// The number in a primitive; `None` for a primitive that is no quantity.
fn number(prim: Prim, bytes: &[u8]) -> Option<f64> {
    let raw = word(bytes, prim.size());
    Some(match prim {
        Prim::F64 => f64::from_bits(raw),
        Prim::F32 => f64::from(f32::from_bits(raw as u32)),
        Prim::I8 => f64::from(raw as i8),
        Prim::I16 => f64::from(raw as i16),
        Prim::I32 => f64::from(raw as i32),
        Prim::I64 => raw as i64 as f64,
        Prim::U8 | Prim::U16 | Prim::U32 | Prim::U64 => raw as f64,
        Prim::Bool | Prim::Stamp => return None,
    })
}

/// The first `n` (at most 8) bytes as a little-endian number.
fn word(bytes: &[u8], n: usize) -> u64 {
    bytes.iter().take(n).rev().fold(0, |acc, b| acc << 8 | u64::from(*b))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;
    use trocar_model::{Field, StructType, decode, encode};

    use super::*;

    fn field(name: &str, at: usize, ty: Type) -> Field {
        let (unit, doc, frame) = Default::default();
        Field { name: name.into(), at, ty, unit, doc, frame }
    }

    /// Types with a number beside others, in all nestings.
    fn types() -> impl Strategy<Value = Type> {
        let prims = prop::sample::select(Prim::ALL.to_vec()).prop_map(Type::Prim);
        prims.prop_recursive(3, 24, 4, |inner| {
            prop_oneof![
                (inner.clone(), 1..4usize).prop_map(|(item, n)| Type::Array { item: Box::new(item), n }),
                (inner.clone(), 1..4usize).prop_map(|(item, n)| Type::List { item: Box::new(item), n }),
                prop::collection::vec(inner, 1..4).prop_map(|types| {
                    let (mut fields, mut at) = (Vec::new(), 0usize);
                    for (i, ty) in types.into_iter().enumerate() {
                        at = at.next_multiple_of(ty.align());
                        let size = ty.size();
                        fields.push(field(&format!("f{i}"), at, ty));
                        at += size;
                    }
                    let align = fields.iter().map(|f| f.ty.align()).max().unwrap_or(1);
                    let size = at.next_multiple_of(align);
                    Type::Struct(Arc::new(StructType {
                        name: "S".into(),
                        doc: String::new(),
                        size,
                        align,
                        fields,
                    }))
                }),
            ]
        })
    }

    /// The numbers of a value as JSON shows them, without stamps and flags.
    fn numbers(ty: &Type, value: &serde_json::Value, all: &mut Vec<f64>) {
        match ty {
            Type::Prim(Prim::Stamp | Prim::Bool) | Type::Text { .. } | Type::Enum(_) => {}
            Type::Prim(_) => all.push(value.as_f64().unwrap_or(f64::NAN)),
            Type::Array { item, .. } | Type::List { item, .. } => {
                value.as_array().into_iter().flatten().for_each(|value| numbers(item, value, all));
            }
            Type::Struct(s) => s.fields.iter().for_each(|f| numbers(&f.ty, &value[&f.name], all)),
        }
    }

    proptest! {
        #[test]
        fn a_range_holds_for_every_number_however_deep_it_lies(ty in types(), seed: u64) {
            let mut random = Dice(seed);
            let bytes = (0..ty.size()).map(|_| random.roll(256) as u8).collect();
            // As a plugin would have it: with possible lengths and flags.
            let Ok(value) = decode(&ty, &tidied(&ty, bytes, &mut random)) else { return Ok(()) };
            let bytes = encode(&ty, &value).unwrap();
            let arg = Arg {
                name: "a".into(), doc: String::new(), ty: ty.clone(), unit: String::new(),
                min: Some(-100.0), max: Some(100.0),
            };
            let check = RangeCheck::of(&arg).unwrap();
            let mut all = Vec::new();
            numbers(&ty, &value, &mut all);
            let inside = all.iter().all(|n| (-100.0..=100.0).contains(n));
            prop_assert_eq!(check.holds_in(&bytes), inside, "{:?} {:?}", ty, value);
            prop_assert_eq!(check.holds(bytes.as_ptr()), inside);
            prop_assert!(bytes.is_empty() || !check.holds_in(&bytes[1..]));
        }
    }

    /// Numbers by a seed (linear congruential, with Knuth's constants).
    struct Dice(u64);

    impl Dice {
        /// A number below `n`.
        fn roll(&mut self, n: u64) -> u64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 33) % n
        }
    }

    /// Small numbers mostly, flags of 0 or 1, lengths that fit.
    fn tidied(ty: &Type, mut bytes: Vec<u8>, random: &mut Dice) -> Vec<u8> {
        tidy(ty, &mut bytes, random);
        bytes
    }

    fn tidy(ty: &Type, bytes: &mut [u8], random: &mut Dice) {
        let small = random.roll(240) as f64 - 120.0;
        match ty {
            Type::Prim(Prim::F64) => bytes[..8].copy_from_slice(&small.to_le_bytes()),
            Type::Prim(Prim::F32) => bytes[..4].copy_from_slice(&(small as f32).to_le_bytes()),
            Type::Prim(Prim::Bool) => bytes[0] &= 1,
            Type::Prim(prim) if *prim != Prim::Stamp => {
                let small = (small as i64).to_le_bytes();
                bytes[..prim.size()].copy_from_slice(&small[..prim.size()]);
            }
            Type::Array { item, .. } => {
                bytes.chunks_exact_mut(item.size()).for_each(|bytes| tidy(item, bytes, random));
            }
            Type::List { item, n } => {
                bytes[..8].copy_from_slice(&random.roll(*n as u64 + 1).to_le_bytes());
                bytes[8..].chunks_exact_mut(item.size()).for_each(|bytes| tidy(item, bytes, random));
            }
            Type::Struct(s) => {
                for f in &s.fields {
                    let end = f.at + f.ty.size();
                    tidy(&f.ty, &mut bytes[f.at..end], random);
                }
            }
            _ => {}
        }
    }
}
