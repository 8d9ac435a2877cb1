//! The `#[component(…)]` attribute: a class's facts about itself.
//!
//! Invariant: every default of the class (period, model) is decided here, once.

use crate::attrs;
use proc_macro2::Span;
use syn::ext::IdentExt;
use syn::meta::ParseNestedMeta;
use syn::parse::Parse;
use syn::spanned::Spanned;
use syn::{DeriveInput, Expr, LitStr};
use trocar_plugin_api::limits::{MAX_STEP_NS, MODELS_WITH_RATE, PERIOD_NS};

const MODELS: [&str; 6] = ["periodic", "continuous", "on_signal", "on_callback", "stream", "none"];
/// Models that need another component, too: no class has them by default.
const INSIDE: [&str; 2] = ["exec_in", "exec_out"];

#[derive(Default)]
pub(crate) struct ClassAttr {
    pub(crate) name: String,
    pub(crate) doc: String,
    pub(crate) model: String,
    pub(crate) period_ns: u64,
    /// Position of the rate in the source; none when the class says no rate.
    rate: Option<Span>,
    pub(crate) max_step_ns: u64,
    /// Models it is made for; empty = any.
    pub(crate) models: Vec<String>,
    /// Shortest and longest period it is made for, ns; 0 = no limit.
    pub(crate) periods_ns: [u64; 2],
    /// Variant of `desc::Safety`.
    pub(crate) safety: &'static str,
    pub(crate) hardware: bool,
    /// Position of this word in the source; none when the class does not say it.
    pub(crate) safe_from_any_thread: Option<Span>,
    pub(crate) starts_programs: bool,
    pub(crate) provides: Vec<(String, Span)>,
    pub(crate) requires: Vec<(String, Span)>,
    pub(crate) optional: Vec<(String, Span)>,
}

impl ClassAttr {
    pub(crate) fn of(input: &DeriveInput) -> syn::Result<ClassAttr> {
        let mut class = ClassAttr { doc: attrs::docs(&input.attrs), safety: "None", ..ClassAttr::default() };
        for attr in input.attrs.iter().filter(|a| a.path().is_ident("component")) {
            attr.parse_nested_meta(|meta| class.setting(meta))?;
        }
        if class.model.is_empty() {
            class.model = if class.period_ns > 0 { "periodic" } else { "on_signal" }.to_string();
        }
        if class.name.is_empty() {
            class.name = attrs::snake(&input.ident.unraw().to_string());
            attrs::check_name(&class.name, input.ident.span()).map_err(|e| {
                let why = format!("{e}; or give the class one, #[component(name = \"…\")]");
                syn::Error::new(input.ident.span(), why)
            })?;
        }
        let model = &class.model;
        if let Some(rate) = class.rate.filter(|_| !MODELS_WITH_RATE.contains(&model.as_str())) {
            let (has, with) = (model.as_str(), MODELS_WITH_RATE.join(" or "));
            let why = match has {
                "continuous" => "it steps again at once",
                "on_signal" => "it steps when something arrives",
                "on_callback" => "its device says when it runs",
                _ => "it has no thread of its own",
            };
            return Err(syn::Error::new(
                rate,
                format!("a rate means nothing to model {has}, {why}: remove rate_hz, or say model {with}"),
            ));
        }
        if model == "periodic" && class.period_ns == 0 {
            return Err(syn::Error::new_spanned(
                &input.ident,
                "a periodic class needs its rate: #[component(rate_hz = 1000)]",
            ));
        }
        class.fits(&input.ident)?;
        Ok(class)
    }

    /// The default execution is one the class is made for.
    fn fits(&self, class: &syn::Ident) -> syn::Result<()> {
        if !self.models.is_empty() && !self.models.contains(&self.model) {
            let (model, models) = (&self.model, self.models.join(", "));
            let why =
                format!("its own model, {model}, is not among its models, {models}: name it there, too");
            return Err(syn::Error::new_spanned(class, why));
        }
        let [least, most] = self.periods_ns;
        if self.period_ns > 0 && most > 0 && !(least..=most).contains(&self.period_ns) {
            let hz = |ns: u64| 1e9 / ns as f64;
            let why = format!(
                "its own rate, {} Hz, is not within rates_hz, {} to {} Hz",
                hz(self.period_ns),
                hz(most),
                hz(least)
            );
            return Err(syn::Error::new_spanned(class, why));
        }
        Ok(())
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
                self.period_ns = period(&meta)?;
                self.rate = Some(meta.path.span());
            }
            "max_step_ms" => self.max_step_ns = max_step(&meta)?,
            "model" => self.model = model(&meta)?,
            "models" => self.models.extend(models(&meta)?),
            "rates_hz" => self.periods_ns = rates(&meta)?,
            "safety" => self.safety = safety(&meta)?,
            "hardware" => self.hardware = true,
            "safe_from_any_thread" => self.safe_from_any_thread = Some(meta.path.span()),
            "starts_programs" => self.starts_programs = true,
            "provides" => names(&meta, &mut self.provides)?,
            "requires" => names(&meta, &mut self.requires)?,
            "optional" => names(&meta, &mut self.optional)?,
            _ => {
                return Err(meta.error(
                    "unknown setting; there are name, rate_hz, max_step_ms, model, models(\"…\"), rates_hz(lowest, highest), safety, \
                     hardware, safe_from_any_thread, starts_programs, provides(\"…\"), requires(\"…\") and optional(\"…\")",
                ));
            }
        }
        Ok(())
    }
}

/// `rate_hz = …` as a period, ns.
fn period(meta: &ParseNestedMeta<'_>) -> syn::Result<u64> {
    let expr = meta.value()?.parse::<Expr>()?;
    let rate: f64 = attrs::number(&expr)?.parse().unwrap_or(0.0);
    let period_ns = (1e9 / rate).round();
    if !(PERIOD_NS.0 as f64..=PERIOD_NS.1 as f64).contains(&period_ns) {
        return Err(syn::Error::new_spanned(
            expr,
            "rate_hz is at most 1e6 Hz (a period of 1 µs) and at least 1/3600 Hz (a period of 1 h)",
        ));
    }
    Ok(period_ns as u64)
}

/// `max_step_ms = …`, ns.
fn max_step(meta: &ParseNestedMeta<'_>) -> syn::Result<u64> {
    let expr = meta.value()?.parse::<Expr>()?;
    let ms: f64 = attrs::number(&expr)?.parse().unwrap_or(0.0);
    let ns = (1e6 * ms).ceil();
    if !(MAX_STEP_NS.0 as f64..=MAX_STEP_NS.1 as f64).contains(&ns) {
        return Err(syn::Error::new_spanned(
            expr,
            "max_step_ms is at least 0.1 ms and at most 3.6e6 ms (1 h)",
        ));
    }
    Ok(ns as u64)
}

/// `model = "…"`.
fn model(meta: &ParseNestedMeta<'_>) -> syn::Result<String> {
    let model = meta.value()?.parse::<LitStr>()?;
    if !MODELS.contains(&model.value().as_str()) {
        return Err(syn::Error::new(
            model.span(),
            format!("unknown execution model; there are {}", MODELS.join(", ")),
        ));
    }
    Ok(model.value())
}

/// `models("…", "…")`, also those that need another component.
fn models(meta: &ParseNestedMeta<'_>) -> syn::Result<Vec<String>> {
    let mut named = Vec::new();
    names(meta, &mut named)?;
    let mut models = Vec::new();
    for (model, span) in named {
        if !MODELS.iter().chain(&INSIDE).any(|known| *known == model) {
            let known = [MODELS.as_slice(), &INSIDE].concat().join(", ");
            return Err(syn::Error::new(span, format!("unknown execution model; there are {known}")));
        }
        models.push(model);
    }
    Ok(models)
}

/// `safety = "…"` as the variant of `desc::Safety`.
fn safety(meta: &ParseNestedMeta<'_>) -> syn::Result<&'static str> {
    let safety = meta.value()?.parse::<LitStr>()?;
    match safety.value().as_str() {
        "actuator" => Ok("Actuator"),
        "sensor" => Ok("Sensor"),
        "none" => Ok("None"),
        _ => Err(syn::Error::new(safety.span(), "safety is actuator, sensor or none")),
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

/// `rates_hz(lowest, highest)` as the shortest and longest period, ns.
fn rates(meta: &ParseNestedMeta<'_>) -> syn::Result<[u64; 2]> {
    let inside;
    let paren = syn::parenthesized!(inside in meta.input);
    let mut rates = Vec::new();
    for expr in inside.parse_terminated(Expr::parse, syn::Token![,])? {
        rates.push(attrs::number(&expr)?.parse().unwrap_or(0.0));
    }
    let wrong = |why: &str| Err(syn::Error::new(paren.span.join(), why));
    let [lowest, highest] = rates[..] else {
        return wrong("rates_hz has two numbers: the lowest and the highest rate in Hz");
    };
    let ns = |hz: f64| (1e9 / hz).round();
    let within = |hz: f64| (PERIOD_NS.0 as f64..=PERIOD_NS.1 as f64).contains(&ns(hz));
    if !within(lowest) || !within(highest) || lowest > highest {
        return wrong("rates_hz(lowest, highest): from 1/3600 Hz to 1e6 Hz, the lower one first");
    }
    Ok([ns(highest) as u64, ns(lowest) as u64])
}
