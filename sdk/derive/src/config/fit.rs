//! Limits, choice and default that a configuration field may have.
//!
//! Invariant: a value that passes here fits the field's schema, so no host refuses the class for its own
//! defaults.

use super::{Settings, inner};
use crate::attrs;
use syn::{Expr, ExprLit, Field, Lit, Type};

/// Refuses limits that no value lies within, and a default outside of them: nobody could configure such a
/// class.
pub(super) fn possible(field: &Field, s: &Settings) -> syn::Result<()> {
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
    let Some(choice) = s.choice.as_ref().filter(|_| !is_none(given)) else { return Ok(()) };
    let allowed = items_of(choice).into_iter().map(attrs::json).collect::<syn::Result<Vec<_>>>()?;
    for item in items_of(given) {
        let default = attrs::json(item)?;
        let same = |one: &String| match (one.parse::<f64>(), default.parse::<f64>()) {
            (Ok(a), Ok(b)) => a == b,
            _ => *one == default,
        };
        if !allowed.iter().any(same) {
            let why = format!("the default {default} is not one of {}", allowed.join(", "));
            return Err(syn::Error::new_spanned(item, why));
        }
    }
    Ok(())
}

/// Refuses limits and choices that the field's type has no use for, and values of another type than the
/// field's.
pub(super) fn kinds(field: &Field, s: &Settings) -> syn::Result<()> {
    let Some(leaf) = leaf(&field.ty) else { return Ok(()) };
    let number = !matches!(leaf.as_str(), "bool" | "String");
    if !(number || s.min.is_empty() && s.max.is_empty()) {
        let why = format!("min and max are for numbers, not for {leaf}: remove them, or take a number");
        return Err(syn::Error::new_spanned(field, why));
    }
    if !(number || s.unit.is_empty()) {
        let why = format!("a unit is for numbers, not for {leaf}: remove it, or take a number");
        return Err(syn::Error::new_spanned(field, why));
    }
    if let Some(choice) = &s.choice {
        let Expr::Array(items) = choice else {
            return Err(syn::Error::new_spanned(choice, "one_of is a list, such as one_of = [\"a\", \"b\"]"));
        };
        if leaf == "bool" || items.elems.is_empty() {
            let why = if leaf == "bool" { "a bool has no choice but itself" } else { "one_of names nothing" };
            return Err(syn::Error::new_spanned(choice, format!("{why}: remove one_of")));
        }
        items.elems.iter().try_for_each(|item| value_fits(item, &leaf))?;
    }
    s.given.as_ref().map_or(Ok(()), |given| default_fits(given, &field.ty, &leaf))
}

/// The written default is a value of the type.
fn default_fits(given: &Expr, ty: &Type, leaf: &str) -> syn::Result<()> {
    let wrong = |why: String| Err(syn::Error::new_spanned(given, why));
    let (item, wanted) = match ty {
        Type::Array(array) => {
            let Expr::Array(items) = given else {
                return wrong("the default of this field is a list".into());
            };
            let n = match &array.len {
                Expr::Lit(n) => attrs::number(&Expr::Lit(n.clone()))?.parse::<usize>().ok(),
                _ => None,
            };
            match n.filter(|n| *n != items.elems.len()) {
                Some(n) => {
                    return wrong(format!("the default has {} items, the field {n}", items.elems.len()));
                }
                None => (&*array.elem, items),
            }
        }
        Type::Path(path) => {
            let Some(last) = path.path.segments.last() else { return Ok(()) };
            let inside = inner(&last.arguments);
            match (last.ident.to_string().as_str(), inside, given) {
                ("Option", Some(_), none) if is_none(none) => return Ok(()),
                ("Option", Some(inside), _) => return default_fits(given, inside, leaf),
                ("Vec", Some(inside), Expr::Array(items)) => (inside, items),
                ("Vec", ..) => return wrong("the default of this field is a list".into()),
                _ => return value_fits(given, leaf),
            }
        }
        _ => return Ok(()),
    };
    wanted.elems.iter().try_for_each(|one| default_fits(one, item, leaf))
}

/// A literal that the type `leaf` can hold; its limits are looked at elsewhere.
fn value_fits(given: &Expr, leaf: &str) -> syn::Result<()> {
    let lit = match given {
        Expr::Lit(ExprLit { lit, .. }) => Some(lit),
        _ => None,
    };
    let number = attrs::number(given).ok();
    let (fits, wanted) = match leaf {
        "bool" => (matches!(lit, Some(Lit::Bool(_))), "true or false"),
        "String" => (matches!(lit, Some(Lit::Str(_))), "text in quotation marks"),
        "f64" | "f32" => (number.is_some(), "a number"),
        // The largest numbers do not survive a float, so they are compared as integers.
        "u64" | "usize" => (number.is_some_and(|n| n.starts_with('-') || n.parse::<u64>().is_ok()), "a u64"),
        _ => (number.is_some_and(|n| n.parse::<i64>().is_ok()), "a whole number"),
    };
    if fits {
        return Ok(());
    }
    Err(syn::Error::new_spanned(given, format!("this field is a {leaf}: {wanted} is wanted")))
}

fn is_none(expr: &Expr) -> bool {
    matches!(expr, Expr::Path(path) if path.path.is_ident("None"))
}

/// The innermost items of a written list; anything else is one item.
fn items_of(expr: &Expr) -> Vec<&Expr> {
    match expr {
        Expr::Array(items) => items.elems.iter().flat_map(items_of).collect(),
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

/// JSON text of the smallest and largest value; 64-bit types are limited by JSON itself, except below by
/// zero.
pub(super) fn integer_limits(name: &str) -> Option<(&'static str, &'static str)> {
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
