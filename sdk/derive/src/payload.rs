//! `#[derive(Payload)]`, and the same implementation for generated state structs.
//!
//! Invariant: a type that has padding or a field that is no payload never compiles.

use crate::attrs;
use proc_macro2::{Ident, TokenStream};
use quote::{format_ident, quote, quote_spanned};
use syn::ext::IdentExt;
use syn::{Data, DeriveInput, Field, Fields, Type};

/// One described field.
pub(crate) struct Described {
    pub(crate) ident: Ident,
    pub(crate) ty: Type,
    pub(crate) unit: String,
    pub(crate) frame: String,
    pub(crate) doc: String,
}

impl Described {
    pub(crate) fn of(field: &Field, ident: &Ident) -> syn::Result<Described> {
        Ok(Described {
            ident: ident.clone(),
            ty: field.ty.clone(),
            unit: attrs::unit_attr(&field.attrs)?,
            frame: attrs::Frame::of(&field.attrs)?.name,
            doc: attrs::docs(&field.attrs),
        })
    }

    fn desc(&self, owner: &Ident) -> TokenStream {
        let Described { ident, ty, unit, frame, doc } = self;
        let name = ident.unraw().to_string();
        quote! {
            ::trocar_sdk::__private::FieldDesc {
                name: #name,
                at: ::core::mem::offset_of!(#owner, #ident),
                ty: <#ty as ::trocar_sdk::Payload>::DESC,
                unit: #unit,
                doc: #doc,
                frame: #frame,
            }
        }
    }
}

pub(crate) fn derive(input: DeriveInput) -> syn::Result<TokenStream> {
    let name = &input.ident;
    if !input.generics.params.is_empty() {
        return Err(syn::Error::new_spanned(
            &input.generics,
            "a payload has no parameters: its manifest entry is one fixed layout",
        ));
    }
    if !has_repr(&input, "C") {
        return Err(syn::Error::new_spanned(name, "a payload is `#[repr(C)]`: add it above the struct"));
    }
    if has_repr(&input, "packed") {
        return Err(syn::Error::new_spanned(
            name,
            "a payload is not `packed`: each field lies at a multiple of its alignment; put larger fields first",
        ));
    }
    let Data::Struct(data) = &input.data else {
        return Err(syn::Error::new_spanned(
            name,
            "a payload is a struct; for named integer values use `named_values!`",
        ));
    };
    let Fields::Named(named) = &data.fields else {
        return Err(syn::Error::new_spanned(name, "a payload has named fields: consumers find them by name"));
    };
    let mut fields = Vec::new();
    for field in &named.named {
        if let Some(ident) = &field.ident {
            fields.push(Described::of(field, ident)?);
        }
    }
    let format = attrs::text_attr(&input.attrs, "format")?;
    let body = implement(name, &attrs::docs(&input.attrs), &format, &fields);
    let checks = padding_checks(name, &fields);
    Ok(quote! { const _: () = { #checks #body }; })
}

/// The `Payload` implementation of a struct whose described fields are `fields`.
pub(crate) fn implement(name: &Ident, doc: &str, format: &str, fields: &[Described]) -> TokenStream {
    let text = name.unraw().to_string();
    let descs = fields.iter().map(|f| f.desc(name));
    let stamp = fields.iter().find(|f| f.ident == "stamp" && is_stamp(&f.ty)).map(|f| {
        let ident = &f.ident;
        quote! {
            #[inline]
            fn stamp_ns(&self) -> u64 { self.#ident.ns() }
        }
    });
    quote! {
        unsafe impl ::trocar_sdk::Payload for #name {
            const DESC: &'static ::trocar_sdk::__private::TypeDesc = &::trocar_sdk::__private::TypeDesc {
                size: ::core::mem::size_of::<#name>(),
                align: ::core::mem::align_of::<#name>(),
                kind: ::trocar_sdk::__private::TypeKind::Struct { name: #text, doc: #doc, fields: &[#(#descs),*] },
            };
            const FORMAT: &'static str = #format;
            #stamp
        }
    }
}

/// One assertion before each field and one for the tail.
fn padding_checks(name: &Ident, fields: &[Described]) -> TokenStream {
    let mut out = TokenStream::new();
    let mut end = quote!(0usize);
    for (i, f) in fields.iter().enumerate() {
        let (ident, ty) = (&f.ident, &f.ty);
        let message = format!(
            "field layout has padding before `{ident}`: put larger fields first or fill the gap with a named `[u8; N]` field"
        );
        out.extend(quote_spanned! { ident.span() =>
            assert!(::core::mem::offset_of!(#name, #ident) == #end, #message);
        });
        let end_name = format_ident!("__end_{i}");
        out.extend(quote! {
            let #end_name = ::core::mem::offset_of!(#name, #ident) + ::core::mem::size_of::<#ty>();
        });
        end = quote!(#end_name);
    }
    let tail = format!(
        "field layout has padding at the end of `{name}`: fill it up to a multiple of its alignment with a named `[u8; N]` field"
    );
    out.extend(quote_spanned! { name.span() => assert!(::core::mem::size_of::<#name>() == #end, #tail); });
    let align = format!("`{name}` is aligned to more than 8 bytes: leave `align(…)` away");
    out.extend(quote_spanned! { name.span() => assert!(::core::mem::align_of::<#name>() <= 8, #align); });
    quote! { const _: () = { #out }; }
}

fn has_repr(input: &DeriveInput, wanted: &str) -> bool {
    input.attrs.iter().filter(|a| a.path().is_ident("repr")).any(|a| {
        let mut found = false;
        let _ = a.parse_nested_meta(|meta| {
            found |= meta.path.is_ident(wanted);
            // `align(8)`, `packed(1)`: the number is the compiler's business.
            if meta.input.peek(syn::token::Paren) {
                let inside;
                syn::parenthesized!(inside in meta.input);
                inside.parse::<TokenStream>()?;
            }
            Ok(())
        });
        found
    })
}

fn is_stamp(ty: &Type) -> bool {
    matches!(ty, Type::Path(p) if p.path.segments.last().is_some_and(|s| s.ident == "Stamp"))
}
