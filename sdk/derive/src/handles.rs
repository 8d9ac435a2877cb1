//! `#[handles("interface")]`: the event handlers of one required interface.
//!
//! Invariant: a handler's payload type follows from its signature; `T` and `&T` mean the same event.

use crate::attrs;
use crate::provides::{Argument, InterfaceArgs, argument, call_of, declared, each};
use proc_macro2::{Ident, TokenStream};
use quote::{format_ident, quote};
use syn::meta::ParseNestedMeta;
use syn::{Attribute, FnArg, ImplItem, ImplItemFn, ItemImpl, LitStr, Meta, Type};

/// One event handler.
struct Handler {
    method: Ident,
    name: String,
    doc: String,
    optional: bool,
    direct: bool,
    /// The method takes the position of its interface as an argument of its own.
    many: bool,
    arg: Option<Argument>,
}

pub(crate) fn expand(args: InterfaceArgs, mut item: ItemImpl) -> syn::Result<TokenStream> {
    if !args.tag.is_empty() {
        return Err(syn::Error::new(args.name.span(), "a tag belongs to a provided interface"));
    }
    let mut handlers: Vec<Handler> = Vec::new();
    for inner in &mut item.items {
        let ImplItem::Fn(f) = inner else { continue };
        let Some(at) = f.attrs.iter().position(|a| a.path().is_ident("on")) else { continue };
        let attr = f.attrs.remove(at);
        let new = handler(&attr, &args, f)?;
        if handlers.iter().any(|h| h.name == new.name) {
            let why = format!("`{}` is used twice: names within an interface differ", new.name);
            return Err(syn::Error::new_spanned(&f.sig.ident, why));
        }
        handlers.push(new);
    }
    let class = &item.self_ty;
    let part = format_ident!("__TROCAR_HANDLES_{}", attrs::ident_part(&args.name.value()));
    let doc = attrs::docs(&item.attrs);
    let declared = declared(class, &args.name, "DeclaresRequired");
    let frames = handlers.iter().filter_map(|h| h.arg.as_ref()).map(Argument::check_frame);
    let descs = handlers.iter().map(Handler::desc);
    let calls = handlers.iter().enumerate().map(|(id, h)| h.dispatch(id, class));
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

fn handler(attr: &Attribute, args: &InterfaceArgs, f: &mut ImplItemFn) -> syn::Result<Handler> {
    let mut h = Handler {
        method: f.sig.ident.clone(),
        name: String::new(),
        doc: attrs::docs(&f.attrs),
        optional: false,
        direct: args.direct,
        many: attrs::is_many(&args.name.value()),
        arg: None,
    };
    if !matches!(attr.meta, Meta::Path(_)) {
        attr.parse_nested_meta(|meta| h.setting(&meta))?;
    }
    if h.name.is_empty() {
        h.name = attrs::name_of(&f.sig.ident)?;
    }
    let mut inputs = f.sig.inputs.iter_mut();
    if !matches!(inputs.next(), Some(FnArg::Receiver(r)) if r.reference.is_some()) {
        return Err(syn::Error::new_spanned(&f.sig.ident, "a handler is `fn name(&mut self[, payload])`"));
    }
    if h.many {
        each(&mut inputs, &f.sig.ident)?;
    }
    h.arg = argument(&mut inputs)?;
    if let Some(said) = h.arg.as_ref().and_then(|a| a.set) {
        return Err(syn::Error::new(
            said,
            "nothing is said of what a handler is given: its unit is said where the event is declared, and limits \
             are for the arguments of commands; remove #[arg(…)]",
        ));
    }
    Ok(h)
}

impl Handler {
    /// One setting of `#[on(…)]`.
    fn setting(&mut self, meta: &ParseNestedMeta<'_>) -> syn::Result<()> {
        if meta.path.is_ident("optional") {
            self.optional = true;
        } else if meta.path.is_ident("direct") {
            self.direct = true;
        } else if meta.path.is_ident("name") {
            let text = meta.value()?.parse::<LitStr>()?;
            attrs::check_name(&text.value(), text.span())?;
            self.name = text.value();
        } else {
            return Err(meta.error("unknown setting; there are name, optional and direct"));
        }
        Ok(())
    }

    fn desc(&self) -> TokenStream {
        let Handler { name, doc, optional, direct, .. } = self;
        let payload = match &self.arg {
            None => quote!(None),
            Some(Argument { ty, .. }) => quote!(Some(<#ty as ::trocar_sdk::Payload>::DESC)),
        };
        let frame = self.arg.as_ref().map_or("", |a| a.frame.name.as_str());
        quote! {
            ::trocar_sdk::__private::HandlerDesc {
                name: #name, doc: #doc, payload: #payload, frame: #frame, optional: #optional, direct: #direct,
            }
        }
    }

    fn dispatch(&self, id: usize, class: &Type) -> TokenStream {
        let (id, method) = (id as u32, &self.method);
        let (arg_ty, pattern, call) = call_of(&self.arg, quote!(<#class>::#method), quote!(this), self.many);
        quote!(#id => unsafe { call.run::<#arg_ty, _>(|#pattern| #call) })
    }
}
