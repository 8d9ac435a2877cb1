//! Substitutes for code that a mistake kept from being generated.
//!
//! Invariant: beside its own message a mistake leaves nothing that the compiler could complain of: the names
//! that the author's other code relies on are there, describe nothing, and never run.

use proc_macro2::TokenStream;
use quote::{format_ident, quote};
use syn::{Attribute, Data, DeriveInput, FnArg, ImplItem, ItemImpl};

/// For `#[derive(Component)]`: an empty class that declares any interface.
pub(crate) fn component(input: &DeriveInput) -> TokenStream {
    if !input.generics.params.is_empty() {
        return TokenStream::new();
    }
    let (name, vis, state) = (&input.ident, &input.vis, format_ident!("{}State", input.ident));
    let text = name.to_string();
    let columns = match &input.data {
        Data::Struct(data) => data.fields.iter().filter(|f| has(&f.attrs, "state")).collect(),
        _ => Vec::new(),
    };
    let columns = columns.into_iter().filter_map(|f| Some((f.ident.as_ref()?, &f.ty)));
    let columns = columns.map(|(ident, ty)| quote!(pub #ident: #ty));
    let payload = nothing(&state);
    quote! {
        #[doc(hidden)]
        #[derive(Clone, Copy)]
        #[allow(dead_code, unreachable_pub)]
        #vis struct #state { #(#columns),* }
        const _: () = {
            #payload
            impl<const KEY: u64> ::trocar_sdk::__private::DeclaresProvided<KEY> for #name {}
            impl<const KEY: u64> ::trocar_sdk::__private::DeclaresRequired<KEY> for #name {}
            unsafe impl ::trocar_sdk::Class for #name {
                const DESC: &'static ::trocar_sdk::__private::ClassDesc = &::trocar_sdk::__private::ClassDesc {
                    name: #text, doc: "", safety: ::trocar_sdk::__private::Safety::None, hardware: false,
                    safe_from_any_thread: false, starts_programs: false, model: "on_signal", period_ns: 0, max_step_ns: 0,
                    limits: ::trocar_sdk::__private::ExecutionLimitsDesc::NONE, config: &[],
                    inputs: &[], outputs: &[], required: &[], provided: &[], state: ::core::option::Option::None,
                    many: ::trocar_sdk::__private::ManyDesc::NONE,
                };
                type State = #state;
                fn create(_: ::trocar_sdk::Host) -> Self { ::core::unreachable!() }
                fn apply(&mut self, _: &::trocar_sdk::__private::JsonObject) -> ::trocar_sdk::Result {
                    ::core::unreachable!()
                }
                fn bind(&mut self, _: &::trocar_sdk::__private::Binder<'_>) {}
                fn state(&self) -> Self::State { ::core::unreachable!() }
                fn set_state(&mut self, _: &Self::State) {}
                fn command(
                    &mut self,
                    id: u32,
                    _: &::trocar_sdk::__private::Layout,
                    call: &mut ::trocar_sdk::__private::Call,
                ) -> ::trocar_sdk::__private::Status { call.unknown(id) }
                fn read(_: &Self::State, id: u32, call: &mut ::trocar_sdk::__private::Call)
                    -> ::trocar_sdk::__private::Status { call.unknown(id) }
                fn on_event(
                    &mut self,
                    id: u32,
                    _: &::trocar_sdk::__private::Layout,
                    call: &mut ::trocar_sdk::__private::Call,
                ) -> ::trocar_sdk::__private::Status { call.unknown(id) }
            }
        };
    }
}

/// For `#[derive(Payload)]`: a struct without fields.
pub(crate) fn payload(input: &DeriveInput) -> TokenStream {
    if input.generics.params.is_empty() { nothing(&input.ident) } else { TokenStream::new() }
}

fn nothing(name: &syn::Ident) -> TokenStream {
    quote! {
        unsafe impl ::trocar_sdk::Payload for #name {
            const DESC: &'static ::trocar_sdk::__private::TypeDesc = &::trocar_sdk::__private::TypeDesc {
                size: 0,
                align: 1,
                kind: ::trocar_sdk::__private::TypeKind::Struct { name: "", doc: "", fields: &[] },
            };
        }
    }
}

/// For `#[derive(Config)]`: no settings.
pub(crate) fn config(input: &DeriveInput) -> TokenStream {
    let (name, (made, of, clause)) = (&input.ident, input.generics.split_for_impl());
    quote! {
        impl #made ::trocar_sdk::Config for #name #of #clause {
            const FIELDS: &'static [::trocar_sdk::__private::ConfigFieldDesc] = &[];
            fn parse(_: &::trocar_sdk::__private::JsonObject) -> ::trocar_sdk::Result<Self> {
                ::core::unreachable!()
            }
            fn unset() -> Self { ::core::unreachable!() }
        }
    }
}

/// For `#[provides]` and `#[handles]`: the methods, as the author calls them from elsewhere, without our
/// attributes.
pub(crate) fn methods(mut item: ItemImpl) -> TokenStream {
    const OURS: [&str; 6] = ["command", "read", "on", "arg", "frame", "unit"];
    let strip = |attrs: &mut Vec<Attribute>| attrs.retain(|a| !OURS.iter().any(|o| a.path().is_ident(o)));
    for inner in &mut item.items {
        let ImplItem::Fn(f) = inner else { continue };
        strip(&mut f.attrs);
        for input in &mut f.sig.inputs {
            match input {
                FnArg::Receiver(receiver) => strip(&mut receiver.attrs),
                FnArg::Typed(typed) => strip(&mut typed.attrs),
            }
        }
    }
    // An author's `fn` that only the missing code would have called is not unused.
    quote!(#[allow(dead_code)] #item)
}

fn has(attrs: &[Attribute], name: &str) -> bool {
    attrs.iter().any(|a| a.path().is_ident(name))
}
