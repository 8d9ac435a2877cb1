//! The interfaces of a class, put together from its `#[component]` attribute and the fields that belong to
//! them.
//!
//! Invariant: interfaces with fixed names come before repeated ones, so that ids of the fixed ones never
//! move; repeated provided ones that share a list stand together.

use crate::attrs;
use crate::class::ClassAttr;
use crate::fields::{ComponentFields, Port};
use proc_macro2::{Ident, Span};
use quote::format_ident;
use trocar_plugin_api::limits::{RESERVED_NAME, RESERVED_OUTPUTS};

/// An interface with the ports that belong to it.
pub(crate) struct Interface<'a> {
    pub(crate) name: String,
    /// A lone function is its own interface and lends it its doc.
    pub(crate) doc: String,
    pub(crate) optional: bool,
    pub(crate) ports: Vec<&'a Port>,
    /// Field with the list of names of a repeated interface.
    pub(crate) names: Option<&'a Ident>,
}

impl Interface<'_> {
    fn new(name: &str) -> Self {
        Interface {
            name: name.to_string(),
            doc: String::new(),
            optional: false,
            ports: Vec::new(),
            names: None,
        }
    }

    /// The constant that `#[provides]` makes.
    pub(crate) fn provides_part(&self) -> Ident {
        format_ident!("__TROCAR_PROVIDES_{}", attrs::ident_part(&self.name))
    }

    /// The constant that `#[handles]` makes.
    pub(crate) fn handles_part(&self) -> Ident {
        format_ident!("__TROCAR_HANDLES_{}", attrs::ident_part(&self.name))
    }
}

/// The interfaces of one side.
#[derive(Default)]
pub(crate) struct Interfaces<'a> {
    pub(crate) fixed: Vec<Interface<'a>>,
    pub(crate) many: Vec<Interface<'a>>,
}

impl<'a> Interfaces<'a> {
    pub(crate) fn all(&self) -> impl Iterator<Item = &Interface<'a>> {
        self.fixed.iter().chain(&self.many)
    }

    /// Returns the repeated ones by their lists: those of one list are described name by name, so that a
    /// read, which knows no list, still finds its way.
    pub(crate) fn groups(&self) -> impl Iterator<Item = &[Interface<'a>]> {
        self.many.chunk_by(|a, b| a.names == b.names)
    }
}

pub(crate) fn provided<'a>(class: &ClassAttr, fields: &'a ComponentFields) -> syn::Result<Interfaces<'a>> {
    let mut out: Vec<Interface<'a>> = Vec::new();
    for (name, span) in &class.provides {
        if out.iter().any(|i| i.name == *name) {
            return Err(syn::Error::new(*span, format!("interface `{name}` is listed twice")));
        }
        out.push(Interface::new(name));
    }
    for port in &fields.events {
        join(&mut out, &port.set.interface, port);
    }
    let mut out = split(out, fields, false)?;
    let lists: Vec<Option<&Ident>> = out.many.iter().map(|i| i.names).collect();
    out.many.sort_by_key(|i| lists.iter().position(|list| *list == i.names));
    Ok(out)
}

pub(crate) fn required<'a>(class: &ClassAttr, fields: &'a ComponentFields) -> syn::Result<Interfaces<'a>> {
    let mut out: Vec<Interface<'a>> = Vec::new();
    for port in &fields.functions {
        let lone = port.set.interface.is_empty();
        let own = if port.many { "{}" } else { port.set.name.as_str() };
        let at = join(&mut out, if lone { own } else { &port.set.interface }, port);
        if lone {
            out[at].doc.clone_from(&port.doc);
        }
    }
    for (name, _) in class.requires.iter().chain(&class.optional) {
        if !out.iter().any(|i| i.name == *name) {
            out.push(Interface::new(name));
        }
    }
    for interface in &mut out {
        let all_optional = !interface.ports.is_empty() && interface.ports.iter().all(|p| p.set.optional);
        interface.optional = all_optional || class.optional.iter().any(|(n, _)| *n == interface.name);
    }
    split(out, fields, true)
}

fn join<'a>(out: &mut Vec<Interface<'a>>, name: &str, port: &'a Port) -> usize {
    let at = out.iter().position(|i| i.name == name).unwrap_or_else(|| {
        out.push(Interface::new(name));
        out.len() - 1
    });
    out[at].ports.push(port);
    at
}

/// Fixed and repeated ones, the latter with their list of names.
fn split<'a>(
    all: Vec<Interface<'a>>,
    fields: &'a ComponentFields,
    required: bool,
) -> syn::Result<Interfaces<'a>> {
    let mut out = Interfaces::default();
    for mut interface in all {
        let many = attrs::is_many(&interface.name);
        for port in &interface.ports {
            let say = |why: String| Err(syn::Error::new_spanned(&port.ident, why));
            let name = &interface.name;
            if attrs::is_many(&port.set.name) {
                return say(format!("`{}`: {{}} goes into the name of the interface", port.set.name));
            }
            if many && !port.many {
                return say(format!("interface `{name}` exists many times, so this field is a `Many<…>`"));
            }
            if port.many && !many {
                return say(format!(
                    "a `Many<…>` belongs to an interface with {{}} in its name, not to `{name}`"
                ));
            }
        }
        if !many {
            out.fixed.push(interface);
            continue;
        }
        interface.names = list(&interface, fields, required);
        if interface.names.is_none() {
            let span = interface.ports.first().map_or_else(Span::call_site, |p| p.ident.span());
            let name = &interface.name;
            return Err(syn::Error::new(
                span,
                format!(
                    "interface `{name}` exists many times; add the list of names: `#[names(\"{name}\")] list: Names`"
                ),
            ));
        }
        out.many.push(interface);
    }
    Ok(out)
}

/// The list that names the interface, else one for all, else the only function's own.
fn list<'a>(interface: &Interface<'a>, fields: &'a ComponentFields, required: bool) -> Option<&'a Ident> {
    let lists = &fields.names;
    let named = lists.iter().find(|(_, of)| of.contains(&interface.name));
    let list = named.or_else(|| lists.iter().find(|(_, of)| of.is_empty()));
    match (list, interface.ports.as_slice()) {
        (Some((ident, _)), _) => Some(ident),
        (None, [only]) if required => Some(&only.ident),
        _ => None,
    }
}

/// `process/component/port` must mean one thing.
pub(crate) fn unique_names(
    fields: &ComponentFields,
    provided: &Interfaces<'_>,
    required: &Interfaces<'_>,
    class: &Ident,
) -> syn::Result<()> {
    let interfaces = || provided.all().chain(required.all());
    let ports = fields.inputs.iter().chain(&fields.outputs).map(|p| (p.set.name.clone(), p.ident.span()));
    let named = interfaces().map(|i| {
        let span = i.ports.first().and_then(|p| p.set.span).unwrap_or_else(|| class.span());
        (i.name.clone(), span)
    });
    let mut seen: Vec<String> = Vec::new();
    for (name, span) in ports.chain(named) {
        if name == RESERVED_NAME {
            let why = format!("every component has an interface `{name}` already: choose another name");
            return Err(syn::Error::new(span, why));
        }
        if RESERVED_OUTPUTS.contains(&name.as_str()) {
            let why = format!("every component has an output `{name}` already: choose another name");
            return Err(syn::Error::new(span, why));
        }
        if attrs::is_many(&name) && name == "{}" {
            // Two lists may be called `{}` alone; the names themselves are compared when they are set.
            continue;
        }
        unique(&mut seen, name, span, "inputs, outputs and interfaces share one set of names")?;
    }
    for interface in interfaces() {
        let mut seen = Vec::new();
        for port in &interface.ports {
            unique(&mut seen, port.set.name.clone(), port.ident.span(), "names within an interface differ")?;
        }
    }
    for (list, of) in &fields.names {
        if let Some(name) = of.iter().find(|n| !interfaces().any(|i| i.name == **n)) {
            return Err(syn::Error::new_spanned(
                list,
                format!("no interface is called `{name}`: declare it with provides(…) or requires(…)"),
            ));
        }
    }
    Ok(())
}

fn unique(seen: &mut Vec<String>, name: String, span: Span, why: &str) -> syn::Result<()> {
    if seen.contains(&name) {
        return Err(syn::Error::new(span, format!("`{name}` is used twice: {why}")));
    }
    seen.push(name);
    Ok(())
}
