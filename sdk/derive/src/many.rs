//! Repeated ports and interfaces: the lists behind them, their slots and the way from their ids to methods.
//!
//! Invariant: slots are counted by the lists described last, ids by those in force since `bind`, as the
//! instance keeps them apart from the fields; both begin behind the fixed part, in the order of the
//! description.

use crate::fields::{ComponentFields, Port};
use crate::interfaces::{Interface, Interfaces};
use proc_macro2::{Ident, TokenStream};
use quote::{format_ident, quote};

/// True when any port or interface is repeated.
fn any(fields: &ComponentFields, provided: &Interfaces<'_>, required: &Interfaces<'_>) -> bool {
    let port = fields.inputs.iter().chain(&fields.outputs).any(|p| p.many);
    port || !provided.many.is_empty() || !required.many.is_empty()
}

/// Description, lists and counts of a class with repeated ports; nothing for the others.
pub(crate) fn items(
    class: &Ident,
    fields: &ComponentFields,
    provided: &Interfaces<'_>,
    required: &Interfaces<'_>,
) -> TokenStream {
    if !any(fields, provided, required) {
        return TokenStream::new();
    }
    let (inputs, outputs) = (ports(&fields.inputs), ports(&fields.outputs));
    let list = |i: &Interface<'_>| i.names.cloned();
    let required_lists: Vec<Ident> = required.many.iter().filter_map(list).collect();
    let provided_lists: Vec<Ident> = provided.many.iter().filter_map(list).collect();
    quote! {
        const DESCRIPTION: &'static str = {
            #[allow(long_running_const_eval)]
            const LEN: usize =
                ::trocar_sdk::__private::render_description::<0>(<#class as ::trocar_sdk::Class>::DESC).1;
            #[allow(long_running_const_eval)]
            const TEXT: [u8; LEN] =
                ::trocar_sdk::__private::render_description::<LEN>(<#class as ::trocar_sdk::Class>::DESC).0;
            ::trocar_sdk::__private::manifest_text(&TEXT)
        };
        fn lists(&self) -> ::trocar_sdk::__private::Lists<'_> {
            ::trocar_sdk::__private::Lists {
                inputs: ::std::vec![#(self.#inputs.names()),*],
                outputs: ::std::vec![#(self.#outputs.names()),*],
                required: ::std::vec![#(self.#required_lists.names()),*],
                provided: ::std::vec![#(self.#provided_lists.names()),*],
            }
        }
    }
}

fn ports(all: &[Port]) -> Vec<&Ident> {
    all.iter().filter(|p| p.many).map(|p| &p.ident).collect()
}

/// After the author's `configure`: the names must not clash.
pub(crate) fn check(
    fields: &ComponentFields,
    provided: &Interfaces<'_>,
    required: &Interfaces<'_>,
) -> TokenStream {
    if !any(fields, provided, required) {
        return TokenStream::new();
    }
    quote!(.and_then(|()| ::trocar_sdk::__private::check_lists(self)))
}

/// The slots behind the fixed ones.
pub(crate) fn binds(
    fields: &ComponentFields,
    provided: &Interfaces<'_>,
    required: &Interfaces<'_>,
) -> TokenStream {
    let fixed = |ports: &[Port]| ports.iter().filter(|p| !p.many).count();
    let in_interfaces = |all: &[Interface<'_>]| all.iter().map(|i| i.ports.len()).sum::<usize>();
    let inputs = lone_binds("inputs", fixed(&fields.inputs), &ports(&fields.inputs));
    let outputs = lone_binds("outputs", fixed(&fields.outputs), &ports(&fields.outputs));
    let functions = group_binds(
        "many_functions",
        in_interfaces(&required.fixed),
        "required",
        required.many.chunks(1).collect(),
    );
    let events =
        group_binds("many_events", in_interfaces(&provided.fixed), "provided", provided.groups().collect());
    let lists = fields.names.iter().map(|(ident, _)| adopt(ident, provided, required));
    quote!(#(#lists)* #inputs #outputs #functions #events)
}

/// Makes a list take over what the host was told of it, independent of the field's later changes.
fn adopt(list: &Ident, provided: &Interfaces<'_>, required: &Interfaces<'_>) -> TokenStream {
    let of = |all: &Interfaces<'_>| all.many.iter().position(|i| i.names == Some(list));
    let told = match (of(provided), of(required)) {
        (Some(at), _) => names_of("provided", at),
        (None, Some(at)) => names_of("required", at),
        // No interface uses the list.
        (None, None) => quote!(&::std::vec::Vec::from(self.#list.wanted())),
    };
    quote!(self.#list.adopt(#told);)
}

/// Returns the names of one list that the host was told.
fn names_of(kind: &str, at: usize) -> TokenStream {
    let kind = format_ident!("{kind}");
    quote!(::trocar_sdk::__private::names_of(&binder.lists().#kind, #at))
}

fn lone_binds(kind: &str, first: usize, ports: &[&Ident]) -> TokenStream {
    if ports.is_empty() {
        return TokenStream::new();
    }
    let method = format_ident!("many_{kind}");
    let names = (0..ports.len()).map(|at| names_of(kind, at));
    quote! {{
        let mut at = #first;
        #(
            let names = #names;
            binder.#method(at, 1, names, &mut self.#ports);
            at += names.len();
        )*
        let _ = at;
    }}
}

fn group_binds(method: &str, first: usize, kind: &str, groups: Vec<&[Interface<'_>]>) -> TokenStream {
    if groups.is_empty() {
        return TokenStream::new();
    }
    let method = format_ident!("{method}");
    let mut list = 0;
    let groups = groups.iter().map(|group| {
        let names = names_of(kind, list);
        list += group.len();
        let ports: Vec<&Ident> = group.iter().flat_map(|i| &i.ports).map(|p| &p.ident).collect();
        let apart = ports.len();
        let offsets = 0..apart;
        quote! {
            let names = #names;
            #(binder.#method(at + #offsets, #apart, names, &mut self.#ports);)*
            at += names.len() * #apart;
        }
    });
    quote! {{
        let mut at = #first;
        #(#groups)*
        let _ = at;
    }}
}

/// Ids of commands behind those of fixed interfaces; `at` is the first of them.
pub(crate) fn commands(provided: &Interfaces<'_>) -> TokenStream {
    let mut list = 0;
    let lines = provided.groups().map(|group| {
        let parts = parts(group, |i| i.provides_part(), "commands", "command");
        let names = quote!(::trocar_sdk::__private::names_of(&lists.provided, #list));
        list += group.len();
        dispatch(&names, &parts)
    });
    quote!(#(#lines)*)
}

/// Ids of handlers behind those of fixed interfaces.
pub(crate) fn handlers(required: &Interfaces<'_>) -> TokenStream {
    let lines = required.many.chunks(1).enumerate().map(|(list, alone)| {
        let parts = parts(alone, |i| i.handles_part(), "handlers", "on_event");
        let names = quote!(::trocar_sdk::__private::names_of(&lists.required, #list));
        dispatch(&names, &parts)
    });
    quote!(#(#lines)*)
}

/// Returns, per interface, its members and the code that runs one of them.
pub(crate) fn parts(
    group: &[Interface<'_>],
    part: impl Fn(&Interface<'_>) -> Ident,
    members: &str,
    run: &str,
) -> Vec<(TokenStream, TokenStream)> {
    let (members, run) = (format_ident!("{members}"), format_ident!("{run}"));
    group.iter().map(part).map(|part| (quote!(Self::#part.#members), quote!(Self::#part.#run))).collect()
}

fn dispatch(names: &TokenStream, parts: &[(TokenStream, TokenStream)]) -> TokenStream {
    let members = parts.iter().map(|(members, _)| members);
    let found = within(parts, &quote!(self));
    quote! {
        let n = 0 #(+ #members.len() as u32)*;
        let next = at + n * #names.len() as u32;
        if id < next {
            #found
        }
        at = next;
    }
}

/// Finds which of the interfaces of a list is meant, and which member of which of those that share it.
fn within(parts: &[(TokenStream, TokenStream)], this: &TokenStream) -> TokenStream {
    let steps = parts.iter().map(|(members, run)| {
        quote! {
            if id < #members.len() as u32 { return (#run)(#this, id, each, call); }
            let id = id - #members.len() as u32;
        }
    });
    quote! {
        let each = ((id - at) / n) as usize;
        let id = (id - at) % n;
        #(#steps)*
        return call.unknown(id);
    }
}

/// Reads know no instance, so only interfaces of the first list may have them: its ids go on to the end.
pub(crate) fn read(provided: &Interfaces<'_>) -> TokenStream {
    let Some(first) = provided.groups().next() else { return TokenStream::new() };
    let parts = parts(first, |i| i.provides_part(), "commands", "read");
    let members = parts.iter().map(|(members, _)| members);
    let found = within(&parts, &quote!(row));
    quote! {
        let n = 0 #(+ #members.len() as u32)*;
        if n > 0 {
            #found
        }
    }
}

pub(crate) fn checks(class: &Ident, provided: &Interfaces<'_>) -> TokenStream {
    let others = provided.groups().skip(1).flatten().map(|i| {
        let part = i.provides_part();
        let why = format!(
            "reads of `{}`: repeated provided interfaces may have reads when they share the list of the first one; list it \
             first in provides(…), give both one #[names(…)] list, or make these commands with a result",
            i.name
        );
        // The message is a format string.
        let why = why.replace('{', "{{").replace('}', "}}");
        quote!(assert!(!::trocar_sdk::__private::has_reads(<#class>::#part.commands), #why);)
    });
    quote!(const _: () = { #(#others)* };)
}
