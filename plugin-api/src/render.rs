//! Renders a [`PluginDesc`] to the manifest's JSON in a const context.
//!
//! Invariant: the same bytes whether called to count (`N = 0`) or to fill; each struct or enum appears once
//! in `types`.

mod out;

use crate::abi::{ABI_MAJOR, ABI_MINOR};
use crate::desc::{
    ArgDesc, ClassDesc, CommandDesc, ConfigFieldDesc, ExecutionLimitsDesc, InputDesc, OutputDesc, PluginDesc,
    PortType, ProvidedDesc, RequiredDesc, TypeDesc, TypeKind,
};
use crate::types::Types;
use out::Out;

/// The manifest and its length. Call with `N = 0` for the length, then with that `N`; the text is padded with
/// spaces to a multiple of 4 bytes.
pub const fn render<const N: usize>(plugin: &PluginDesc) -> ([u8; N], usize) {
    let mut out = Out { buf: [b' '; N], len: 0 };
    out.plugin(plugin);
    let padded = out.len.next_multiple_of(4);
    assert!(N == 0 || N == padded, "call render::<0> first and use its length");
    (out.buf, padded)
}

/// Renders what a class with changing ports writes from `describe`, before its lists of names are filled in:
/// the fixed part of the class, the types of both parts, and under `many` the ports and interfaces to repeat.
/// `N` as in [`render`].
pub const fn render_description<const N: usize>(class: &ClassDesc) -> ([u8; N], usize) {
    let mut out = Out { buf: [b' '; N], len: 0 };
    out.description(class);
    assert!(N == 0 || N == out.len, "call render_description::<0> first and use its length");
    (out.buf, out.len)
}

impl<const N: usize> Out<N> {
    const fn plugin(&mut self, p: &PluginDesc) {
        self.raw("{\"trocar\":1,\"abi\":[");
        self.number(ABI_MAJOR as u64);
        self.byte(b',');
        self.number(ABI_MINOR as u64);
        self.raw("]");
        self.pair("name", p.name, false);
        self.pair("version", p.version, false);
        self.pair("vendor", p.vendor, false);
        self.pair("license", p.license, false);
        self.pair("doc", p.doc, false);
        self.pair("built_with", p.built_with, false);
        self.pair("panic", "unwind", false);
        self.flag("unload", p.unload);
        let mut types = Types::NONE;
        let mut i = 0;
        while i < p.classes.len() {
            types.add_class(p.classes[i]);
            i += 1;
        }
        self.byte(b',');
        self.types(&types);
        self.raw(",\"classes\":[");
        i = 0;
        while i < p.classes.len() {
            self.comma(i);
            self.class(p.classes[i]);
            i += 1;
        }
        self.raw("]}");
    }

    const fn types(&mut self, types: &Types) {
        self.raw("\"types\":[");
        let mut i = 0;
        while i < types.len {
            self.comma(i);
            if let Some(ty) = types.seen[i] {
                self.named_type(ty);
            }
            i += 1;
        }
        self.byte(b']');
    }

    const fn description(&mut self, class: &ClassDesc) {
        let mut types = Types::NONE;
        types.add_class(class);
        self.byte(b'{');
        self.types(&types);
        self.raw(",\"class\":");
        self.class(class);
        self.raw(",\"many\":{");
        self.ports(class.many.inputs, class.many.outputs, class.many.required, class.many.provided);
        self.raw("}}");
    }

    const fn named_type(&mut self, ty: &TypeDesc) {
        self.byte(b'{');
        match &ty.kind {
            TypeKind::Struct { name, doc, fields } => {
                self.pair("name", name, true);
                self.pair_opt("doc", doc);
                self.size(ty);
                self.raw(",\"fields\":[");
                let mut i = 0;
                while i < fields.len() {
                    self.comma(i);
                    self.byte(b'{');
                    self.pair("name", fields[i].name, true);
                    self.key("at", false);
                    self.number(fields[i].at as u64);
                    self.key("type", false);
                    self.type_ref(fields[i].ty);
                    self.pair_opt("unit", fields[i].unit);
                    self.pair_opt("doc", fields[i].doc);
                    self.pair_opt("frame", fields[i].frame);
                    self.byte(b'}');
                    i += 1;
                }
                self.byte(b']');
            }
            TypeKind::Enum { name, repr, values } => {
                self.pair("name", name, true);
                self.size(ty);
                self.pair("enum", repr.name(), false);
                self.raw(",\"values\":[");
                let mut i = 0;
                while i < values.len() {
                    self.comma(i);
                    self.byte(b'{');
                    self.pair("name", values[i].0, true);
                    self.key("value", false);
                    self.signed(values[i].1);
                    self.byte(b'}');
                    i += 1;
                }
                self.byte(b']');
            }
            _ => {}
        }
        self.byte(b'}');
    }

    const fn size(&mut self, ty: &TypeDesc) {
        self.key("size", false);
        self.number(ty.size as u64);
        self.key("align", false);
        self.number(ty.align as u64);
    }

    const fn type_ref(&mut self, ty: &TypeDesc) {
        match &ty.kind {
            TypeKind::Prim(p) => self.text(p.name()),
            TypeKind::Array { item, n } => self.sized("array", item, *n),
            TypeKind::List { item, n } => self.sized("list", item, *n),
            TypeKind::Text { n } => {
                self.raw("{\"text\":");
                self.number(*n as u64);
                self.byte(b'}');
            }
            TypeKind::Enum { name, .. } | TypeKind::Struct { name, .. } => {
                self.raw("{\"ref\":");
                self.text(name);
                self.byte(b'}');
            }
        }
    }

    const fn sized(&mut self, key: &str, item: &TypeDesc, n: usize) {
        self.byte(b'{');
        self.key(key, true);
        self.type_ref(item);
        self.key("n", false);
        self.number(n as u64);
        self.byte(b'}');
    }

    const fn type_opt(&mut self, key: &str, ty: Option<&TypeDesc>) {
        if let Some(ty) = ty {
            self.key(key, false);
            self.type_ref(ty);
        }
    }

    const fn port(&mut self, ty: PortType) {
        match ty {
            PortType::Plain(t) => {
                self.raw("{\"plain\":");
                self.type_ref(t);
                self.byte(b'}');
            }
            PortType::Frame { header, format, max_bytes } => {
                self.raw("{\"frame\":");
                self.type_ref(header);
                self.pair_opt("format", format);
                self.key("max_bytes", false);
                self.number(max_bytes as u64);
                self.byte(b'}');
            }
            PortType::Any => self.raw("\"any\""),
        }
    }

    const fn class(&mut self, c: &ClassDesc) {
        self.byte(b'{');
        self.pair("name", c.name, true);
        self.pair("doc", c.doc, false);
        self.pair("safety", c.safety.name(), false);
        self.flag("hardware", c.hardware);
        self.flag("safe_from_any_thread", c.safe_from_any_thread);
        if c.starts_programs {
            self.flag("starts_programs", true);
        }
        self.raw(",\"execution\":{");
        self.pair("model", c.model, true);
        self.key("period_ns", false);
        self.number(c.period_ns);
        if c.max_step_ns > 0 {
            self.key("max_step_ns", false);
            self.number(c.max_step_ns);
        }
        self.execution_limits(&c.limits);
        self.byte(b'}');
        self.config(c.config);
        self.byte(b',');
        self.ports(c.inputs, c.outputs, c.required, c.provided);
        self.type_opt("state", c.state);
        self.byte(b'}');
    }

    const fn execution_limits(&mut self, limits: &ExecutionLimitsDesc) {
        if !limits.models.is_empty() {
            self.key("models", false);
            self.byte(b'[');
            let mut i = 0;
            while i < limits.models.len() {
                self.comma(i);
                self.text(limits.models[i]);
                i += 1;
            }
            self.byte(b']');
        }
        if limits.min_period_ns > 0 {
            self.key("min_period_ns", false);
            self.number(limits.min_period_ns);
        }
        if limits.max_period_ns > 0 {
            self.key("max_period_ns", false);
            self.number(limits.max_period_ns);
        }
    }

    const fn ports(
        &mut self,
        inputs: &[InputDesc],
        outputs: &[OutputDesc],
        required: &[RequiredDesc],
        provided: &[ProvidedDesc],
    ) {
        self.raw("\"inputs\":[");
        let mut i = 0;
        while i < inputs.len() {
            self.comma(i);
            self.byte(b'{');
            self.pair("name", inputs[i].name, true);
            self.pair_opt("doc", inputs[i].doc);
            self.key("type", false);
            self.port(inputs[i].ty);
            self.pair_opt("frame", inputs[i].frame);
            self.pair_opt("tag", inputs[i].tag);
            self.flag("optional", inputs[i].optional);
            self.key("fifo", false);
            self.number(inputs[i].fifo as u64);
            self.byte(b'}');
            i += 1;
        }
        self.raw("],\"outputs\":[");
        i = 0;
        while i < outputs.len() {
            self.comma(i);
            self.byte(b'{');
            self.pair("name", outputs[i].name, true);
            self.pair_opt("doc", outputs[i].doc);
            self.key("type", false);
            self.port(outputs[i].ty);
            self.pair_opt("frame", outputs[i].frame);
            self.pair_opt("tag", outputs[i].tag);
            self.byte(b'}');
            i += 1;
        }
        self.raw("],\"required\":[");
        i = 0;
        while i < required.len() {
            self.comma(i);
            self.required(&required[i]);
            i += 1;
        }
        self.raw("],\"provided\":[");
        i = 0;
        while i < provided.len() {
            self.comma(i);
            self.provided(&provided[i]);
            i += 1;
        }
        self.byte(b']');
    }

    const fn config(&mut self, fields: &[ConfigFieldDesc]) {
        self.raw(",\"config\":{\"type\":\"object\",\"additionalProperties\":false,\"properties\":{");
        let mut i = 0;
        while i < fields.len() {
            let f = &fields[i];
            self.key(f.name, i == 0);
            self.byte(b'{');
            self.raw(f.schema);
            self.pair_opt("description", f.doc);
            self.pair_opt("unit", f.unit);
            self.literal_opt("minimum", f.min);
            self.literal_opt("maximum", f.max);
            self.literal_opt("default", f.default);
            self.flag("live", f.live);
            self.byte(b'}');
            i += 1;
        }
        self.raw("},\"required\":[");
        i = 0;
        let mut listed = 0;
        while i < fields.len() {
            if fields[i].default.is_empty() {
                self.comma(listed);
                self.text(fields[i].name);
                listed += 1;
            }
            i += 1;
        }
        self.raw("]}");
    }

    const fn required(&mut self, r: &RequiredDesc) {
        self.byte(b'{');
        self.pair("name", r.name, true);
        self.pair_opt("doc", r.doc);
        self.flag("optional", r.optional);
        self.raw(",\"functions\":[");
        let mut i = 0;
        while i < r.functions.len() {
            let f = &r.functions[i];
            self.comma(i);
            self.byte(b'{');
            self.pair("name", f.name, true);
            self.pair_opt("doc", f.doc);
            self.type_opt("arg", f.arg);
            self.type_opt("ret", f.ret);
            self.pair_opt("unit", f.unit);
            self.pair_opt("frame", f.frame);
            self.flag("optional", f.optional);
            self.flag("any", f.any);
            self.byte(b'}');
            i += 1;
        }
        self.raw("],\"handlers\":[");
        i = 0;
        while i < r.handlers.len() {
            let h = &r.handlers[i];
            self.comma(i);
            self.byte(b'{');
            self.pair("name", h.name, true);
            self.pair_opt("doc", h.doc);
            self.type_opt("payload", h.payload);
            self.pair_opt("frame", h.frame);
            self.flag("optional", h.optional);
            self.flag("direct", h.direct);
            self.byte(b'}');
            i += 1;
        }
        self.raw("]}");
    }

    const fn provided(&mut self, p: &ProvidedDesc) {
        self.byte(b'{');
        self.pair("name", p.name, true);
        self.pair_opt("doc", p.doc);
        self.pair_opt("tag", p.tag);
        self.raw(",\"commands\":[");
        let mut i = 0;
        while i < p.commands.len() {
            self.comma(i);
            self.command(&p.commands[i]);
            i += 1;
        }
        self.raw("],\"events\":[");
        i = 0;
        while i < p.events.len() {
            let e = &p.events[i];
            self.comma(i);
            self.byte(b'{');
            self.pair("name", e.name, true);
            self.pair_opt("doc", e.doc);
            self.type_opt("payload", e.payload);
            self.pair_opt("unit", e.unit);
            self.pair_opt("frame", e.frame);
            self.byte(b'}');
            i += 1;
        }
        self.raw("]}");
    }

    const fn command(&mut self, c: &CommandDesc) {
        self.byte(b'{');
        self.pair("name", c.name, true);
        self.pair_opt("doc", c.doc);
        self.pair("kind", c.kind.name(), false);
        if let Some(arg) = &c.arg {
            self.key("arg", false);
            self.arg(arg);
        }
        self.type_opt("ret", c.ret);
        self.pair_opt("ret_unit", c.ret_unit);
        self.pair_opt("ret_frame", c.ret_frame);
        self.pair("overflow", if c.overflow.is_empty() { "reject" } else { c.overflow }, false);
        self.byte(b'}');
    }

    const fn arg(&mut self, a: &ArgDesc) {
        self.byte(b'{');
        self.pair("name", a.name, true);
        self.pair_opt("doc", a.doc);
        self.key("type", false);
        self.type_ref(a.ty);
        self.pair_opt("unit", a.unit);
        self.pair_opt("frame", a.frame);
        self.literal_opt("min", a.min);
        self.literal_opt("max", a.max);
        self.byte(b'}');
    }
}

#[cfg(all(test, feature = "manifest"))]
#[path = "render_tests.rs"]
mod tests;
