//! SDK for authors of trocar components: derives, ports, payloads, and a bench to test a component without a
//! host.
//!
//! Invariant: all `unsafe` that a plugin needs is in this crate; a plugin crate can say
//! `#![forbid(unsafe_code)]`. The whole way from an idea to a running component is `docs/PLUGIN_GUIDE.md`;
//! `docs/PLUGIN_REFERENCE.md` has what a component can have.

#![deny(missing_docs)]

// Makes the derives' `::trocar_sdk` mean this crate here, too.
extern crate self as trocar_sdk;

mod aligned;
mod any;
mod binder;
mod call;
mod class;
mod component;
mod config;
pub mod crtk;
pub mod data;
mod describe;
mod dynamic;
mod error;
mod export;
mod flow;
mod forward;
mod frames;
mod function;
#[cfg(feature = "nalgebra")]
mod geometry;
mod guard;
mod host;
mod interfaces;
mod lease;
mod lists;
mod many;
mod names;
mod outcome;
mod parallel;
mod payload;
mod ports;
mod safe;
mod services;
mod shims;
mod stubs;
pub mod testing;
mod values;

pub use any::{Any, AnyFunction, AnyIn, AnyOut, AnyView, HeldFrame};
pub use call::{Answer, Value};
pub use class::Class;
pub use component::{Component, Tick};
pub use config::{Config, ConfigField};
pub use dynamic::{AnyCommand, AnyField, AnyPart, AnyShape, AnyType, Place};
pub use error::{Error, Result};
pub use frames::{Frame, FrameLoan, FrameView};
pub use function::{Event, Function};
#[cfg(feature = "nalgebra")]
pub use geometry::{CARRIED_S, Carried, GeometryError, UNIT_TOLERANCE};
pub use host::Host;
pub use log;
pub use many::Many;
pub use names::Names;
pub use outcome::{CallError, NoFrame, Outcome};
pub use payload::{Payload, as_bytes, from_bytes};
pub use ports::{In, Out, Sample};
pub use safe::{MakeSafe, SafeFromAnyThread};
pub use serde_json;
pub use services::{ServiceReply, Services};
pub use trocar_plugin_api::abi::StaticPlugin;
pub use trocar_plugin_api::environment;
pub use trocar_plugin_api::rate::RateLimit;
pub use trocar_sdk_derive::{Component, Config, Payload, handles, provides};
pub use values::{Flag, List, Stamp, Text};

/// Everything a plugin's source usually names.
pub mod prelude {
    pub use crate::{
        AnyFunction, AnyIn, AnyOut, Class, Component, Config, Event, Flag, Frame, FrameView, Function, Host,
        In, List, MakeSafe, Many, Names, NoFrame, Out, Outcome, Payload, Place, Result, SafeFromAnyThread,
        Sample, ServiceReply, Stamp, Text, Tick, handles, log, named_values, provides, trocar_plugin,
    };
    pub use serde_json::json;
}

/// Items that generated code refers to. Not for authors; changes without notice.
#[doc(hidden)]
pub mod __private {
    pub use crate::binder::Binder;
    pub use crate::call::{Answer, Call, kind_of};
    pub use crate::config::{
        JsonObject, field as config_field, known as config_known, unset as config_unset,
    };
    pub use crate::describe::check as check_lists;
    pub use crate::export::{BUILT_WITH, manifest_text, plugin_name};
    pub use crate::flow::{frame_fits, limits_fit, payload_of, port_type, unit_fits};
    pub use crate::function::{EventPort, FunctionPort};
    pub use crate::interfaces::{DeclaresProvided, DeclaresRequired, HandlesPart, ProvidedPart, has_reads};
    pub use crate::lists::{Layout, Lists, names as names_of};
    pub use crate::shims::{Export, init, text};
    pub use crate::stubs::Shared;
    pub use trocar_plugin_api::abi::{ClassTable, PluginTable, Status};
    pub use trocar_plugin_api::desc::*;
    #[cfg(feature = "layout")]
    pub use trocar_plugin_api::export_layout;
    pub use trocar_plugin_api::limits::{check_class, check_plugin};
    pub use trocar_plugin_api::note::Note;
    pub use trocar_plugin_api::{ABI_MAJOR, ABI_MINOR, render, render_description};

    /// The primitive of an integer, for named values.
    pub const fn prim_of<T: crate::Payload>() -> Prim {
        match &T::DESC.kind {
            TypeKind::Prim(p) => *p,
            _ => panic!("named values stand on an integer"),
        }
    }

    /// `a`, or `b` when it is empty.
    pub const fn first_text(a: &'static str, b: &'static str) -> &'static str {
        if a.is_empty() { b } else { a }
    }

    pub const fn align_up(at: usize, align: usize) -> usize {
        at.next_multiple_of(align)
    }

    pub const fn max(a: usize, b: usize) -> usize {
        if a > b { a } else { b }
    }
}
