//! Collects the structs and enums that descriptions name, each once, items before the types that contain
//! them.
//!
//! Invariant: two different types never share a name; the build of a plugin that tries fails.

use crate::const_text::{Sentence, same_text};
use crate::desc::{
    ClassDesc, InputDesc, OutputDesc, PortType, ProvidedDesc, RequiredDesc, TypeDesc, TypeKind,
};

/// Most distinct structs and enums one plugin may name.
const MAX_TYPES: usize = 256;

pub(crate) struct Types {
    pub(crate) seen: [Option<&'static TypeDesc>; MAX_TYPES],
    pub(crate) len: usize,
}

const fn named(ty: &TypeDesc) -> Option<&'static str> {
    match &ty.kind {
        TypeKind::Enum { name, .. } | TypeKind::Struct { name, .. } => Some(name),
        _ => None,
    }
}

/// Tells whether two descriptions agree in all that a manifest says of a type except its doc comments.
const fn same(a: &TypeDesc, b: &TypeDesc) -> bool {
    if a.size != b.size || a.align != b.align {
        return false;
    }
    match (&a.kind, &b.kind) {
        (TypeKind::Prim(a), TypeKind::Prim(b)) => *a as u8 == *b as u8,
        (TypeKind::Array { item: a, n }, TypeKind::Array { item: b, n: m })
        | (TypeKind::List { item: a, n }, TypeKind::List { item: b, n: m }) => *n == *m && same(a, b),
        (TypeKind::Text { n }, TypeKind::Text { n: m }) => *n == *m,
        (
            TypeKind::Enum { name, repr, values },
            TypeKind::Enum { name: other_name, repr: other_repr, values: others },
        ) => {
            let mut i = 0;
            while i < values.len() && values.len() == others.len() {
                if !same_text(values[i].0, others[i].0) || values[i].1 != others[i].1 {
                    return false;
                }
                i += 1;
            }
            same_text(name, other_name) && *repr as u8 == *other_repr as u8 && values.len() == others.len()
        }
        (TypeKind::Struct { name, fields, .. }, TypeKind::Struct { name: other, fields: others, .. }) => {
            if !same_text(name, other) || fields.len() != others.len() {
                return false;
            }
            let mut i = 0;
            while i < fields.len() {
                let (f, g) = (&fields[i], &others[i]);
                let texts =
                    same_text(f.name, g.name) && same_text(f.unit, g.unit) && same_text(f.frame, g.frame);
                if f.at != g.at || !texts || !same(f.ty, g.ty) {
                    return false;
                }
                i += 1;
            }
            true
        }
        _ => false,
    }
}

impl Types {
    pub(crate) const NONE: Types = Types { seen: [None; MAX_TYPES], len: 0 };

    const fn add(&mut self, ty: &'static TypeDesc) {
        match &ty.kind {
            TypeKind::Array { item, .. } | TypeKind::List { item, .. } => self.add(item),
            TypeKind::Prim(_) | TypeKind::Text { .. } => {}
            TypeKind::Enum { name, .. } | TypeKind::Struct { name, .. } => {
                let mut i = 0;
                while i < self.len {
                    if let Some(other) = self.seen[i]
                        && let Some(other_name) = named(other)
                        && same_text(other_name, name)
                    {
                        if !same(other, ty) {
                            let sentence =
                                Sentence::of("two different payload types of this plugin are called `");
                            sentence.text(name).text("`: rename one").fail();
                        }
                        return;
                    }
                    i += 1;
                }
                if let TypeKind::Struct { fields, .. } = &ty.kind {
                    let mut f = 0;
                    while f < fields.len() {
                        self.add(fields[f].ty);
                        f += 1;
                    }
                }
                assert!(self.len < MAX_TYPES, "a plugin may name at most 256 payload types");
                self.seen[self.len] = Some(ty);
                self.len += 1;
            }
        }
    }

    const fn add_opt(&mut self, ty: Option<&'static TypeDesc>) {
        if let Some(ty) = ty {
            self.add(ty);
        }
    }

    const fn add_port(&mut self, ty: PortType) {
        match ty {
            PortType::Plain(t) | PortType::Frame { header: t, .. } => self.add(t),
            PortType::Any => {}
        }
    }

    pub(crate) const fn add_class(&mut self, class: &ClassDesc) {
        self.add_ports(class.inputs, class.outputs, class.required, class.provided);
        self.add_ports(class.many.inputs, class.many.outputs, class.many.required, class.many.provided);
        self.add_opt(class.state);
    }

    const fn add_ports(
        &mut self,
        inputs: &[InputDesc],
        outputs: &[OutputDesc],
        required: &[RequiredDesc],
        provided: &[ProvidedDesc],
    ) {
        let mut i = 0;
        while i < inputs.len() {
            self.add_port(inputs[i].ty);
            i += 1;
        }
        i = 0;
        while i < outputs.len() {
            self.add_port(outputs[i].ty);
            i += 1;
        }
        i = 0;
        while i < required.len() {
            let mut j = 0;
            while j < required[i].functions.len() {
                self.add_opt(required[i].functions[j].arg);
                self.add_opt(required[i].functions[j].ret);
                j += 1;
            }
            j = 0;
            while j < required[i].handlers.len() {
                self.add_opt(required[i].handlers[j].payload);
                j += 1;
            }
            i += 1;
        }
        i = 0;
        while i < provided.len() {
            let mut j = 0;
            while j < provided[i].commands.len() {
                if let Some(arg) = &provided[i].commands[j].arg {
                    self.add(arg.ty);
                }
                self.add_opt(provided[i].commands[j].ret);
                j += 1;
            }
            j = 0;
            while j < provided[i].events.len() {
                self.add_opt(provided[i].events[j].payload);
                j += 1;
            }
            i += 1;
        }
    }
}
