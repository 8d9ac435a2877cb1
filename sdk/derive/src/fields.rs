//! The fields of a component struct, sorted by what their attribute makes of them.
//!
//! Invariant: order of declaration is the order in the manifest, and with it the order of slots.

use crate::attrs::{self, Frame};
use crate::payload::Described;
use proc_macro2::{Ident, Span};
use syn::meta::ParseNestedMeta;
use syn::punctuated::Punctuated;
use syn::{
    Attribute, Data, DeriveInput, Field, Fields, GenericArgument, LitInt, LitStr, Meta, PathArguments, Type,
};
use trocar_plugin_api::limits::{MAX_FIFO, MAX_FRAME};

pub(crate) struct Port {
    pub(crate) ident: Ident,
    /// Type of the port; for a repeated port, the type of one.
    pub(crate) ty: Type,
    /// The field is a `Many<…>`.
    pub(crate) many: bool,
    pub(crate) doc: String,
    pub(crate) frame: Frame,
    pub(crate) set: PortSettings,
}

#[derive(Default)]
pub(crate) struct PortSettings {
    pub(crate) name: String,
    /// The author gave the name.
    named: bool,
    pub(crate) tag: String,
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
    /// Lists of names, with the repeated interfaces they are for; without any, for all.
    pub(crate) names: Vec<(Ident, Vec<String>)>,
    pub(crate) private: Vec<Ident>,
}

const ROLES: [&str; 8] = ["input", "output", "required", "event", "state", "config", "host", "names"];

impl ComponentFields {
    pub(crate) fn of(input: &DeriveInput) -> syn::Result<ComponentFields> {
        let mut out = ComponentFields::default();
        for field in named_fields(input)? {
            let Some(ident) = &field.ident else { continue };
            match role(field)? {
                Some(attr) => out.add(attr, field, ident)?,
                None if is_host(&field.ty) => {
                    return Err(syn::Error::new_spanned(
                        field,
                        "a `Host` comes from the host and has no default: mark the field #[host]",
                    ));
                }
                None => out.private.push(ident.clone()),
            }
        }
        Ok(out)
    }

    /// Adds a field that has a role.
    fn add(&mut self, attr: &Attribute, field: &Field, ident: &Ident) -> syn::Result<()> {
        let key = attr.path().get_ident().map(ToString::to_string).unwrap_or_default();
        misplaced(field, &key)?;
        let frame = Frame::of(&field.attrs)?;
        let port = |set: PortSettings| Port::of(field, ident, frame, set);
        match key.as_str() {
            "input" => {
                let allowed = ["name", "optional", "fifo", "format", "max_bytes", "tag"];
                self.inputs.push(repeated(port(settings(attr, &allowed)?)).and_then(Port::named)?);
            }
            "output" => {
                let allowed = ["name", "format", "max_bytes", "tag"];
                self.outputs.push(repeated(port(settings(attr, &allowed)?)).and_then(Port::named)?);
            }
            "required" => {
                let allowed = ["name", "interface", "optional", "unit"];
                self.functions.push(port(settings(attr, &allowed)?).named()?);
            }
            "event" => self.events.push(port(event_settings(attr)?).named()?),
            "names" => self.names.push((ident.clone(), interfaces(attr)?)),
            "state" => self.state.push(Described::of(field, ident)?),
            "config" => {
                if self.config.replace((ident.clone(), field.ty.clone())).is_some() {
                    return Err(syn::Error::new_spanned(ident, "a component has one #[config] field"));
                }
            }
            _ => {
                if self.host.replace(ident.clone()).is_some() {
                    return Err(syn::Error::new_spanned(ident, "a component has one #[host] field"));
                }
            }
        }
        Ok(())
    }
}

impl Port {
    fn of(field: &Field, ident: &Ident, frame: Frame, set: PortSettings) -> Port {
        let one = inside_many(&field.ty);
        Port {
            ident: ident.clone(),
            ty: one.unwrap_or(&field.ty).clone(),
            many: one.is_some(),
            doc: attrs::docs(&field.attrs),
            frame,
            set,
        }
    }

    /// Takes the name and the place of the field where the author gives none.
    fn named(mut self) -> syn::Result<Port> {
        if self.set.name.is_empty() {
            self.set.name = attrs::name_of(&self.ident)?;
        }
        self.set.span.get_or_insert_with(|| self.ident.span());
        Ok(self)
    }
}

fn named_fields(input: &DeriveInput) -> syn::Result<&Punctuated<Field, syn::Token![,]>> {
    let Data::Struct(data) = &input.data else {
        return Err(syn::Error::new_spanned(&input.ident, "a component is a struct"));
    };
    match &data.fields {
        Fields::Named(named) => Ok(&named.named),
        Fields::Unit | Fields::Unnamed(_) => Err(syn::Error::new_spanned(
            &input.ident,
            "a component is a struct with named fields; without any, write `struct Name {}`",
        )),
    }
}

/// Returns the attribute that says the role of a field; none for the author's own fields.
fn role(field: &Field) -> syn::Result<Option<&Attribute>> {
    let mut role = None;
    for attr in field.attrs.iter().filter(|a| ROLES.iter().any(|r| a.path().is_ident(r))) {
        if role.replace(attr).is_some() {
            return Err(syn::Error::new_spanned(attr, "a field has one role; remove one attribute"));
        }
    }
    Ok(role)
}

/// Refuses `#[unit]` and `#[frame]` where they say nothing.
fn misplaced(field: &Field, role: &str) -> syn::Result<()> {
    for attr in &field.attrs {
        let why = match role {
            "state" => continue,
            "required" | "event" if attr.path().is_ident("unit") => {
                "here the unit is a setting of the attribute before: unit = \"…\""
            }
            _ if attr.path().is_ident("unit") => {
                "units of a port are those of its payload's fields: put this there"
            }
            "config" | "host" | "names" if attr.path().is_ident("frame") => {
                "a coordinate frame belongs to a port or a column of the state table"
            }
            _ => continue,
        };
        return Err(syn::Error::new_spanned(attr, why));
    }
    Ok(())
}

/// Tells whether the type is the SDK's own handle, by its name there.
fn is_host(ty: &Type) -> bool {
    let Type::Path(path) = ty else { return false };
    let names: Vec<String> = path.path.segments.iter().map(|s| s.ident.to_string()).collect();
    matches!(names.join("::").as_str(), "Host" | "trocar_sdk::Host" | "trocar_sdk::prelude::Host")
}

/// `P` of `Many<P>`.
fn inside_many(ty: &Type) -> Option<&Type> {
    let Type::Path(path) = ty else { return None };
    let last = path.path.segments.last().filter(|s| s.ident == "Many")?;
    let PathArguments::AngleBracketed(arguments) = &last.arguments else { return None };
    match arguments.args.first() {
        Some(GenericArgument::Type(one)) => Some(one),
        _ => None,
    }
}

/// Names repeated inputs and outputs as the list says, unless a pattern is given.
fn repeated(mut port: Port) -> syn::Result<Port> {
    if port.many && !port.set.named {
        port.set.name = "{}".to_string();
    }
    if port.many == attrs::is_many(&port.set.name) {
        return Ok(port);
    }
    let why = if port.many {
        "`Many` ports need different names: put {} where the name of the list goes, such as name = \"{}_js\""
    } else {
        "only a `Many<…>` port has {} in its name"
    };
    Err(syn::Error::new_spanned(&port.ident, why))
}

/// `#[names]` or `#[names("arm_{}", "robot_{}")]`.
fn interfaces(attr: &Attribute) -> syn::Result<Vec<String>> {
    if matches!(attr.meta, Meta::Path(_)) {
        return Ok(Vec::new());
    }
    let list = Punctuated::<LitStr, syn::Token![,]>::parse_terminated;
    attr.parse_args_with(list)?
        .into_iter()
        .map(|name| {
            if attrs::is_many(&name.value()) {
                return Ok(name.value());
            }
            Err(syn::Error::new(name.span(), "a repeated interface has {} in its name, such as \"arm_{}\""))
        })
        .collect()
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
        attrs::check_pattern(&interface.value(), interface.span())?;
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
            attrs::check_pattern(&text.value(), text.span())?;
        }
        Ok(text.value())
    };
    match key.as_str() {
        "name" => {
            set.name = text(true)?;
            set.named = true;
        }
        "interface" => set.interface = text(true)?,
        "unit" => set.unit = attrs::unit(&meta.value()?.parse::<LitStr>()?)?,
        "format" => set.format = text(false)?,
        "tag" => {
            let tags: &[&str] = if allowed.contains(&"fifo") { &["sim"] } else { &["truth", "sim"] };
            set.tag = attrs::tag(&meta.value()?.parse::<LitStr>()?, tags)?;
        }
        "optional" => set.optional = true,
        "fifo" => set.fifo = at_most(meta, MAX_FIFO, "samples wait in an input")?,
        _ => set.max_bytes = at_most(meta, MAX_FRAME, "bytes are in a frame")?,
    }
    Ok(())
}

fn at_most(meta: &ParseNestedMeta<'_>, most: usize, what: &str) -> syn::Result<usize> {
    let number = meta.value()?.parse::<LitInt>()?;
    match number.base10_parse::<usize>() {
        Ok(n) if n <= most => Ok(n),
        _ => Err(syn::Error::new(number.span(), format!("at most {most} {what}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(field: &str) -> String {
        let input = syn::parse_str(&format!("struct C {{ {field} }}")).expect(field);
        ComponentFields::of(&input).err().map(|e| e.to_string()).unwrap_or_default()
    }

    #[test]
    fn a_host_without_its_attribute_is_told_what_is_missing() {
        for field in ["host: Host", "host: trocar_sdk::Host"] {
            assert!(said(field).contains("mark the field #[host]"), "{field}: {}", said(field));
        }
        for field in ["#[host] host: Host", "host: my::Host", "hosts: Vec<Host>"] {
            assert_eq!(said(field), "", "{field}");
        }
    }
}
