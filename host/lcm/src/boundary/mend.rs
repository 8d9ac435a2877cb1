//! Makes any bytes a value of a type: bytes that another process wrote are looked at by code that relies on
//! its types.
//!
//! Invariant: the bytes of a valid value stay as they are. Flags become 0 or 1, lengths at most the room
//! there is; no other bits could be wrong.

use trocar_model::{Prim, Type};

/// Places in a value whose bits could be wrong.
#[derive(Default)]
pub(crate) struct Mend {
    /// Bytes that are 0 or 1, from and how many.
    flags: Vec<(usize, usize)>,
    /// Lengths, and the most each may be.
    lengths: Vec<(usize, u64)>,
}

impl Mend {
    pub(crate) fn of(ty: &Type) -> Mend {
        let mut mend = Mend::default();
        mend.add(ty, 0);
        mend
    }

    fn add(&mut self, ty: &Type, at: usize) {
        match ty {
            Type::Prim(prim) => self.add_prim(*prim, at),
            Type::Enum(named) => self.add_prim(named.repr, at),
            Type::Array { item, n } => self.add_items(item, *n, at),
            Type::List { item, n } => {
                self.lengths.push((at, *n as u64));
                self.add_items(item, *n, at + 8);
            }
            Type::Text { n } => self.lengths.push((at, *n as u64)),
            Type::Struct(fields) => fields.fields.iter().for_each(|f| self.add(&f.ty, at + f.at)),
        }
    }

    fn add_prim(&mut self, prim: Prim, at: usize) {
        if prim != Prim::Bool {
            return;
        }
        match self.flags.last_mut() {
            Some((from, n)) if *from + *n == at => *n += 1,
            _ => self.flags.push((at, 1)),
        }
    }

    fn add_items(&mut self, item: &Type, n: usize, at: usize) {
        let mut first = Mend::default();
        first.add(item, 0);
        // An item without such places adds none, whatever the count.
        if !first.flags.is_empty() || !first.lengths.is_empty() {
            (0..n).for_each(|i| self.add(item, at + i * item.size()));
        }
    }

    /// Real-time.
    pub(crate) fn mend(&self, value: &mut [u8]) {
        for (from, n) in &self.flags {
            if let Some(flags) = value.get_mut(*from..from + n) {
                flags.iter_mut().for_each(|flag| *flag = u8::from(*flag != 0));
            }
        }
        for (at, most) in &self.lengths {
            if let Some(length) = value.get_mut(*at..).and_then(|rest| rest.first_chunk_mut::<8>()) {
                *length = u64::from_ne_bytes(*length).min(*most).to_ne_bytes();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use trocar_model::{Field, StructType};

    use super::*;

    fn structure(fields: Vec<(usize, Type)>, size: usize) -> Type {
        let field = |(at, ty)| Field {
            name: format!("f{at}"),
            at,
            ty,
            unit: String::new(),
            doc: String::new(),
            frame: String::new(),
        };
        let fields = fields.into_iter().map(field).collect();
        Type::Struct(Arc::new(StructType { name: "S".into(), doc: String::new(), size, align: 8, fields }))
    }

    fn flags(n: usize) -> Type {
        Type::Array { item: Box::new(Type::Prim(Prim::Bool)), n }
    }

    #[test]
    fn any_bits_become_a_value_and_a_value_stays_as_it_is() {
        let inner = structure(vec![(0, flags(8)), (8, Type::Text { n: 8 })], 24);
        let list = Type::List { item: Box::new(inner), n: 3 };
        let ty = structure(vec![(0, Type::Prim(Prim::F64)), (8, list), (88, flags(8))], 96);
        let mend = Mend::of(&ty);
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        };
        for round in 0..1000 {
            let mut bytes: Vec<u8> = (0..96).map(|_| if round == 0 { 0xff } else { random() }).collect();
            let raw = bytes.clone();
            mend.mend(&mut bytes);
            assert_eq!(bytes[..8], raw[..8], "a number has no wrong bits");
            for at in [16, 40, 64, 88] {
                assert!(bytes[at..at + 8].iter().all(|flag| *flag <= 1), "{bytes:?}");
            }
            for (at, most) in [(8, 3), (24, 8), (48, 8), (72, 8)] {
                let length = u64::from_ne_bytes(bytes[at..at + 8].try_into().unwrap());
                assert!(length <= most, "{length} at {at}");
            }
            let again = bytes.clone();
            mend.mend(&mut bytes);
            assert_eq!(bytes, again);
        }
    }

    #[test]
    fn a_row_of_plain_numbers_costs_nothing() {
        let numbers = Type::Array { item: Box::new(Type::Prim(Prim::F64)), n: 8192 };
        let mend = Mend::of(&numbers);
        assert_eq!((mend.flags.len(), mend.lengths.len()), (0, 0));
        assert_eq!(Mend::of(&flags(4096)).flags, [(0, 4096)], "neighbours are one run");
    }

    #[test]
    fn bytes_that_are_too_few_are_left_alone() {
        let mend = Mend::of(&Type::Text { n: 4 });
        let mut short = [0xff; 5];
        mend.mend(&mut short);
        assert_eq!(short, [0xff; 5]);
    }
}
