//! `#[derive(Config)]`: the JSON Schema of a configuration struct and its reader.
//!
//! Invariant: the schema is written from the type's tokens, because const strings cannot be built from
//! generics.

mod fit;

use crate::attrs;
use proc_macro2::TokenStream;
use quote::quote;
use syn::ext::IdentExt;
use syn::{Data, DeriveInput, Expr, Field, Fields, GenericArgument, PathArguments, Type, TypeArray};

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
        let text = ident.unraw().to_string();
        let doc = attrs::docs(&field.attrs);
        let mut s = settings(field)?;
        fit::kinds(field, &s)?;
        fit::possible(field, &s)?;
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

/// Returns the inside of the field's schema object. Limits of list items move into `items`; those of plain
/// numbers stay in `s`.
fn schema(ty: &Type, s: &mut Settings) -> syn::Result<String> {
    let path = match ty {
        Type::Array(array) => return list(array, s),
        Type::Path(path) => path,
        _ => return Err(unknown(ty)),
    };
    let Some(last) = path.path.segments.last() else { return Err(unknown(ty)) };
    match last.ident.to_string().as_str() {
        "f64" | "f32" => Ok(format!("\"type\":\"number\"{}", s.enumeration())),
        "bool" => Ok("\"type\":\"boolean\"".to_string()),
        "String" => Ok(format!("\"type\":\"string\"{}", s.enumeration())),
        "Vec" => {
            let items = items(inner(&last.arguments).ok_or_else(|| unknown(ty))?, s)?;
            Ok(format!("\"type\":\"array\",\"items\":{items}"))
        }
        "Option" => optional(ty, inner(&last.arguments).ok_or_else(|| unknown(ty))?, s),
        name => {
            let (min, max) = fit::integer_limits(name).ok_or_else(|| unknown(ty))?;
            if s.min.is_empty() {
                s.min = min.to_string();
            }
            if s.max.is_empty() {
                s.max = max.to_string();
            }
            Ok(format!("\"type\":\"integer\"{}", s.enumeration()))
        }
    }
}

impl Settings {
    /// The allowed values of a schema; nothing when any value is allowed.
    fn enumeration(&self) -> String {
        if self.one_of.is_empty() { String::new() } else { format!(",\"enum\":{}", self.one_of) }
    }
}

/// `[T; N]`: a list of fixed length, where the length is a literal.
fn list(array: &TypeArray, s: &mut Settings) -> syn::Result<String> {
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

/// `Option<T>`: a value or null, which is also its default.
fn optional(ty: &Type, of: &Type, s: &mut Settings) -> syn::Result<String> {
    if is_option(of) {
        return Err(syn::Error::new_spanned(ty, "one Option is enough: JSON has one null"));
    }
    // For a list, the choice applies to its items.
    if !s.one_of.is_empty() && !is_list(of) {
        s.one_of.insert_str(s.one_of.len() - 1, ",null");
    }
    let inside = schema(of, s)?;
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

fn items(ty: &Type, s: &mut Settings) -> syn::Result<String> {
    // A default is the whole field's, also when an item may be null.
    let default = std::mem::take(&mut s.default);
    let inside = schema(ty, s)?;
    s.default = default;
    let mut limits = String::new();
    for (key, value) in [("minimum", std::mem::take(&mut s.min)), ("maximum", std::mem::take(&mut s.max))] {
        if !value.is_empty() {
            limits.push_str(&format!(",\"{key}\":{value}"));
        }
    }
    s.one_of.clear();
    Ok(format!("{{{inside}{limits}}}"))
}

fn is_option(ty: &Type) -> bool {
    matches!(ty, Type::Path(p) if p.path.segments.last().is_some_and(|s| s.ident == "Option"))
}

fn is_list(ty: &Type) -> bool {
    matches!(ty, Type::Array(_))
        || matches!(ty, Type::Path(p) if p.path.segments.last().is_some_and(|s| s.ident == "Vec"))
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
            (
                "#[config(max = 3, default = [[1, 2], [3, 4]])] x: [[f64; 2]; 2]",
                "the default 4 is above max 3",
            ),
            ("#[config(default = 300)] x: u8", "the default 300 is above max 255"),
            ("#[config(default = [-1])] x: Vec<usize>", "the default -1 is below min 0"),
            ("#[config(min = 300)] x: u8", "min 300 is above max 255"),
            (
                "#[config(one_of = [\"bm\", \"sgm\"], default = \"gm\")] x: String",
                "the default \"gm\" is not one of \"bm\", \"sgm\"",
            ),
            (
                "#[config(one_of = [\"a\"], default = [\"a\", \"b\"])] x: Vec<String>",
                "the default \"b\" is not one of",
            ),
            ("#[config(default = \"fast\")] x: f64", "this field is a f64: a number is wanted"),
            ("#[config(default = 5.5)] x: u32", "this field is a u32: a whole number is wanted"),
            ("#[config(default = 5.0)] x: i64", "this field is a i64: a whole number is wanted"),
            ("#[config(default = 99999999999999999999)] x: u64", "this field is a u64"),
            ("#[config(default = 1)] x: bool", "true or false is wanted"),
            ("#[config(default = 1)] x: Option<String>", "text in quotation marks is wanted"),
            ("#[config(default = 1.0)] x: [f64; 3]", "the default of this field is a list"),
            ("#[config(default = [1, 2])] x: [f64; 3]", "the default has 2 items, the field 3"),
            ("#[config(default = [1, true])] x: Vec<f64>", "a number is wanted"),
            ("#[config(default = None)] x: f64", "a number is wanted"),
            ("#[config(min = 1)] x: String", "min and max are for numbers, not for String: remove them"),
            ("#[config(max = 1)] x: bool", "min and max are for numbers, not for bool"),
            ("#[config(max = 1)] x: Option<Vec<String>>", "min and max are for numbers, not for String"),
            (r#"#[config(unit = "mm")] x: bool"#, "a unit is for numbers, not for bool: remove it"),
            (r#"#[config(unit = "mm")] x: Vec<String>"#, "a unit is for numbers, not for String"),
            ("#[config(one_of = \"a\")] x: String", "one_of is a list"),
            ("#[config(one_of = [])] x: String", "one_of names nothing"),
            ("#[config(one_of = [true])] x: bool", "remove one_of"),
            ("#[config(one_of = [1])] x: String", "text in quotation marks is wanted"),
            ("#[config(max = 1e999)] x: f64", "larger than any f64"),
            ("x: Option<Option<f64>>", "one Option is enough"),
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
            "#[config(default = 18446744073709551615)] x: u64",
            "#[config(default = [[1, 2], [3, 4]])] x: [[f64; 2]; 2]",
            "#[config(default = [None, 1.0])] x: Vec<Option<f64>>",
            "#[config(one_of = [\"a\"], default = None)] x: Option<String>",
        ] {
            assert_eq!(said(field), "", "{field}");
        }
    }

    #[test]
    fn what_is_left_out_is_a_value_of_the_schema() {
        let schema_and_default = |field: &str| {
            let input: DeriveInput = syn::parse_str(&format!("struct Cfg {{ {field} }}")).expect(field);
            let Data::Struct(data) = &input.data else { panic!("{field}") };
            let field = data.fields.iter().next().expect("one field");
            let mut s = settings(field).expect("settings");
            let schema = schema(&field.ty, &mut s).expect("schema");
            (schema, s.default)
        };
        let (schema, default) = schema_and_default("#[config(one_of = [\"a\"])] x: Option<String>");
        assert_eq!(
            (schema.as_str(), default.as_str()),
            ("\"type\":[\"string\",\"null\"],\"enum\":[\"a\",null]", "null")
        );
        let (schema, default) = schema_and_default("x: Vec<Option<f64>>");
        let items = "\"type\":\"array\",\"items\":{\"type\":[\"number\",\"null\"]}";
        assert_eq!((schema.as_str(), default.as_str()), (items, ""));
    }
}
