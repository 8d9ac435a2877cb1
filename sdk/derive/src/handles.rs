//! `#[handles("interface")]`: the event handlers of one required interface.
//!
//! Invariant: a handler's payload type follows from its signature; `T` and `&T` mean the same event.

use crate::attrs;
use crate::provides::{Argument, InterfaceArgs, argument, call_of, declared, each};
use proc_macro2::TokenStream;
use quote::{format_ident, quote};
use syn::{FnArg, ImplItem, ItemImpl, LitStr, Meta};

pub(crate) fn expand(args: InterfaceArgs, mut item: ItemImpl) -> syn::Result<TokenStream> {
    if !args.tag.is_empty() {
        return Err(syn::Error::new(args.name.span(), "a tag belongs to a provided interface"));
    }
    let many = attrs::is_many(&args.name.value());
    let class = item.self_ty.clone();
    let (mut descs, mut calls, mut frames) = (Vec::new(), Vec::new(), Vec::new());
    let mut names: Vec<String> = Vec::new();
    for inner in &mut item.items {
        let ImplItem::Fn(f) = inner else { continue };
        let Some(at) = f.attrs.iter().position(|a| a.path().is_ident("on")) else { continue };
        let attr = f.attrs.remove(at);
        let (mut name, mut optional, mut direct) = (String::new(), false, args.direct);
        if !matches!(attr.meta, Meta::Path(_)) {
            attr.parse_nested_meta(|meta| {
                if meta.path.is_ident("optional") {
                    optional = true;
                } else if meta.path.is_ident("direct") {
                    direct = true;
                } else if meta.path.is_ident("name") {
                    let text = meta.value()?.parse::<LitStr>()?;
                    attrs::check_name(&text.value(), text.span())?;
                    name = text.value();
                } else {
                    return Err(meta.error("unknown setting; there are name, optional and direct"));
                }
                Ok(())
            })?;
        }
        if name.is_empty() {
            name = attrs::name_of(&f.sig.ident)?;
        }
        if names.contains(&name) {
            let why = format!("`{name}` is used twice: names within an interface differ");
            return Err(syn::Error::new_spanned(&f.sig.ident, why));
        }
        names.push(name.clone());
        let doc = attrs::docs(&f.attrs);
        let mut inputs = f.sig.inputs.iter_mut();
        if !matches!(inputs.next(), Some(FnArg::Receiver(r)) if r.reference.is_some()) {
            return Err(syn::Error::new_spanned(
                &f.sig.ident,
                "a handler is `fn name(&mut self[, payload])`",
            ));
        }
        if many {
            each(&mut inputs, &f.sig.ident)?;
        }
        let arg = argument(&mut inputs)?;
        if let Some(said) = arg.as_ref().and_then(|a| a.set) {
            return Err(syn::Error::new(
                said,
                "nothing is said of what a handler is given: its unit is said where the event is declared, and limits \
                 are for the arguments of commands; remove #[arg(…)]",
            ));
        }
        let payload = match &arg {
            None => quote!(None),
            Some(Argument { ty, .. }) => quote!(Some(<#ty as ::trocar_sdk::Payload>::DESC)),
        };
        let frame = arg.as_ref().map_or("", |a| a.frame.name.as_str());
        frames.extend(arg.as_ref().map(Argument::check_frame));
        descs.push(quote! {
            ::trocar_sdk::__private::HandlerDesc {
                name: #name, doc: #doc, payload: #payload, frame: #frame, optional: #optional, direct: #direct,
            }
        });
        let (id, method) = (calls.len() as u32, &f.sig.ident);
        let (arg_ty, pattern, call) = call_of(&arg, quote!(<#class>::#method), quote!(this), many);
        calls.push(quote!(#id => unsafe { call.run::<#arg_ty, _>(|#pattern| #call) }));
    }
    let part = format_ident!("__TROCAR_HANDLES_{}", attrs::ident_part(&args.name.value()));
    let doc = attrs::docs(&item.attrs);
    let declared = declared(&class, &args.name, "DeclaresRequired");
    Ok(quote! {
        #item
        #declared
        #(#frames)*
        impl #class {
            #[doc(hidden)]
            #[allow(non_upper_case_globals, dead_code, unused_variables)]
            pub(crate) const #part: ::trocar_sdk::__private::HandlesPart<#class> =
                ::trocar_sdk::__private::HandlesPart {
                    doc: #doc,
                    handlers: &[#(#descs),*],
                    on_event: |this, id, each, call| match id { #(#calls,)* _ => call.unknown(id) },
                };
        }
    })
}
