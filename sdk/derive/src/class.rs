//! The `#[component(…)]` attribute: what a class says about itself.
//!
//! Invariant: every default of the class (period, model) is decided here, once.

use crate::attrs;
use proc_macro2::Span;
use syn::meta::ParseNestedMeta;
use syn::spanned::Spanned;
use syn::{DeriveInput, Expr, LitStr};

const MODELS: [&str; 6] = ["periodic", "continuous", "on_signal", "on_callback", "stream", "none"];

#[derive(Default)]
pub(crate) struct ClassAttr {
    pub(crate) name: String,
    pub(crate) doc: String,
    pub(crate) model: String,
    pub(crate) period_ns: u64,
    pub(crate) max_step_ns: u64,
    /// Variant of `desc::Safety`.
    pub(crate) safety: &'static str,
    pub(crate) hardware: bool,
    /// Where the class says so.
    pub(crate) safe_from_any_thread: Option<Span>,
    pub(crate) provides: Vec<(String, Span)>,
    pub(crate) requires: Vec<(String, Span)>,
    pub(crate) optional: Vec<(String, Span)>,
}

impl ClassAttr {
    pub(crate) fn of(input: &DeriveInput) -> syn::Result<ClassAttr> {
        let mut class = ClassAttr {
            name: attrs::snake(&input.ident.to_string()),
            doc: attrs::docs(&input.attrs),
            safety: "None",
            ..ClassAttr::default()
        };
        for attr in input.attrs.iter().filter(|a| a.path().is_ident("component")) {
            attr.parse_nested_meta(|meta| class.setting(meta))?;
        }
        if class.model.is_empty() {
            class.model = if class.period_ns > 0 { "periodic" } else { "on_signal" }.to_string();
        }
        if class.model == "periodic" && class.period_ns == 0 {
            return Err(syn::Error::new_spanned(
                &input.ident,
                "a periodic class needs its rate: #[component(rate_hz = 1000)]",
            ));
        }
        Ok(class)
    }

    fn setting(&mut self, meta: ParseNestedMeta<'_>) -> syn::Result<()> {
        let key = meta.path.get_ident().map(ToString::to_string).unwrap_or_default();
        match key.as_str() {
            "name" => {
                let name = meta.value()?.parse::<LitStr>()?;
                attrs::check_name(&name.value(), name.span())?;
                self.name = name.value();
            }
            "rate_hz" => {
                let expr = meta.value()?.parse::<Expr>()?;
                let rate: f64 = attrs::number(&expr)?.parse().unwrap_or(0.0);
                if !(rate > 0.0 && rate <= 1e9) {
                    return Err(syn::Error::new_spanned(expr, "rate_hz is above 0 Hz and at most 1e9 Hz"));
                }
                self.period_ns = (1e9 / rate).round() as u64;
            }
            "max_step_ms" => {
                let expr = meta.value()?.parse::<Expr>()?;
                let ms: f64 = attrs::number(&expr)?.parse().unwrap_or(0.0);
                if !(ms > 0.0 && ms <= 3.6e6) {
                    return Err(syn::Error::new_spanned(
                        expr,
                        "max_step_ms is above 0 ms and at most 3.6e6 ms",
                    ));
                }
                self.max_step_ns = (1e6 * ms).ceil() as u64;
            }
            "model" => {
                let model = meta.value()?.parse::<LitStr>()?;
                if !MODELS.contains(&model.value().as_str()) {
                    return Err(syn::Error::new(
                        model.span(),
                        format!("unknown execution model; there are {}", MODELS.join(", ")),
                    ));
                }
                self.model = model.value();
            }
            "safety" => {
                let safety = meta.value()?.parse::<LitStr>()?;
                self.safety = match safety.value().as_str() {
                    "actuator" => "Actuator",
                    "sensor" => "Sensor",
                    "none" => "None",
                    _ => {
                        return Err(syn::Error::new(safety.span(), "safety is actuator, sensor or none"));
                    }
                };
            }
            "hardware" => self.hardware = true,
            "safe_from_any_thread" => self.safe_from_any_thread = Some(meta.path.span()),
            "provides" => names(&meta, &mut self.provides)?,
            "requires" => names(&meta, &mut self.requires)?,
            "optional" => names(&meta, &mut self.optional)?,
            _ => {
                return Err(meta.error(
                    "unknown setting; there are name, rate_hz, max_step_ms, model, safety, hardware, safe_from_any_thread, \
                     provides(\"…\"), requires(\"…\") and optional(\"…\")",
                ));
            }
        }
        Ok(())
    }
}

fn names(meta: &ParseNestedMeta<'_>, into: &mut Vec<(String, Span)>) -> syn::Result<()> {
    let inside;
    syn::parenthesized!(inside in meta.input);
    for name in inside.parse_terminated(|i| i.parse::<LitStr>(), syn::Token![,])? {
        attrs::check_pattern(&name.value(), name.span())?;
        into.push((name.value(), name.span()));
    }
    Ok(())
}
