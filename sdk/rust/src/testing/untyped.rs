//! Fake peers of untyped ports: each has a type, which the component learns while running.
//!
//! Invariant: without a peer's type an untyped port is unconnected, as with a host; a sample of another type
//! is another peer.

use super::bench::Bench;
use super::manifest;
use super::shape::{Member, Of};
use crate::call::Value;
use crate::component::Class;
use crate::payload::Payload;
use serde_json::{Value as Json, json};
use trocar_plugin_api::abi::{Bytes, STATUS_OK, STATUS_UNSUPPORTED, Sink, Status};
use trocar_plugin_api::desc::TypeDesc;
use trocar_plugin_api::manifest::PortType;

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
    leaves: [Vec<String>; 2],
}

impl CarriedCommand {
    fn of<A: Value, R: Value>(name: &str) -> CarriedCommand {
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

fn leaves(ty: Option<&'static TypeDesc>) -> Vec<String> {
    ty.map(manifest::leaves).unwrap_or_default()
}

impl<C: Class> Bench<C> {
    /// Connects an untyped input or output to a fake peer of plain `T`. `push` does so by itself.
    #[track_caller]
    pub fn connect_as<T: Payload>(&mut self, port: &str) {
        self.carry(port, Carried::plain::<T>());
    }

    /// Connects an untyped input or output to a fake peer of frames with the header `H`. `push_frame` does so
    /// by itself.
    #[track_caller]
    pub fn connect_as_frames<H: Payload>(&mut self, port: &str) {
        self.carry(port, Carried::frames::<H>());
    }

    /// Connects an untyped function to a fake command that takes `A` and gives `R` and has the name of the
    /// function. `answer` does so by itself.
    #[track_caller]
    pub fn connect_as_command<A: Value, R: Value>(&mut self, function: &str) {
        let m = self.shape.member(Of::Functions, function);
        assert!(m.any, "function `{function}` has a type of its own");
        let name = m.path.rsplit('/').next().unwrap_or_default();
        self.functions[m.id].get().carry(CarriedCommand::of::<A, R>(name));
    }

    #[track_caller]
    fn carry(&mut self, port: &str, carried: Carried) {
        let class = self.shape.class();
        let untyped = |ty: &PortType| {
            assert!(matches!(ty, PortType::Any(_)), "`{port}` has a type of its own");
        };
        if let Some(at) = class.outputs.iter().position(|o| o.name == port) {
            untyped(&class.outputs[at].ty);
            return self.outputs[at].get().carry(carried);
        }
        let at = self.shape.input(port);
        untyped(&class.inputs[at].ty);
        self.inputs[at].get().carry(carried);
    }

    /// Fails the test unless its types are the function's, or those of the peer of an untyped one.
    #[track_caller]
    pub(crate) fn expect_function(
        &mut self,
        m: &Member,
        arg: Option<&'static TypeDesc>,
        ret: Option<Option<&'static TypeDesc>>,
    ) {
        if !m.any {
            self.shape.expect_type("function", &m.path, m.arg.as_ref(), arg);
            if let Some(ret) = ret {
                self.shape.expect_type("result of function", &m.path, m.ret.as_ref(), ret);
            }
            return;
        }
        let Some(command) = self.functions[m.id].get().command() else {
            panic!("function `{}` is untyped: say what it is connected to with `connect_as_command`", m.path)
        };
        let used = leaves(arg);
        assert!(
            command.leaves[0] == used && ret.is_none_or(|ret| command.leaves[1] == leaves(ret)),
            "function `{}` is connected to a command that takes {:?} and gives {:?}; the test uses {used:?}",
            m.path,
            command.leaves[0],
            command.leaves[1],
        );
    }
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
