//! The derives of trocar-sdk: they turn a struct and its `impl` blocks into a component class.
//!
//! Invariant: generated code names everything by absolute path (`::trocar_sdk::…`), needs no import of the
//! author's, and every mistake is a compile error that points at the author's own tokens.
#![forbid(unsafe_code)]

mod attrs;
mod class;
mod component;
mod config;
mod failed;
mod fields;
mod handles;
mod interfaces;
mod many;
mod methods;
mod payload;
mod provides;
#[cfg(test)]
mod refused;

use proc_macro::TokenStream;
use syn::{DeriveInput, ItemImpl, parse_macro_input};

/// Makes a `#[repr(C)]` struct a payload: plain old data without padding, described field by field.
///
/// Field attributes: `#[unit("N")]`, `#[frame("retina")]` (coordinate frame). Struct attribute:
/// `#[format("image")]` for headers of frames.
#[proc_macro_derive(Payload, attributes(unit, frame, format))]
pub fn derive_payload(input: TokenStream) -> TokenStream {
    let input: DeriveInput = parse_macro_input!(input);
    done(payload::derive(input.clone()), || failed::payload(&input))
}

/// Makes a struct the configuration of a component.
///
/// Field attribute:
/// `#[config(live, min = 0.1, max = 400.0, unit = "Hz", default = 50.0, one_of = ["a", "b"])]`.
#[proc_macro_derive(Config, attributes(config))]
pub fn derive_config(input: TokenStream) -> TokenStream {
    let input: DeriveInput = parse_macro_input!(input);
    done(config::derive(input.clone()), || failed::config(&input))
}

/// Makes a struct a component class.
///
/// Struct attribute: `#[component(name = "…", rate_hz = 1000, max_step_ms = 50, model = "…",
/// models("…", "…"), rates_hz(100, 8000), safety = "…", hardware, safe_from_any_thread, starts_programs,
/// provides("a", "b"), requires("c"), optional("c"))]`; `models` and `rates_hz` name the executions the class
/// is made for, and everything else is refused; a class that `starts_programs` is created only where the
/// process allows it.
///
/// Field attributes: `#[input]`, `#[output]`, `#[required]`, `#[event("interface")]`, `#[state]`,
/// `#[config]`, `#[host]`, `#[names]`; a field without one is private run-time state and needs `Default`.
/// Beside a port's attribute, `#[frame("retina")]` names the coordinate frame of its payload.
#[proc_macro_derive(
    Component,
    attributes(component, input, output, required, event, state, config, host, names, unit, frame)
)]
pub fn derive_component(input: TokenStream) -> TokenStream {
    let input: DeriveInput = parse_macro_input!(input);
    done(component::derive(input.clone()), || failed::component(&input))
}

/// The commands of one provided interface: `#[provides("ctl")] impl LowPass { #[command] … #[read] … }`.
/// `#[frame("retina")]` on a method is the coordinate frame of its result, on a parameter that of the
/// argument.
#[proc_macro_attribute]
pub fn provides(args: TokenStream, item: TokenStream) -> TokenStream {
    let item: ItemImpl = parse_macro_input!(item);
    done(syn::parse(args).and_then(|args| provides::expand(args, item.clone())), || {
        failed::methods(item.clone())
    })
}

/// The event handlers of one required interface: `#[handles("robot")] impl Guide { #[on] fn … }`.
#[proc_macro_attribute]
pub fn handles(args: TokenStream, item: TokenStream) -> TokenStream {
    let item: ItemImpl = parse_macro_input!(item);
    done(syn::parse(args).and_then(|args| handles::expand(args, item.clone())), || {
        failed::methods(item.clone())
    })
}

/// Returns the generated code, or the message of the mistake and its substitute.
fn done(
    result: syn::Result<proc_macro2::TokenStream>,
    instead: impl Fn() -> proc_macro2::TokenStream,
) -> TokenStream {
    let failed = |e: syn::Error| {
        let mut tokens = e.to_compile_error();
        tokens.extend(instead());
        tokens
    };
    result.unwrap_or_else(failed).into()
}
