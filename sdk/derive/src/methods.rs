//! The methods of a class that `#[derive(Component)]` writes: the way from ids and slots to fields.
//!
//! Invariant: ids and slot indices are positions in the description, so they are counted over the same lists,
//! in the same order.

use crate::class::ClassAttr;
use crate::fields::{ComponentFields, Port};
use crate::interfaces::Interfaces;
use crate::many;
use proc_macro2::{Ident, TokenStream};
use quote::{format_ident, quote, quote_spanned};

pub(crate) fn all(
    class: &ClassAttr,
    fields: &ComponentFields,
    provided: &Interfaces<'_>,
    required: &Interfaces<'_>,
) -> TokenStream {
    let (create, safe) = (create(fields), safe_handle(class));
    let (apply, bind) = (apply(fields, provided, required), bind(fields, provided, required));
    let rows = rows(fields);
    let (command, read, on_event) = (command(provided), read(provided), on_event(required));
    quote!(#create #safe #apply #bind #rows #command #read #on_event)
}

fn create(fields: &ComponentFields) -> TokenStream {
    let ports = [&fields.inputs, &fields.outputs, &fields.functions, &fields.events];
    let ports = ports.into_iter().flatten().map(|p| &p.ident);
    let private = &fields.private;
    let state = fields.state.iter().map(|f| &f.ident);
    let config = fields.config.iter().map(|(ident, _)| ident);
    let host = fields.host.iter();
    let names = fields.names.iter().map(|(ident, _)| ident);
    quote! {
        fn create(host: ::trocar_sdk::Host) -> Self {
            let _ = host;
            Self {
                #(#ports: ::core::default::Default::default(),)*
                #(#private: ::core::default::Default::default(),)*
                #(#state: ::trocar_sdk::Payload::zeroed(),)*
                #(#config: ::trocar_sdk::Config::unset(),)*
                #(#host: host,)*
                #(#names: ::core::default::Default::default(),)*
            }
        }
    }
}

/// Checks that a class that says `safe_from_any_thread` has its handle; the compiler shows the mistake at
/// that word.
fn safe_handle(class: &ClassAttr) -> TokenStream {
    let Some(span) = class.safe_from_any_thread else { return TokenStream::new() };
    let handle = quote_spanned!(span => <Self as ::trocar_sdk::SafeFromAnyThread>::safe_handle(self));
    quote! {
        fn safe_handle(&self) -> ::core::option::Option<::std::sync::Arc<dyn ::trocar_sdk::MakeSafe>> {
            ::core::option::Option::Some(#handle)
        }
    }
}

/// Takes over a whole configuration; on an error the old one comes back.
fn apply(fields: &ComponentFields, provided: &Interfaces<'_>, required: &Interfaces<'_>) -> TokenStream {
    let check = many::check(fields, provided, required);
    let configure = quote!(::trocar_sdk::Component::configure(self)#check);
    let apply = match &fields.config {
        Some((ident, ty)) => quote! {
            let new = <#ty as ::trocar_sdk::Config>::parse(object)?;
            let old = ::core::mem::replace(&mut self.#ident, new);
            let done: ::trocar_sdk::Result = #configure;
            done.inspect_err(|_| self.#ident = old)
        },
        None => quote! {
            ::trocar_sdk::__private::config_known(object, &[])?;
            #configure
        },
    };
    quote! {
        fn apply(&mut self, object: &::trocar_sdk::__private::JsonObject) -> ::trocar_sdk::Result {
            #apply
        }
    }
}

/// Ties each port to its slot.
fn bind(fields: &ComponentFields, provided: &Interfaces<'_>, required: &Interfaces<'_>) -> TokenStream {
    let fixed = |p: &&Port| !p.many;
    let inputs = binds("input", fields.inputs.iter().filter(fixed));
    let outputs = binds("output", fields.outputs.iter().filter(fixed));
    let functions = binds("function", required.fixed.iter().flat_map(|i| i.ports.iter().copied()));
    let events = binds("event", provided.fixed.iter().flat_map(|i| i.ports.iter().copied()));
    let repeated = many::binds(fields, provided, required);
    quote! {
        fn bind(&mut self, binder: &::trocar_sdk::__private::Binder<'_>) {
            let _ = binder;
            #inputs #outputs #functions #events #repeated
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

/// Copies the `#[state]` fields to a row of the state table, and back.
fn rows(fields: &ComponentFields) -> TokenStream {
    let state: Vec<&Ident> = fields.state.iter().map(|f| &f.ident).collect();
    quote! {
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
    }
}

/// Runs the command with an id.
fn command(provided: &Interfaces<'_>) -> TokenStream {
    let parts = many::parts(&provided.fixed, |i| i.provides_part(), "commands", "command");
    inside("command", &parts, &many::commands(provided))
}

/// Answers the read with an id from a row of the state table.
fn read(provided: &Interfaces<'_>) -> TokenStream {
    let fixed =
        in_turn(&many::parts(&provided.fixed, |i| i.provides_part(), "commands", "read"), &quote!(row));
    let repeated = many::read(provided);
    quote! {
        #[inline]
        fn read(
            row: &Self::State,
            id: u32,
            call: &mut ::trocar_sdk::__private::Call,
        ) -> ::trocar_sdk::__private::Status {
            let _ = row;
            let mut at = 0u32;
            #fixed
            #repeated
            let _ = at;
            call.unknown(id)
        }
    }
}

/// Runs the event handler with an id.
fn on_event(required: &Interfaces<'_>) -> TokenStream {
    let parts = many::parts(&required.fixed, |i| i.handles_part(), "handlers", "on_event");
    inside("on_event", &parts, &many::handlers(required))
}

/// A method that runs the member with an id inside the component.
fn inside(name: &str, fixed: &[(TokenStream, TokenStream)], repeated: &TokenStream) -> TokenStream {
    let (name, fixed) = (format_ident!("{name}"), in_turn(fixed, &quote!(self)));
    quote! {
        #[inline]
        fn #name(
            &mut self,
            id: u32,
            lists: &::trocar_sdk::__private::Layout,
            call: &mut ::trocar_sdk::__private::Call,
        ) -> ::trocar_sdk::__private::Status {
            let _ = lists;
            let mut at = 0u32;
            #fixed
            #repeated
            let _ = at;
            call.unknown(id)
        }
    }
}

/// Finds the fixed interface that an id belongs to: their members are counted one interface after the other.
fn in_turn(parts: &[(TokenStream, TokenStream)], this: &TokenStream) -> TokenStream {
    let steps = parts.iter().map(|(members, run)| {
        quote! {
            let next = at + #members.len() as u32;
            if id < next { return (#run)(#this, id - at, 0, call); }
            at = next;
        }
    });
    quote!(#(#steps)*)
}
