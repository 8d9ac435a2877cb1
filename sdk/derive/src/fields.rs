//! The fields of a component struct, sorted by what their attribute makes of them.
//!
//! Invariant: order of declaration is the order in the manifest, and with it the order of slots.

use crate::attrs;
use crate::payload::Described;
use proc_macro2::{Ident, Span};
use syn::meta::ParseNestedMeta;
use syn::{Attribute, Data, DeriveInput, Fields, LitInt, LitStr, Meta, Type};

pub(crate) struct Port {
    pub(crate) ident: Ident,
    pub(crate) ty: Type,
    pub(crate) doc: String,
    pub(crate) set: PortSettings,
}

#[derive(Default)]
pub(crate) struct PortSettings {
    pub(crate) name: String,
    pub(crate) optional: bool,
    pub(crate) fifo: usize,
    pub(crate) format: String,
    pub(crate) max_bytes: usize,
    /// Interface of a function or event; empty for a lone function.
    pub(crate) interface: String,
    pub(crate) unit: String,
    pub(crate) span: Option<Span>,
}

#[derive(Default)]
pub(crate) struct ComponentFields {
    pub(crate) inputs: Vec<Port>,
    pub(crate) outputs: Vec<Port>,
    pub(crate) functions: Vec<Port>,
    pub(crate) events: Vec<Port>,
    pub(crate) state: Vec<Described>,
    pub(crate) config: Option<(Ident, Type)>,
    pub(crate) host: Option<Ident>,
    pub(crate) private: Vec<Ident>,
}

const ROLES: [&str; 7] = ["input", "output", "required", "event", "state", "config", "host"];

impl ComponentFields {
    pub(crate) fn of(input: &DeriveInput) -> syn::Result<ComponentFields> {
        let mut out = ComponentFields::default();
        let Data::Struct(data) = &input.data else {
            return Err(syn::Error::new_spanned(&input.ident, "a component is a struct"));
        };
        let named = match &data.fields {
            Fields::Named(named) => &named.named,
            Fields::Unit | Fields::Unnamed(_) => {
                return Err(syn::Error::new_spanned(
                    &input.ident,
                    "a component is a struct with named fields; without any, write `struct Name {}`",
                ));
            }
        };
        for field in named {
            let Some(ident) = &field.ident else { continue };
            let mut role: Option<&Attribute> = None;
            for attr in field.attrs.iter().filter(|a| ROLES.iter().any(|r| a.path().is_ident(r))) {
                if role.replace(attr).is_some() {
                    return Err(syn::Error::new_spanned(attr, "a field has one role; remove one attribute"));
                }
            }
            let Some(attr) = role else {
                out.private.push(ident.clone());
                continue;
            };
            let key = attr.path().get_ident().map(ToString::to_string).unwrap_or_default();
            let port = |set: PortSettings| Port {
                ident: ident.clone(),
                ty: field.ty.clone(),
                doc: attrs::docs(&field.attrs),
                set: named_by(set, ident),
            };
            match key.as_str() {
                "input" => out
                    .inputs
                    .push(port(settings(attr, &["name", "optional", "fifo", "format", "max_bytes"])?)),
                "output" => out.outputs.push(port(settings(attr, &["name", "format", "max_bytes"])?)),
                "required" => {
                    out.functions.push(port(settings(attr, &["name", "interface", "optional", "unit"])?))
                }
                "event" => out.events.push(port(event_settings(attr)?)),
                "state" => out.state.push(Described::of(field, ident)?),
                "config" => {
                    if out.config.replace((ident.clone(), field.ty.clone())).is_some() {
                        return Err(syn::Error::new_spanned(ident, "a component has one #[config] field"));
                    }
                }
                _ => {
                    if out.host.replace(ident.clone()).is_some() {
                        return Err(syn::Error::new_spanned(ident, "a component has one #[host] field"));
                    }
                }
            }
        }
        Ok(out)
    }
}

fn named_by(mut set: PortSettings, ident: &Ident) -> PortSettings {
    if set.name.is_empty() {
        set.name = ident.to_string();
    }
    set.span.get_or_insert_with(|| ident.span());
    set
}

fn settings(attr: &Attribute, allowed: &[&str]) -> syn::Result<PortSettings> {
    let mut set = PortSettings::default();
    if !matches!(attr.meta, Meta::Path(_)) {
        attr.parse_nested_meta(|meta| setting(&mut set, &meta, allowed))?;
    }
    Ok(set)
}

/// `#[event("interface", name = "…", unit = "…")]`.
fn event_settings(attr: &Attribute) -> syn::Result<PortSettings> {
    let mut set = PortSettings::default();
    attr.parse_args_with(|input: syn::parse::ParseStream<'_>| {
        let interface: LitStr = input
            .parse()
            .map_err(|_| input.error("an event belongs to a provided interface: #[event(\"interface\")]"))?;
        attrs::check_name(&interface.value(), interface.span())?;
        set.interface = interface.value();
        set.span = Some(interface.span());
        if !input.is_empty() {
            input.parse::<syn::Token![,]>()?;
            let rest = syn::meta::parser(|meta| setting(&mut set, &meta, &["name", "unit"]));
            syn::parse::Parser::parse2(rest, input.parse()?)?;
        }
        Ok(())
    })?;
    Ok(set)
}

fn setting(set: &mut PortSettings, meta: &ParseNestedMeta<'_>, allowed: &[&str]) -> syn::Result<()> {
    let key = meta.path.get_ident().map(ToString::to_string).unwrap_or_default();
    if !allowed.contains(&key.as_str()) {
        return Err(meta.error(format!("unknown setting; there are {}", allowed.join(", "))));
    }
    let text = |check: bool| -> syn::Result<String> {
        let text = meta.value()?.parse::<LitStr>()?;
        if check {
            attrs::check_name(&text.value(), text.span())?;
        }
        Ok(text.value())
    };
    match key.as_str() {
        "name" => set.name = text(true)?,
        "interface" => set.interface = text(true)?,
        "unit" => set.unit = text(false)?,
        "format" => set.format = text(false)?,
        "optional" => set.optional = true,
        "fifo" => set.fifo = meta.value()?.parse::<LitInt>()?.base10_parse()?,
        _ => set.max_bytes = meta.value()?.parse::<LitInt>()?.base10_parse()?,
    }
    Ok(())
}
