//! Small readers of attributes and names, shared by all derives.
//!
//! Invariant: numbers of attributes stay text (`0.1` is never rounded through a float on its way to the
//! manifest).

use proc_macro2::{Ident, Span, TokenStream};
use quote::quote_spanned;
use syn::ext::IdentExt;
use syn::{Attribute, Expr, ExprLit, ExprUnary, Lit, LitStr, Meta, UnOp};
use trocar_plugin_api::limits;

/// The doc comment, one leading space removed per line, without blank lines at the ends.
pub(crate) fn docs(attrs: &[Attribute]) -> String {
    let mut lines: Vec<String> = Vec::new();
    for attr in attrs.iter().filter(|a| a.path().is_ident("doc")) {
        if let Meta::NameValue(pair) = &attr.meta
            && let Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) = &pair.value
        {
            let text = text.value();
            lines.push(text.strip_prefix(' ').unwrap_or(&text).trim_end().to_string());
        }
    }
    lines.join("\n").trim().to_string()
}

/// The text of `#[name("text")]`, empty when the attribute is absent.
pub(crate) fn text_attr(attrs: &[Attribute], name: &str) -> syn::Result<String> {
    match attrs.iter().find(|a| a.path().is_ident(name)) {
        Some(attr) => Ok(attr.parse_args::<LitStr>()?.value()),
        None => Ok(String::new()),
    }
}

/// A coordinate frame, and the author's position of it.
#[derive(Default)]
pub(crate) struct Frame {
    pub(crate) name: String,
    span: Option<Span>,
}

impl Frame {
    /// Reads `#[frame("retina")]`; empty when the attribute is absent.
    pub(crate) fn of(attrs: &[Attribute]) -> syn::Result<Frame> {
        let Some(attr) = attrs.iter().find(|a| a.path().is_ident("frame")) else {
            return Ok(Frame::default());
        };
        let text = attr.parse_args::<LitStr>()?;
        if text.value().trim().is_empty() {
            return Err(syn::Error::new(
                text.span(),
                "a coordinate frame has a name, such as #[frame(\"retina\")]",
            ));
        }
        Ok(Frame { name: text.value(), span: Some(text.span()) })
    }

    /// Reads the frame and takes the attribute off: what stays behind is none of our business.
    pub(crate) fn take(attrs: &mut Vec<Attribute>) -> syn::Result<Frame> {
        let frame = Frame::of(attrs)?;
        attrs.retain(|a| !a.path().is_ident("frame"));
        Ok(frame)
    }

    /// A check that one of the described payloads (expressions of type `Option<&TypeDesc>`) has coordinates.
    pub(crate) fn check(&self, payloads: &[TokenStream]) -> TokenStream {
        let Some(span) = self.span else { return TokenStream::new() };
        quote_spanned!(span => const _: () = ::trocar_sdk::__private::frame_fits(&[#(#payloads),*]);)
    }
}

/// `LowPass` → `low_pass`; `OCTSource` → `oct_source`.
pub(crate) fn snake(name: &str) -> String {
    let chars: Vec<char> = name.chars().collect();
    let mut out = String::new();
    for (i, c) in chars.iter().enumerate() {
        if c.is_uppercase() && i > 0 {
            let after_lower = !chars[i - 1].is_uppercase() && chars[i - 1] != '_';
            let before_lower = chars.get(i + 1).is_some_and(|n| n.is_lowercase());
            if after_lower || (before_lower && chars[i - 1] != '_') {
                out.push('_');
            }
        }
        out.extend(c.to_lowercase());
    }
    out
}

/// Names of classes, interfaces, ports and members, so that `process/component/port` stays unambiguous.
pub(crate) fn check_name(name: &str, span: Span) -> syn::Result<()> {
    limits::name_fault(name).map_or(Ok(()), |why| Err(syn::Error::new(span, why)))
}

/// The name that an identifier gives, `type` for `r#type`.
pub(crate) fn name_of(ident: &Ident) -> syn::Result<String> {
    let name = ident.unraw().to_string();
    match limits::name_fault(&name) {
        None => Ok(name),
        Some(why) => Err(syn::Error::new(ident.span(), format!("{why}; or give it one, name = \"…\""))),
    }
}

/// A unit; an unknown one is a mistake at compile time.
pub(crate) fn unit(text: &LitStr) -> syn::Result<String> {
    match trocar_plugin_api::units::check(&text.value()) {
        Ok(()) => Ok(text.value()),
        Err(why) => Err(syn::Error::new(text.span(), why)),
    }
}

/// Checks a tag against the allowed ones; the host enforces it at Connect, so a typing error must not pass.
pub(crate) fn tag(text: &LitStr, allowed: &[&str]) -> syn::Result<String> {
    let value = text.value();
    if allowed.contains(&value.as_str()) {
        return Ok(value);
    }
    Err(syn::Error::new(
        text.span(),
        format!("`{value}` is no tag of this; there are: {}", allowed.join(", ")),
    ))
}

/// The unit of `#[unit("N")]`, empty when the attribute is absent.
pub(crate) fn unit_attr(attrs: &[Attribute]) -> syn::Result<String> {
    match attrs.iter().find(|a| a.path().is_ident("unit")) {
        Some(attr) => unit(&attr.parse_args::<LitStr>()?),
        None => Ok(String::new()),
    }
}

/// A name, or one with `{}` in it: then its port or interface exists once for each name of a list.
pub(crate) fn check_pattern(pattern: &str, span: Span) -> syn::Result<()> {
    check_name(&pattern.replacen("{}", "x", 1), span)
}

/// Tells whether this is the name of something repeated.
pub(crate) fn is_many(pattern: &str) -> bool {
    pattern.contains("{}")
}

/// The part of an identifier that stands for an interface name.
pub(crate) fn ident_part(name: &str) -> String {
    name.replace('-', "_").replace("{}", "__EACH__")
}

/// The same hash as `trocar_sdk::__private::interface_key`, so that an undeclared interface is found at
/// compile time.
pub(crate) fn interface_key(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// A number literal, possibly negative, as the author wrote it but valid as JSON.
pub(crate) fn number(expr: &Expr) -> syn::Result<String> {
    let wrong = || syn::Error::new_spanned(expr, "a number literal is wanted here, such as 0.5 or -20");
    match expr {
        Expr::Lit(ExprLit { lit: Lit::Int(n), .. }) => Ok(n.base10_digits().to_string()),
        Expr::Lit(ExprLit { lit: Lit::Float(n), .. }) => {
            let digits = n.base10_digits();
            if !digits.parse::<f64>().is_ok_and(f64::is_finite) {
                return Err(syn::Error::new_spanned(expr, "this number is larger than any f64"));
            }
            // JSON has neither `1.` nor `00.5`.
            let digits = if digits.ends_with('.') { format!("{digits}0") } else { digits.to_string() };
            let whole = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
            let zeros = digits[..whole.saturating_sub(1)].chars().take_while(|c| *c == '0').count();
            Ok(digits[zeros..].to_string())
        }
        Expr::Unary(ExprUnary { op: UnOp::Neg(_), expr, .. }) => Ok(format!("-{}", number(expr)?)),
        _ => Err(wrong()),
    }
}

/// A literal as JSON text: numbers, booleans, text, arrays of these, and `None`.
pub(crate) fn json(expr: &Expr) -> syn::Result<String> {
    match expr {
        Expr::Lit(ExprLit { lit: Lit::Str(s), .. }) => Ok(quote_json(&s.value())),
        Expr::Lit(ExprLit { lit: Lit::Bool(b), .. }) => Ok(b.value.to_string()),
        Expr::Array(items) => {
            let items = items.elems.iter().map(json).collect::<syn::Result<Vec<_>>>()?;
            Ok(format!("[{}]", items.join(",")))
        }
        Expr::Path(p) if p.path.is_ident("None") => Ok("null".to_string()),
        _ => number(expr).map_err(|_| {
            syn::Error::new_spanned(
                expr,
                "a default is a literal: a number, true, false, \"text\", an array of these, or None",
            )
        }),
    }
}

/// Text as a JSON string.
pub(crate) fn quote_json(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if (c as u32) < 0x20 => out.push_str(&format!("\\u{:04x}", c as u32)),
            c => out.push(c),
        }
    }
    out.push('"');
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn struct_names_become_class_names_word_by_word() {
        for (from, to) in
            [("LowPass", "low_pass"), ("OCTSource", "oct_source"), ("Sine", "sine"), ("A2B", "a2_b")]
        {
            assert_eq!(snake(from), to);
        }
    }

    #[test]
    fn literals_become_valid_json() {
        for (rust, want) in [
            ("1.", "1.0"),
            ("-2", "-2"),
            ("1_000.5", "1000.5"),
            ("00.5", "0.5"),
            ("0012.0", "12.0"),
            ("0.0", "0.0"),
            ("1e3", "1e3"),
            ("None", "null"),
            ("[1, \"a\\\"\"]", "[1,\"a\\\"\"]"),
        ] {
            let expr: Expr = syn::parse_str(rust).expect(rust);
            assert_eq!(json(&expr).expect(rust), want);
        }
        let endless: Expr = syn::parse_str("1e999").expect("a literal");
        assert!(
            number(&endless).expect_err("JSON has no infinity").to_string().contains("larger than any f64")
        );
    }
}
