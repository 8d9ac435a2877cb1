//! Collects the structs and enums that descriptions name, each once, items before what contains them.
//!
//! Invariant: two different types never share a name; the build of a plugin that tries fails.

use crate::desc::{
    ClassDesc, InputDesc, OutputDesc, PortType, ProvidedDesc, RequiredDesc, TypeDesc, TypeKind,
};

/// Most distinct structs and enums one plugin may name.
const MAX_TYPES: usize = 256;

pub(crate) struct Types {
    pub(crate) seen: [Option<&'static TypeDesc>; MAX_TYPES],
    pub(crate) len: usize,
}

const fn same_text(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    if a.len() != b.len() {
        return false;
    }
    let mut i = 0;
    while i < a.len() {
        if a[i] != b[i] {
            return false;
        }
        i += 1;
    }
    true
}

const fn named(ty: &TypeDesc) -> Option<&'static str> {
    match &ty.kind {
        TypeKind::Enum { name, .. } | TypeKind::Struct { name, .. } => Some(name),
        _ => None,
    }
}

const fn field_count(ty: &TypeDesc) -> usize {
    match &ty.kind {
        TypeKind::Struct { fields, .. } => fields.len(),
        TypeKind::Enum { values, .. } => values.len(),
        _ => 0,
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
                        assert!(
                            other.size == ty.size && field_count(other) == field_count(ty),
                            "two different payload types of this plugin have the same name"
                        );
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
