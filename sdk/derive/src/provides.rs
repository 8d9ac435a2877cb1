//! `#[provides("interface")]`: the commands and reads of one provided interface.
//!
//! Invariant: the kind of a command (void, write, …, read) follows from its signature alone; the `impl` block
//! itself stays as the author wrote it, minus our attributes.

use crate::attrs::{self, Frame};
use proc_macro2::{Ident, Span, TokenStream};
use quote::{format_ident, quote, quote_spanned};
use syn::ext::IdentExt;
use syn::meta::ParseNestedMeta;
use syn::parse::{Parse, ParseStream};
use syn::spanned::Spanned;
use syn::{Attribute, Expr, FnArg, ImplItem, ItemImpl, LitStr, Meta, Pat, ReturnType, Type};

/// `"ctl"` or `"truth", tag = "truth"` or, for handlers, `"robot", direct`.
pub(crate) struct InterfaceArgs {
    pub(crate) name: LitStr,
    pub(crate) tag: String,
    pub(crate) direct: bool,
}

impl Parse for InterfaceArgs {
    fn parse(input: ParseStream<'_>) -> syn::Result<Self> {
        let name: LitStr =
            input.parse().map_err(|_| input.error("name the interface: #[provides(\"ctl\")]"))?;
        attrs::check_pattern(&name.value(), name.span())?;
        let mut args = InterfaceArgs { name, tag: String::new(), direct: false };
        while !input.is_empty() {
            input.parse::<syn::Token![,]>()?;
            let key: Ident = input.parse()?;
            if key == "direct" {
                args.direct = true;
            } else if key == "tag" {
                input.parse::<syn::Token![=]>()?;
                args.tag = attrs::tag(&input.parse::<LitStr>()?, &["truth", "sim"])?;
            } else {
                return Err(syn::Error::new(
                    key.span(),
                    "unknown setting; there are tag = \"…\" (provided) and direct (handlers)",
                ));
            }
        }
        Ok(args)
    }
}

/// One command or read.
struct Command {
    method: Ident,
    name: String,
    doc: String,
    is_read: bool,
    /// The method takes the position of its interface as an argument of its own.
    many: bool,
    overflow: String,
    ret_unit: String,
    ret_frame: Frame,
    arg: Option<Argument>,
    ret: TokenStream,
}

/// The one argument a command, read or handler may take.
pub(crate) struct Argument {
    pub(crate) name: String,
    /// The payload type, without a reference.
    pub(crate) ty: Type,
    pub(crate) by_ref: bool,
    doc: String,
    unit: String,
    pub(crate) frame: Frame,
    min: String,
    max: String,
    /// The places of its limits, of its unit and of any setting of `#[arg(…)]`.
    limited: Option<Span>,
    measured: Option<Span>,
    pub(crate) set: Option<Span>,
}

pub(crate) fn expand(args: InterfaceArgs, mut item: ItemImpl) -> syn::Result<TokenStream> {
    if args.direct {
        return Err(syn::Error::new(
            args.name.span(),
            "`direct` is for handlers: the kind says how a command runs",
        ));
    }
    if let Some((_, path, _)) = &item.trait_ {
        return Err(syn::Error::new_spanned(path, "#[provides] stands on an inherent `impl` block"));
    }
    let many = attrs::is_many(&args.name.value());
    let mut commands = Vec::new();
    for inner in &mut item.items {
        if let ImplItem::Fn(f) = inner
            && let Some((attr, is_read)) = take_attr(&mut f.attrs)
        {
            let new = command(&attr, is_read, many, f)?;
            if commands.iter().any(|c: &Command| c.name == new.name) {
                let why = format!("`{}` is used twice: names within an interface differ", new.name);
                return Err(syn::Error::new_spanned(&f.sig.ident, why));
            }
            commands.push(new);
        }
    }
    let class = &item.self_ty;
    let name = args.name.value();
    let part = format_ident!("__TROCAR_PROVIDES_{}", attrs::ident_part(&name));
    let (doc, tag) = (attrs::docs(&item.attrs), &args.tag);
    let descs = commands.iter().map(Command::desc);
    let calls = commands.iter().enumerate().filter(|(_, c)| !c.is_read).map(|(i, c)| c.dispatch(i, class));
    let reads = commands.iter().enumerate().filter(|(_, c)| c.is_read).map(|(i, c)| c.dispatch(i, class));
    let declared = declared(class, &args.name, "DeclaresProvided");
    let checks = commands.iter().map(Command::checks);
    Ok(quote! {
        #item
        #declared
        #(#checks)*
        impl #class {
            #[doc(hidden)]
            #[allow(non_upper_case_globals, dead_code, unused_variables)]
            pub(crate) const #part: ::trocar_sdk::__private::ProvidedPart<#class> =
                ::trocar_sdk::__private::ProvidedPart {
                    doc: #doc,
                    tag: #tag,
                    commands: &[#(#descs),*],
                    command: |this, id, each, call| match id { #(#calls,)* _ => call.unknown(id) },
                    read: |state, id, each, call| match id { #(#reads,)* _ => call.unknown(id) },
                };
        }
    })
}

/// A check that the class declares the interface, placed at the interface's name.
pub(crate) fn declared(class: &Type, name: &LitStr, by: &str) -> TokenStream {
    let key = attrs::interface_key(&name.value());
    let by = format_ident!("{by}");
    quote_spanned! { name.span() =>
        const _: fn() = || {
            fn declared<C: ::trocar_sdk::__private::#by<#key>>() {}
            declared::<#class>();
        };
    }
}

fn take_attr(attrs: &mut Vec<Attribute>) -> Option<(Attribute, bool)> {
    let at = attrs.iter().position(|a| a.path().is_ident("command") || a.path().is_ident("read"))?;
    let attr = attrs.remove(at);
    let is_read = attr.path().is_ident("read");
    Some((attr, is_read))
}

fn command(attr: &Attribute, is_read: bool, many: bool, f: &mut syn::ImplItemFn) -> syn::Result<Command> {
    let mut c = Command {
        method: f.sig.ident.clone(),
        name: String::new(),
        doc: attrs::docs(&f.attrs),
        is_read,
        many,
        overflow: String::new(),
        ret_unit: String::new(),
        ret_frame: Frame::take(&mut f.attrs)?,
        arg: None,
        ret: match &f.sig.output {
            ReturnType::Default => quote!(()),
            ReturnType::Type(_, ty) => quote!(#ty),
        },
    };
    if !matches!(attr.meta, Meta::Path(_)) {
        attr.parse_nested_meta(|meta| c.setting(&meta))?;
    }
    if c.name.is_empty() {
        c.name = attrs::name_of(&f.sig.ident)?;
    }
    let mut inputs = f.sig.inputs.iter_mut();
    receiver(inputs.next(), is_read, &c.method)?;
    if many {
        each(&mut inputs, &f.sig.ident)?;
    }
    c.arg = argument(&mut inputs)?;
    if is_read && matches!(f.sig.output, ReturnType::Default) {
        return Err(syn::Error::new_spanned(&f.sig.ident, "a read returns a value: add `-> T`"));
    }
    Ok(c)
}

/// The first parameter: a command changes the component, a read is given a row of its state.
fn receiver(first: Option<&mut FnArg>, is_read: bool, method: &Ident) -> syn::Result<()> {
    let right = match first {
        Some(FnArg::Receiver(r)) => !is_read && r.reference.is_some() && r.mutability.is_some(),
        Some(FnArg::Typed(_)) => is_read,
        None => false,
    };
    let wanted = if is_read {
        "a read is a pure function of a state row: `fn value(s: &MyState) -> T` (no self)"
    } else {
        "a command is `fn name(&mut self[, argument]) [-> result]`"
    };
    if right { Ok(()) } else { Err(syn::Error::new_spanned(method, wanted)) }
}

/// The `usize` that says which of the repeated interfaces is meant.
pub(crate) fn each<'a>(inputs: &mut impl Iterator<Item = &'a mut FnArg>, method: &Ident) -> syn::Result<()> {
    let usize = |ty: &Type| matches!(ty, Type::Path(p) if p.path.is_ident("usize"));
    match inputs.next() {
        Some(FnArg::Typed(typed)) if usize(&typed.ty) => Ok(()),
        _ => Err(syn::Error::new_spanned(
            method,
            "this interface exists many times: the next parameter says which one, `at: usize`",
        )),
    }
}

/// The remaining parameter, if any, with its `#[arg(…)]` taken off.
pub(crate) fn argument<'a>(
    inputs: &mut impl Iterator<Item = &'a mut FnArg>,
) -> syn::Result<Option<Argument>> {
    let Some(first) = inputs.next() else { return Ok(None) };
    let FnArg::Typed(typed) = first else { return Err(syn::Error::new_spanned(first, "unexpected self")) };
    if let Some(extra) = inputs.next() {
        return Err(syn::Error::new_spanned(
            extra,
            "at most one argument: put several values into one payload",
        ));
    }
    let (ty, by_ref) = match &*typed.ty {
        Type::Reference(r) => ((*r.elem).clone(), true),
        ty => (ty.clone(), false),
    };
    let name = match &*typed.pat {
        Pat::Ident(p) => p.ident.unraw().to_string().trim_start_matches('_').to_string(),
        _ => String::new(),
    };
    let mut arg = Argument {
        name,
        ty,
        by_ref,
        doc: String::new(),
        unit: String::new(),
        frame: Frame::take(&mut typed.attrs)?,
        min: String::new(),
        max: String::new(),
        limited: None,
        measured: None,
        set: None,
    };
    for attr in typed.attrs.iter().filter(|a| a.path().is_ident("arg")) {
        attr.parse_nested_meta(|meta| arg.setting(&meta))?;
    }
    if let (Ok(min), Ok(max)) = (arg.min.parse::<f64>(), arg.max.parse::<f64>())
        && min > max
    {
        let why = format!("min {min} is above max {max}: no value would be taken");
        return Err(syn::Error::new_spanned(&typed.pat, why));
    }
    typed.attrs.retain(|a| !a.path().is_ident("arg"));
    Ok(Some(arg))
}

impl Command {
    /// One setting of `#[command(…)]` or `#[read(…)]`.
    fn setting(&mut self, meta: &ParseNestedMeta<'_>) -> syn::Result<()> {
        let key = meta.path.get_ident().map(ToString::to_string).unwrap_or_default();
        let text = || meta.value()?.parse::<LitStr>();
        match key.as_str() {
            "name" => {
                let name = text()?;
                attrs::check_name(&name.value(), name.span())?;
                self.name = name.value();
            }
            "unit" => self.ret_unit = attrs::unit(&text()?)?,
            "overflow" if !self.is_read => {
                let policy = text()?;
                self.overflow = policy.value();
                if !["reject", "latest_wins", "drop_oldest"].contains(&self.overflow.as_str()) {
                    let why = "overflow is reject, latest_wins or drop_oldest";
                    return Err(syn::Error::new(policy.span(), why));
                }
            }
            _ => return Err(meta.error("unknown setting; there are name, unit and, for commands, overflow")),
        }
        Ok(())
    }

    fn desc(&self) -> TokenStream {
        let Command { name, doc, is_read, overflow, ret_unit, ret, .. } = self;
        let ret_frame = &self.ret_frame.name;
        let (arg_ty, arg) = match &self.arg {
            None => (quote!(()), quote!(None)),
            Some(Argument { name, ty, doc, unit, min, max, frame: Frame { name: frame, .. }, .. }) => (
                quote!(#ty),
                quote! {
                    Some(::trocar_sdk::__private::ArgDesc {
                        name: #name, doc: #doc, ty: <#ty as ::trocar_sdk::Payload>::DESC,
                        unit: #unit, frame: #frame, min: #min, max: #max,
                    })
                },
            ),
        };
        quote! {
            ::trocar_sdk::__private::CommandDesc {
                name: #name,
                doc: #doc,
                kind: ::trocar_sdk::__private::kind_of::<#arg_ty, #ret>(#is_read),
                arg: #arg,
                ret: <<#ret as ::trocar_sdk::__private::Answer>::Value as ::trocar_sdk::Value>::DESC,
                ret_unit: #ret_unit,
                ret_frame: #ret_frame,
                overflow: #overflow,
            }
        }
    }

    /// An argument in a coordinate frame has coordinates; one with limits or a unit has numbers.
    fn checks(&self) -> TokenStream {
        let ret = &self.ret;
        let result = quote!(<<#ret as ::trocar_sdk::__private::Answer>::Value as ::trocar_sdk::Value>::DESC);
        let frame = self.arg.as_ref().map(Argument::check_frame);
        let numbers = self.arg.as_ref().map(Argument::check_numbers);
        let ret = self.ret_frame.check(&[result]);
        quote!(#frame #numbers #ret)
    }

    fn dispatch(&self, id: usize, class: &Type) -> TokenStream {
        let (id, method) = (id as u32, &self.method);
        let this = if self.is_read { quote!(state) } else { quote!(this) };
        let (arg_ty, pattern, call) = call_of(&self.arg, quote!(<#class>::#method), this, self.many);
        // The reason why `run` may be called: the description above names the very types used here.
        quote!(#id => unsafe { call.run::<#arg_ty, _>(|#pattern| #call) })
    }
}

impl Argument {
    /// One setting of `#[arg(…)]`.
    fn setting(&mut self, meta: &ParseNestedMeta<'_>) -> syn::Result<()> {
        let said = Some(meta.path.span());
        self.set = said;
        if meta.path.is_ident("unit") {
            self.measured = said;
            self.unit = attrs::unit(&meta.value()?.parse::<LitStr>()?)?;
        } else if meta.path.is_ident("doc") {
            self.doc = meta.value()?.parse::<LitStr>()?.value();
        } else if meta.path.is_ident("min") {
            self.limited = said;
            self.min = attrs::number(&meta.value()?.parse::<Expr>()?)?;
        } else if meta.path.is_ident("max") {
            self.limited = said;
            self.max = attrs::number(&meta.value()?.parse::<Expr>()?)?;
        } else {
            return Err(meta.error("unknown setting; there are unit, min, max and doc"));
        }
        Ok(())
    }

    pub(crate) fn check_frame(&self) -> TokenStream {
        let ty = &self.ty;
        self.frame.check(&[quote!(::core::option::Option::Some(<#ty as ::trocar_sdk::Payload>::DESC))])
    }

    /// Checks that an argument with limits or a unit has numbers: elsewhere they would never hold.
    fn check_numbers(&self) -> TokenStream {
        let ty = &self.ty;
        let check = |said: Option<Span>, fits: &str| {
            said.map(|span| {
                let fits = Ident::new(fits, span);
                quote_spanned! {span =>
                    const _: () = ::trocar_sdk::__private::#fits(<#ty as ::trocar_sdk::Payload>::DESC);
                }
            })
        };
        let limits = check(self.limited, "limits_fit");
        let unit = check(self.measured, "unit_fits");
        quote!(#limits #unit)
    }
}

/// Argument type, closure pattern and call expression of a method with at most one argument.
pub(crate) fn call_of(
    arg: &Option<Argument>,
    path: TokenStream,
    this: TokenStream,
    many: bool,
) -> (TokenStream, TokenStream, TokenStream) {
    let this = if many { quote!(#this, each) } else { this };
    match arg {
        None => (quote!(()), quote!(()), quote!(#path(#this))),
        Some(a) => {
            let ty = &a.ty;
            let value = if a.by_ref { quote!(&value) } else { quote!(value) };
            (quote!(#ty), quote!(value), quote!(#path(#this, #value)))
        }
    }
}
