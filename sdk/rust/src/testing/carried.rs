//! The types and commands that fake peers give untyped ports, and how a slot tells them.
//!
//! Invariant: a type is told in the words of a host's slot, so a component cannot tell it from a real peer.

use super::manifest;
use crate::call::Value;
use crate::payload::Payload;
use serde_json::{Value as Json, json};
use trocar_plugin_api::abi::{Bytes, STATUS_OK, STATUS_UNSUPPORTED, Sink, Status};
use trocar_plugin_api::desc::TypeDesc;

/// The type a fake peer gives an untyped port.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Carried {
    /// As `type_of` of a host's slot writes it.
    pub(crate) text: String,
    /// Bytes of a plain value, or of a frame's header.
    pub(crate) size: usize,
    leaves: Vec<String>,
}

impl Carried {
    pub(crate) fn plain<T: Payload>() -> Carried {
        let (types, ty) = manifest::described(T::DESC);
        Carried::of::<T>(json!({ "plain": ty, "types": types }))
    }

    pub(crate) fn frames<H: Payload>() -> Carried {
        let (types, ty) = manifest::described(H::DESC);
        Carried::of::<H>(json!({ "frame": ty, "format": H::FORMAT, "max_bytes": 0, "types": types }))
    }

    fn of<T: Payload>(text: Json) -> Carried {
        Carried { text: text.to_string(), size: size_of::<T>(), leaves: manifest::leaves(T::DESC) }
    }

    /// Fails the test unless its type is the peer's.
    #[track_caller]
    pub(crate) fn expect(&self, port: &str, asked: &'static TypeDesc) {
        let used = manifest::leaves(asked);
        assert!(
            self.leaves == used,
            "`{port}` is connected to a peer with the fields {:?}, the test uses {used:?}",
            self.leaves
        );
    }
}

/// The command a fake peer gives an untyped function.
pub(crate) struct CarriedCommand {
    /// As `type_of` of a host's slot writes it.
    pub(crate) text: String,
    pub(crate) arg_size: usize,
    pub(crate) ret_size: usize,
    /// Argument and result, as their field lists.
    pub(crate) leaves: [Vec<String>; 2],
}

impl CarriedCommand {
    pub(crate) fn of<A: Value, R: Value>(name: &str) -> CarriedCommand {
        let mut types: Vec<Json> = Vec::new();
        let mut one = |ty: Option<&'static TypeDesc>| {
            let (named, ty) = manifest::described(ty?);
            types.extend(named.iter().map(|named| json!(named)));
            Some(json!(ty))
        };
        let (arg, ret) = (one(A::DESC), one(R::DESC));
        let kind = match (&arg, &ret) {
            (None, None) => "void",
            (Some(_), None) => "write",
            (None, Some(_)) => "void_return",
            (Some(_), Some(_)) => "write_return",
        };
        let arg = arg.map(|ty| json!({ "name": "value", "type": ty }));
        let text = json!({ "name": name, "kind": kind, "arg": arg, "ret": ret, "types": types });
        CarriedCommand {
            text: text.to_string(),
            arg_size: size_of::<A>(),
            ret_size: size_of::<R>(),
            leaves: [A::DESC, R::DESC].map(leaves),
        }
    }
}

/// The field list of an argument or result; empty without one.
pub(crate) fn leaves(ty: Option<&'static TypeDesc>) -> Vec<String> {
    ty.map(manifest::leaves).unwrap_or_default()
}

/// Answers `type_of` of a slot.
///
/// # Safety
/// `sink` is null or valid for the call.
pub(crate) unsafe fn tell(text: Option<&str>, sink: *const Sink) -> Status {
    // SAFETY: by the caller's promise.
    let (Some(text), Some(sink)) = (text, unsafe { sink.as_ref() }) else { return STATUS_UNSUPPORTED };
    // SAFETY: the text lives through the call.
    unsafe { (sink.write)(sink.ctx, Bytes { ptr: text.as_ptr(), len: text.len() }) };
    STATUS_OK
}
