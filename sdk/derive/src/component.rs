//! `#[derive(Component)]`: the class description and its state struct.
//!
//! Invariant: ids and slot indices are positions in the description, so it is written from the same lists, in
//! the same order, as the methods of the class.

use crate::attrs;
use crate::class::ClassAttr;
use crate::fields::{ComponentFields, Port};
use crate::interfaces::{self, Interface, Interfaces};
use crate::many;
use crate::methods;
use crate::payload;
use proc_macro2::{Ident, TokenStream};
use quote::{format_ident, quote, quote_spanned};
use syn::{DeriveInput, Visibility};

pub(crate) fn derive(input: DeriveInput) -> syn::Result<TokenStream> {
    if !input.generics.params.is_empty() {
        return Err(syn::Error::new_spanned(
            &input.generics,
            "a component class has no parameters: its manifest entry is one fixed description",
        ));
    }
    let class = ClassAttr::of(&input)?;
    let fields = ComponentFields::of(&input)?;
    let provided = interfaces::provided(&class, &fields)?;
    let required = interfaces::required(&class, &fields)?;
    interfaces::unique_names(&fields, &provided, &required, &input.ident)?;

    let name = &input.ident;
    let state = state(&input, &fields);
    let desc = desc(&class, &fields, &provided, &required);
    let methods = methods::all(&class, &fields, &provided, &required);
    let many = many::items(name, &fields, &provided, &required);
    let checks = many::checks(name, &provided);
    let frames = frames(&fields);
    let limits = quote_spanned! { name.span() =>
        const _: () = ::trocar_sdk::__private::check_class(<#name as ::trocar_sdk::Class>::DESC);
    };
    let fallbacks = fallbacks(name, &provided, &required);
    let state_name = format_ident!("{name}State");
    Ok(quote! {
        #state
        const _: () = {
            #fallbacks
            #checks
            #frames
            #limits
            unsafe impl ::trocar_sdk::Class for #name {
                const DESC: &'static ::trocar_sdk::__private::ClassDesc = &#desc;
                type State = #state_name;
                #methods
                #many
            }
        };
    })
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
    provided: &Interfaces<'_>,
    required: &Interfaces<'_>,
) -> TokenStream {
    let ClassAttr { name, doc, model, period_ns, max_step_ns, hardware, starts_programs, .. } = class;
    let (safety, safe_from_any_thread) =
        (format_ident!("{}", class.safety), class.safe_from_any_thread.is_some());
    let (models, [min_period_ns, max_period_ns]) = (&class.models, class.periods_ns);
    let config = match &fields.config {
        Some((_, ty)) => quote!(<#ty as ::trocar_sdk::Config>::FIELDS),
        None => quote!(&[]),
    };
    let state = if fields.state.is_empty() {
        quote!(None)
    } else {
        quote!(Some(<Self::State as ::trocar_sdk::Payload>::DESC))
    };
    let fixed = port_lists(fields, false, &provided.fixed, &required.fixed);
    let many = port_lists(fields, true, &provided.many, &required.many);
    quote! {
        ::trocar_sdk::__private::ClassDesc {
            name: #name,
            doc: #doc,
            safety: ::trocar_sdk::__private::Safety::#safety,
            hardware: #hardware,
            safe_from_any_thread: #safe_from_any_thread,
            starts_programs: #starts_programs,
            model: #model,
            period_ns: #period_ns,
            max_step_ns: #max_step_ns,
            limits: ::trocar_sdk::__private::ExecutionLimitsDesc {
                models: &[#(#models),*],
                min_period_ns: #min_period_ns,
                max_period_ns: #max_period_ns,
            },
            config: #config,
            #fixed
            state: #state,
            many: ::trocar_sdk::__private::ManyDesc { #many },
        }
    }
}

/// The fixed or the repeated ports, as the fields of a description.
fn port_lists(
    fields: &ComponentFields,
    many: bool,
    provided: &[Interface<'_>],
    required: &[Interface<'_>],
) -> TokenStream {
    let inputs = fields.inputs.iter().filter(|p| p.many == many).map(|p| {
        let (name, doc, optional, fifo) = (&p.set.name, &p.doc, p.set.optional, p.set.fifo);
        let (ty, frame, tag) = (port_type(p), &p.frame.name, &p.set.tag);
        quote!(::trocar_sdk::__private::InputDesc {
            name: #name,
            doc: #doc,
            ty: #ty,
            frame: #frame,
            tag: #tag,
            optional: #optional,
            fifo: #fifo,
        })
    });
    let outputs = fields.outputs.iter().filter(|p| p.many == many).map(|p| {
        let (name, doc) = (&p.set.name, &p.doc);
        let (ty, frame, tag) = (port_type(p), &p.frame.name, &p.set.tag);
        quote!(::trocar_sdk::__private::OutputDesc {
            name: #name, doc: #doc, ty: #ty, frame: #frame, tag: #tag,
        })
    });
    let required = required.iter().map(required_desc);
    let provided = provided.iter().map(provided_desc);
    quote! {
        inputs: &[#(#inputs),*],
        outputs: &[#(#outputs),*],
        required: &[#(#required),*],
        provided: &[#(#provided),*],
    }
}

fn port_type(p: &Port) -> TokenStream {
    let (ty, format, max_bytes) = (&p.ty, &p.set.format, p.set.max_bytes);
    quote!(::trocar_sdk::__private::port_type::<#ty>(#format, #max_bytes))
}

/// Returns the check that every port with a coordinate frame has coordinates.
fn frames(fields: &ComponentFields) -> TokenStream {
    let streams = fields.inputs.iter().chain(&fields.outputs).map(|p| {
        let ty = port_type(p);
        p.frame.check(&[quote!(::trocar_sdk::__private::payload_of(#ty))])
    });
    let functions = fields.functions.iter().map(|p| {
        let ty = &p.ty;
        let of = |what| quote!(<#ty as ::trocar_sdk::__private::FunctionPort>::#what);
        p.frame.check(&[of(format_ident!("ARG")), of(format_ident!("RET"))])
    });
    let events = fields.events.iter().map(|p| {
        let ty = &p.ty;
        p.frame.check(&[quote!(<#ty as ::trocar_sdk::__private::EventPort>::PAYLOAD)])
    });
    quote!(#(#streams)* #(#functions)* #(#events)*)
}

fn required_desc(i: &Interface<'_>) -> TokenStream {
    let (name, doc, optional) = (&i.name, &i.doc, i.optional);
    let part = i.handles_part();
    let functions = i.ports.iter().map(|p| {
        let (name, doc, unit, optional, ty) = (&p.set.name, &p.doc, &p.set.unit, p.set.optional, &p.ty);
        let frame = &p.frame.name;
        quote! {
            ::trocar_sdk::__private::FunctionDesc {
                name: #name,
                doc: #doc,
                arg: <#ty as ::trocar_sdk::__private::FunctionPort>::ARG,
                ret: <#ty as ::trocar_sdk::__private::FunctionPort>::RET,
                unit: #unit,
                frame: #frame,
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
    let part = i.provides_part();
    let events = i.ports.iter().map(|p| {
        let (name, doc, unit, frame, ty) = (&p.set.name, &p.doc, &p.set.unit, &p.frame.name, &p.ty);
        quote! {
            ::trocar_sdk::__private::EventDesc {
                name: #name,
                doc: #doc,
                payload: <#ty as ::trocar_sdk::__private::EventPort>::PAYLOAD,
                unit: #unit,
                frame: #frame,
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

/// Empty parts that an inherent constant of the same name (from `#[provides]`, `#[handles]`) takes precedence
/// over.
fn fallbacks(class: &Ident, provided: &Interfaces<'_>, required: &Interfaces<'_>) -> TokenStream {
    let provides = provided.all().map(Interface::provides_part);
    let handles = required.all().map(Interface::handles_part);
    let provided_keys = provided.all().map(|i| attrs::interface_key(&i.name));
    let required_keys = required.all().map(|i| attrs::interface_key(&i.name));
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
