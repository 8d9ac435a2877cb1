//! `#[derive(Component)]`: the class description, its state struct, and the way from ids to fields.
//!
//! Invariant: ids and slot indices are positions in the description, so both are written in one pass over the same lists.

use crate::attrs;
use crate::class::ClassAttr;
use crate::fields::{ComponentFields, Port};
use crate::payload;
use proc_macro2::{Ident, Span, TokenStream};
use quote::{format_ident, quote};
use syn::{DeriveInput, Visibility};

/// An interface with the ports that belong to it.
struct Interface<'a> {
    name: String,
    /// A lone function is its own interface and lends it its doc.
    doc: String,
    optional: bool,
    ports: Vec<&'a Port>,
}

pub(crate) fn derive(input: DeriveInput) -> syn::Result<TokenStream> {
    if !input.generics.params.is_empty() {
        return Err(syn::Error::new_spanned(
            &input.generics,
            "a component class has no parameters: its manifest entry is one fixed description",
        ));
    }
    let class = ClassAttr::of(&input)?;
    let fields = ComponentFields::of(&input)?;
    let provided = provided(&class, &fields)?;
    let required = required(&class, &fields);
    unique_names(&fields, &provided, &required, &input.ident)?;

    let name = &input.ident;
    let state = state(&input, &fields);
    let desc = desc(&class, &fields, &provided, &required);
    let create = create(&fields);
    let methods = methods(&fields, &provided, &required);
    let fallbacks = fallbacks(name, &provided, &required);
    let state_name = format_ident!("{name}State");
    Ok(quote! {
        #state
        const _: () = {
            #fallbacks
            unsafe impl ::trocar_sdk::Class for #name {
                const DESC: &'static ::trocar_sdk::__private::ClassDesc = &#desc;
                type State = #state_name;
                #create
                #methods
            }
        };
    })
}

fn provided<'a>(class: &ClassAttr, fields: &'a ComponentFields) -> syn::Result<Vec<Interface<'a>>> {
    let mut out: Vec<Interface<'a>> = Vec::new();
    for (name, span) in &class.provides {
        if out.iter().any(|i| i.name == *name) {
            return Err(syn::Error::new(*span, format!("interface `{name}` is listed twice")));
        }
        out.push(Interface { name: name.clone(), doc: String::new(), optional: false, ports: Vec::new() });
    }
    for port in &fields.events {
        join(&mut out, &port.set.interface, port);
    }
    Ok(out)
}

fn required<'a>(class: &ClassAttr, fields: &'a ComponentFields) -> Vec<Interface<'a>> {
    let mut out: Vec<Interface<'a>> = Vec::new();
    for port in &fields.functions {
        let lone = port.set.interface.is_empty();
        let at = join(&mut out, if lone { &port.set.name } else { &port.set.interface }, port);
        if lone {
            out[at].doc.clone_from(&port.doc);
        }
    }
    for (name, _) in class.requires.iter().chain(&class.optional) {
        if !out.iter().any(|i| i.name == *name) {
            out.push(Interface {
                name: name.clone(),
                doc: String::new(),
                optional: false,
                ports: Vec::new(),
            });
        }
    }
    for interface in &mut out {
        let all_optional = !interface.ports.is_empty() && interface.ports.iter().all(|p| p.set.optional);
        interface.optional = all_optional || class.optional.iter().any(|(n, _)| *n == interface.name);
    }
    out
}

fn join<'a>(out: &mut Vec<Interface<'a>>, name: &str, port: &'a Port) -> usize {
    let at = out.iter().position(|i| i.name == name).unwrap_or_else(|| {
        out.push(Interface {
            name: name.to_string(),
            doc: String::new(),
            optional: false,
            ports: Vec::new(),
        });
        out.len() - 1
    });
    out[at].ports.push(port);
    at
}

/// `process/component/port` must mean one thing.
fn unique_names(
    fields: &ComponentFields,
    provided: &[Interface<'_>],
    required: &[Interface<'_>],
    class: &Ident,
) -> syn::Result<()> {
    let ports = fields.inputs.iter().chain(&fields.outputs).map(|p| (p.set.name.clone(), p.ident.span()));
    let interfaces = provided.iter().chain(required).map(|i| {
        let span = i.ports.first().and_then(|p| p.set.span).unwrap_or_else(|| class.span());
        (i.name.clone(), span)
    });
    let mut seen: Vec<String> = Vec::new();
    for (name, span) in ports.chain(interfaces) {
        unique(&mut seen, name, span, "inputs, outputs and interfaces share one set of names")?;
    }
    for interface in provided.iter().chain(required) {
        let mut seen = Vec::new();
        for port in &interface.ports {
            unique(&mut seen, port.set.name.clone(), port.ident.span(), "names within an interface differ")?;
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

/// The generated `{Class}State` struct: the `#[state]` fields, with gaps filled by zero bytes.
fn state(input: &DeriveInput, fields: &ComponentFields) -> TokenStream {
    let name = format_ident!("{}State", input.ident);
    let vis = match &input.vis {
        Visibility::Public(_) => quote!(pub),
        _ => quote!(pub(crate)),
    };
    let struct_vis = &input.vis;
    let text = format!("One published row of {}: its `#[state]` fields.", input.ident);
    let mut members = TokenStream::new();
    let mut end = quote!(0usize);
    let mut align = quote!(1usize);
    for (i, f) in fields.state.iter().enumerate() {
        let (ident, ty, pad) = (&f.ident, &f.ty, format_ident!("__gap_{i}"));
        let doc = &f.doc;
        let aligned = quote!(::trocar_sdk::__private::align_up(#end, ::core::mem::align_of::<#ty>()));
        members.extend(quote! {
            #[doc(hidden)]
            #pad: [u8; #aligned - (#end)],
            #[doc = #doc]
            #vis #ident: #ty,
        });
        end = quote!((#aligned + ::core::mem::size_of::<#ty>()));
        align = quote!(::trocar_sdk::__private::max(#align, ::core::mem::align_of::<#ty>()));
    }
    if !fields.state.is_empty() {
        members.extend(quote! {
            #[doc(hidden)]
            __gap_end: [u8; ::trocar_sdk::__private::align_up(#end, #align) - #end],
        });
    }
    let payload = payload::implement(&name, &text, "", &fields.state);
    quote! {
        #[doc = #text]
        #[repr(C)]
        #[derive(Clone, Copy)]
        #[allow(dead_code, unreachable_pub)]
        #struct_vis struct #name { #members }
        const _: () = { #payload };
    }
}

fn desc(
    class: &ClassAttr,
    fields: &ComponentFields,
    provided: &[Interface<'_>],
    required: &[Interface<'_>],
) -> TokenStream {
    let ClassAttr { name, doc, model, period_ns, hardware, safe_from_any_thread, .. } = class;
    let safety = format_ident!("{}", class.safety);
    let config = match &fields.config {
        Some((_, ty)) => quote!(<#ty as ::trocar_sdk::Config>::FIELDS),
        None => quote!(&[]),
    };
    let state = if fields.state.is_empty() {
        quote!(None)
    } else {
        quote!(Some(<Self::State as ::trocar_sdk::Payload>::DESC))
    };
    let inputs = fields.inputs.iter().map(|p| {
        let (name, doc, optional, fifo) = (&p.set.name, &p.doc, p.set.optional, p.set.fifo);
        let ty = port_type(p);
        quote!(::trocar_sdk::__private::InputDesc {
            name: #name, doc: #doc, ty: #ty, optional: #optional, fifo: #fifo,
        })
    });
    let outputs = fields.outputs.iter().map(|p| {
        let (name, doc) = (&p.set.name, &p.doc);
        let ty = port_type(p);
        quote!(::trocar_sdk::__private::OutputDesc { name: #name, doc: #doc, ty: #ty })
    });
    let required = required.iter().map(required_desc);
    let provided = provided.iter().map(provided_desc);
    quote! {
        ::trocar_sdk::__private::ClassDesc {
            name: #name,
            doc: #doc,
            safety: ::trocar_sdk::__private::Safety::#safety,
            hardware: #hardware,
            safe_from_any_thread: #safe_from_any_thread,
            model: #model,
            period_ns: #period_ns,
            config: #config,
            inputs: &[#(#inputs),*],
            outputs: &[#(#outputs),*],
            required: &[#(#required),*],
            provided: &[#(#provided),*],
            state: #state,
        }
    }
}

fn port_type(p: &Port) -> TokenStream {
    let (ty, format, max_bytes) = (&p.ty, &p.set.format, p.set.max_bytes);
    quote!(::trocar_sdk::__private::port_type::<#ty>(#format, #max_bytes))
}

fn required_desc(i: &Interface<'_>) -> TokenStream {
    let (name, doc, optional) = (&i.name, &i.doc, i.optional);
    let part = handles_part(name);
    let functions = i.ports.iter().map(|p| {
        let (name, doc, unit, optional, ty) = (&p.set.name, &p.doc, &p.set.unit, p.set.optional, &p.ty);
        quote! {
            ::trocar_sdk::__private::FunctionDesc {
                name: #name,
                doc: #doc,
                arg: <#ty as ::trocar_sdk::__private::FunctionPort>::ARG,
                ret: <#ty as ::trocar_sdk::__private::FunctionPort>::RET,
                unit: #unit,
                optional: #optional,
                any: <#ty as ::trocar_sdk::__private::FunctionPort>::ANY,
            }
        }
    });
    quote! {
        ::trocar_sdk::__private::RequiredDesc {
            name: #name,
            doc: ::trocar_sdk::__private::first_text(Self::#part.doc, #doc),
            optional: #optional,
            functions: &[#(#functions),*],
            handlers: Self::#part.handlers,
        }
    }
}

fn provided_desc(i: &Interface<'_>) -> TokenStream {
    let name = &i.name;
    let part = provides_part(name);
    let events = i.ports.iter().map(|p| {
        let (name, doc, unit, ty) = (&p.set.name, &p.doc, &p.set.unit, &p.ty);
        quote! {
            ::trocar_sdk::__private::EventDesc {
                name: #name,
                doc: #doc,
                payload: <#ty as ::trocar_sdk::__private::EventPort>::PAYLOAD,
                unit: #unit,
            }
        }
    });
    quote! {
        ::trocar_sdk::__private::ProvidedDesc {
            name: #name,
            doc: Self::#part.doc,
            tag: Self::#part.tag,
            commands: Self::#part.commands,
            events: &[#(#events),*],
        }
    }
}

fn create(fields: &ComponentFields) -> TokenStream {
    let ports = [&fields.inputs, &fields.outputs, &fields.functions, &fields.events];
    let ports = ports.into_iter().flatten().map(|p| &p.ident);
    let private = &fields.private;
    let state = fields.state.iter().map(|f| &f.ident);
    let config = fields.config.iter().map(|(ident, _)| ident);
    let host = fields.host.iter();
    quote! {
        fn create(host: ::trocar_sdk::Host) -> Self {
            let _ = host;
            Self {
                #(#ports: ::core::default::Default::default(),)*
                #(#private: ::core::default::Default::default(),)*
                #(#state: ::trocar_sdk::Payload::zeroed(),)*
                #(#config: ::trocar_sdk::Config::unset(),)*
                #(#host: host,)*
            }
        }
    }
}

fn methods(fields: &ComponentFields, provided: &[Interface<'_>], required: &[Interface<'_>]) -> TokenStream {
    let inputs = binds("input", fields.inputs.iter());
    let outputs = binds("output", fields.outputs.iter());
    let functions = binds("function", required.iter().flat_map(|i| i.ports.iter().copied()));
    let events = binds("event", provided.iter().flat_map(|i| i.ports.iter().copied()));
    let state: Vec<&Ident> = fields.state.iter().map(|f| &f.ident).collect();
    let provided: Vec<Ident> = provided.iter().map(|i| provides_part(&i.name)).collect();
    let required: Vec<Ident> = required.iter().map(|i| handles_part(&i.name)).collect();
    let apply = match &fields.config {
        Some((ident, ty)) => quote! {
            let new = <#ty as ::trocar_sdk::Config>::parse(object)?;
            let old = ::core::mem::replace(&mut self.#ident, new);
            ::trocar_sdk::Component::configure(self).inspect_err(|_| self.#ident = old)
        },
        None => quote! {
            ::trocar_sdk::__private::config_known(object, &[])?;
            ::trocar_sdk::Component::configure(self)
        },
    };
    quote! {
        fn apply(&mut self, object: &::trocar_sdk::__private::JsonObject) -> ::trocar_sdk::Result {
            #apply
        }
        fn bind(&mut self, binder: &::trocar_sdk::__private::Binder<'_>) {
            let _ = binder;
            #inputs #outputs #functions #events
        }
        #[inline]
        fn state(&self) -> Self::State {
            #[allow(unused_mut)]
            let mut row = <Self::State as ::trocar_sdk::Payload>::zeroed();
            #(row.#state = self.#state;)*
            row
        }
        fn set_state(&mut self, row: &Self::State) {
            let _ = row;
            #(self.#state = row.#state;)*
        }
        fn command(
            &mut self,
            id: u32,
            call: &mut ::trocar_sdk::__private::Call,
        ) -> ::trocar_sdk::__private::Status {
            let mut at = 0u32;
            #(
                let next = at + Self::#provided.commands.len() as u32;
                if id < next { return (Self::#provided.command)(self, id - at, call); }
                at = next;
            )*
            let _ = at;
            call.unknown(id)
        }
        fn read(
            row: &Self::State,
            id: u32,
            call: &mut ::trocar_sdk::__private::Call,
        ) -> ::trocar_sdk::__private::Status {
            let _ = row;
            let mut at = 0u32;
            #(
                let next = at + Self::#provided.commands.len() as u32;
                if id < next { return (Self::#provided.read)(row, id - at, call); }
                at = next;
            )*
            let _ = at;
            call.unknown(id)
        }
        fn on_event(
            &mut self,
            id: u32,
            call: &mut ::trocar_sdk::__private::Call,
        ) -> ::trocar_sdk::__private::Status {
            let mut at = 0u32;
            #(
                let next = at + Self::#required.handlers.len() as u32;
                if id < next { return (Self::#required.on_event)(self, id - at, call); }
                at = next;
            )*
            let _ = at;
            call.unknown(id)
        }
    }
}

fn binds<'a>(kind: &str, ports: impl Iterator<Item = &'a Port>) -> TokenStream {
    let method = format_ident!("{kind}");
    let lines = ports.enumerate().map(|(i, p)| {
        let ident = &p.ident;
        quote!(binder.#method(#i, &mut self.#ident);)
    });
    quote!(#(#lines)*)
}

/// Empty parts that an inherent constant of the same name (from `#[provides]`, `#[handles]`) takes precedence over.
fn fallbacks(class: &Ident, provided: &[Interface<'_>], required: &[Interface<'_>]) -> TokenStream {
    let provides = provided.iter().map(|i| provides_part(&i.name));
    let handles = required.iter().map(|i| handles_part(&i.name));
    let provided_keys = provided.iter().map(|i| attrs::interface_key(&i.name));
    let required_keys = required.iter().map(|i| attrs::interface_key(&i.name));
    quote! {
        #[allow(non_upper_case_globals, dead_code)]
        trait Fallback: ::trocar_sdk::Class {
            #(const #provides: ::trocar_sdk::__private::ProvidedPart<Self> =
                ::trocar_sdk::__private::ProvidedPart::EMPTY;)*
            #(const #handles: ::trocar_sdk::__private::HandlesPart<Self> =
                ::trocar_sdk::__private::HandlesPart::EMPTY;)*
        }
        impl Fallback for #class {}
        #(impl ::trocar_sdk::__private::DeclaresProvided<#provided_keys> for #class {})*
        #(impl ::trocar_sdk::__private::DeclaresRequired<#required_keys> for #class {})*
    }
}

fn provides_part(name: &str) -> Ident {
    format_ident!("__TROCAR_PROVIDES_{}", attrs::ident_part(name))
}

fn handles_part(name: &str) -> Ident {
    format_ident!("__TROCAR_HANDLES_{}", attrs::ident_part(name))
}
