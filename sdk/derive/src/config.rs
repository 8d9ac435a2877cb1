//! `#[derive(Config)]`: the JSON Schema of a configuration struct and its reader.
//!
//! Invariant: the schema is written from the type's tokens, because const strings cannot be built from generics.

use crate::attrs;
use proc_macro2::TokenStream;
use quote::quote;
use syn::{Data, DeriveInput, Expr, Field, Fields, GenericArgument, PathArguments, Type};

#[derive(Default)]
struct Settings {
    live: bool,
    min: String,
    max: String,
    unit: String,
    default: String,
    one_of: String,
    /// The default and the choice as written.
    given: Option<Expr>,
    choice: Option<Expr>,
}

pub(crate) fn derive(input: DeriveInput) -> syn::Result<TokenStream> {
    let name = &input.ident;
    let Data::Struct(data) = &input.data else {
        return Err(syn::Error::new_spanned(name, "a configuration is a struct with named fields"));
    };
    let fields: Vec<&Field> = match &data.fields {
        Fields::Named(named) => named.named.iter().collect(),
        Fields::Unit => Vec::new(),
        Fields::Unnamed(_) => {
            return Err(syn::Error::new_spanned(name, "a configuration is a struct with named fields"));
        }
    };
    let mut descs = Vec::new();
    let mut reads = Vec::new();
    let mut unset = Vec::new();
    for (i, field) in fields.iter().enumerate() {
        let Some(ident) = &field.ident else { continue };
        let text = ident.to_string();
        let doc = attrs::docs(&field.attrs);
        let mut s = settings(field)?;
        possible(field, &s)?;
        let schema = schema(&field.ty, &mut s)?;
        let Settings { live, min, max, unit, default, .. } = s;
        descs.push(quote! {
            ::trocar_sdk::__private::ConfigFieldDesc {
                name: #text, doc: #doc, schema: #schema, unit: #unit,
                min: #min, max: #max, default: #default, live: #live,
            }
        });
        reads.push(quote! { #ident: ::trocar_sdk::__private::config_field(object, &Self::FIELDS[#i])? });
        unset.push(quote! { #ident: ::trocar_sdk::__private::config_unset(&Self::FIELDS[#i]) });
    }
    Ok(quote! {
        impl ::trocar_sdk::Config for #name {
            const FIELDS: &'static [::trocar_sdk::__private::ConfigFieldDesc] = &[#(#descs),*];
            fn parse(object: &::trocar_sdk::__private::JsonObject) -> ::trocar_sdk::Result<Self> {
                ::trocar_sdk::__private::config_known(object, Self::FIELDS)?;
                Ok(Self { #(#reads),* })
            }
            fn unset() -> Self {
                Self { #(#unset),* }
            }
        }
    })
}

fn settings(field: &Field) -> syn::Result<Settings> {
    let mut s = Settings::default();
    for attr in field.attrs.iter().filter(|a| a.path().is_ident("config")) {
        if matches!(attr.meta, syn::Meta::Path(_)) {
            continue;
        }
        attr.parse_nested_meta(|meta| {
            if meta.path.is_ident("live") {
                s.live = true;
            } else if meta.path.is_ident("min") {
                s.min = attrs::number(&meta.value()?.parse::<Expr>()?)?;
            } else if meta.path.is_ident("max") {
                s.max = attrs::number(&meta.value()?.parse::<Expr>()?)?;
            } else if meta.path.is_ident("unit") {
                s.unit = attrs::unit(&meta.value()?.parse::<syn::LitStr>()?)?;
            } else if meta.path.is_ident("default") {
                let given = meta.value()?.parse::<Expr>()?;
                s.default = attrs::json(&given)?;
                s.given = Some(given);
            } else if meta.path.is_ident("one_of") {
                let choice = meta.value()?.parse::<Expr>()?;
                s.one_of = attrs::json(&choice)?;
                s.choice = Some(choice);
            } else {
                return Err(meta.error("unknown setting; there are live, min, max, unit, default and one_of"));
            }
            Ok(())
        })?;
    }
    Ok(s)
}

/// Refuses limits that no value lies within, and a default outside of them: nobody could configure such a class.
fn possible(field: &Field, s: &Settings) -> syn::Result<()> {
    let whole = leaf(&field.ty).and_then(|name| integer_limits(&name)).unwrap_or_default();
    let limit = |text: &str, of_type: &str| {
        let text = if text.is_empty() { of_type } else { text };
        text.parse::<f64>().ok()
    };
    let (min, max) = (limit(&s.min, whole.0), limit(&s.max, whole.1));
    if let (Some(low), Some(high)) = (min, max)
        && low > high
    {
        let why = format!("min {low} is above max {high}: no value would be taken");
        return Err(syn::Error::new_spanned(field, why));
    }
    let Some(given) = &s.given else { return Ok(()) };
    for item in items_of(given) {
        let Some(number) = attrs::number(item).ok().and_then(|text| text.parse::<f64>().ok()) else {
            continue;
        };
        let why = match (min, max) {
            (Some(min), _) if number < min => format!("the default {number} is below min {min}"),
            (_, Some(max)) if number > max => format!("the default {number} is above max {max}"),
            _ => continue,
        };
        return Err(syn::Error::new_spanned(item, why));
    }
    let Some(choice) = s.choice.as_ref().filter(|_| !matches!(given, Expr::Array(_) | Expr::Path(_))) else {
        return Ok(());
    };
    let allowed = items_of(choice).into_iter().map(attrs::json).collect::<syn::Result<Vec<_>>>()?;
    let same = |one: &String| match (one.parse::<f64>(), s.default.parse::<f64>()) {
        (Ok(a), Ok(b)) => a == b,
        _ => *one == s.default,
    };
    if allowed.iter().any(same) {
        return Ok(());
    }
    let why = format!("the default {} is not one of {}", s.default, allowed.join(", "));
    Err(syn::Error::new_spanned(given, why))
}

/// The items of a written list; anything else is one item.
fn items_of(expr: &Expr) -> Vec<&Expr> {
    match expr {
        Expr::Array(items) => items.elems.iter().collect(),
        one => vec![one],
    }
}

/// The innermost type of a list or option.
fn leaf(ty: &Type) -> Option<String> {
    match ty {
        Type::Array(array) => leaf(&array.elem),
        Type::Path(path) => {
            let last = path.path.segments.last()?;
            inner(&last.arguments).map_or_else(|| Some(last.ident.to_string()), leaf)
        }
        _ => None,
    }
}

/// The inside of the field's schema object. Limits of list items move into `items`; those of plain numbers stay in `s`.
fn schema(ty: &Type, s: &mut Settings) -> syn::Result<String> {
    let enumeration = |s: &Settings| {
        if s.one_of.is_empty() { String::new() } else { format!(",\"enum\":{}", s.one_of) }
    };
    match ty {
        Type::Array(array) => {
            let items = items(&array.elem, s)?;
            let count = match &array.len {
                Expr::Lit(lit) => {
                    let n = attrs::number(&Expr::Lit(lit.clone()))?;
                    format!(",\"minItems\":{n},\"maxItems\":{n}")
                }
                _ => String::new(),
            };
            Ok(format!("\"type\":\"array\",\"items\":{items}{count}"))
        }
        Type::Path(path) => {
            let Some(last) = path.path.segments.last() else { return Err(unknown(ty)) };
            match last.ident.to_string().as_str() {
                "f64" | "f32" => Ok(format!("\"type\":\"number\"{}", enumeration(s))),
                "bool" => Ok("\"type\":\"boolean\"".to_string()),
                "String" => Ok(format!("\"type\":\"string\"{}", enumeration(s))),
                "Vec" => {
                    let items = items(inner(&last.arguments).ok_or_else(|| unknown(ty))?, s)?;
                    Ok(format!("\"type\":\"array\",\"items\":{items}"))
                }
                "Option" => {
                    let inside = schema(inner(&last.arguments).ok_or_else(|| unknown(ty))?, s)?;
                    if s.default.is_empty() {
                        s.default = "null".to_string();
                    }
                    let Some((first, rest)) =
                        inside.strip_prefix("\"type\":").map(|t| t.split_at(t.find(',').unwrap_or(t.len())))
                    else {
                        return Err(unknown(ty));
                    };
                    Ok(format!("\"type\":[{first},\"null\"]{rest}"))
                }
                name => {
                    let (min, max) = integer_limits(name).ok_or_else(|| unknown(ty))?;
                    if s.min.is_empty() {
                        s.min = min.to_string();
                    }
                    if s.max.is_empty() {
                        s.max = max.to_string();
                    }
                    Ok(format!("\"type\":\"integer\"{}", enumeration(s)))
                }
            }
        }
        _ => Err(unknown(ty)),
    }
}

fn items(ty: &Type, s: &mut Settings) -> syn::Result<String> {
    let inside = schema(ty, s)?;
    let mut limits = String::new();
    for (key, value) in [("minimum", std::mem::take(&mut s.min)), ("maximum", std::mem::take(&mut s.max))] {
        if !value.is_empty() {
            limits.push_str(&format!(",\"{key}\":{value}"));
        }
    }
    s.one_of.clear();
    Ok(format!("{{{inside}{limits}}}"))
}

fn inner(arguments: &PathArguments) -> Option<&Type> {
    match arguments {
        PathArguments::AngleBracketed(args) => args.args.iter().find_map(|a| match a {
            GenericArgument::Type(ty) => Some(ty),
            _ => None,
        }),
        _ => None,
    }
}

/// JSON text of the smallest and largest value; 64-bit types are limited by JSON itself, except below by zero.
fn integer_limits(name: &str) -> Option<(&'static str, &'static str)> {
    Some(match name {
        "u8" => ("0", "255"),
        "u16" => ("0", "65535"),
        "u32" => ("0", "4294967295"),
        "u64" | "usize" => ("0", ""),
        "i8" => ("-128", "127"),
        "i16" => ("-32768", "32767"),
        "i32" => ("-2147483648", "2147483647"),
        "i64" | "isize" => ("", ""),
        _ => return None,
    })
}

fn unknown(ty: &Type) -> syn::Error {
    syn::Error::new_spanned(
        ty,
        "a configuration field is f64, f32, an integer, bool, String, or [T; N], Vec<T>, Option<T> of these",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(field: &str) -> String {
        let input = syn::parse_str(&format!("struct Cfg {{ {field} }}")).expect(field);
        derive(input).err().map(|e| e.to_string()).unwrap_or_default()
    }

    #[test]
    fn a_setting_that_could_never_be_valid_does_not_compile() {
        for (field, why) in [
            ("#[config(min = 3, max = 1, default = 5.0)] x: f64", "min 3 is above max 1"),
            ("#[config(min = 1, max = 3, default = 5.0)] x: f64", "the default 5 is above max 3"),
            ("#[config(min = -1.5, default = -2)] x: Option<f64>", "the default -2 is below min -1.5"),
            ("#[config(max = 3, default = [1, 2, 4])] x: [f64; 3]", "the default 4 is above max 3"),
            ("#[config(default = 300)] x: u8", "the default 300 is above max 255"),
            ("#[config(default = -1)] x: Vec<usize>", "the default -1 is below min 0"),
            ("#[config(min = 300)] x: u8", "min 300 is above max 255"),
            (
                "#[config(one_of = [\"bm\", \"sgm\"], default = \"gm\")] x: String",
                "the default \"gm\" is not one of \"bm\", \"sgm\"",
            ),
        ] {
            assert!(said(field).contains(why), "{field}: {}", said(field));
        }
    }

    #[test]
    fn limits_that_can_be_met_compile() {
        for field in [
            "#[config(min = 3, max = 3, default = 3)] x: f64",
            "#[config(default = None, min = 0.5)] x: Option<f64>",
            "#[config(default = [])] x: Vec<String>",
            "#[config(one_of = [1, 2], default = 1.0)] x: f64",
            "#[config(one_of = [\"a,b\", \"c\"], default = \"a,b\")] x: String",
            "#[config(min = 1)] x: u64",
        ] {
            assert_eq!(said(field), "", "{field}");
        }
    }
}
