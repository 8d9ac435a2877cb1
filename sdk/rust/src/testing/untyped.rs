//! Fake peers of untyped ports: each has a type, which the component learns while running.
//!
//! Invariant: without a peer's type an untyped port is unconnected, as with a host; a sample of another type
//! is another peer.

use super::bench::Bench;
use super::carried::{Carried, CarriedCommand, leaves};
use super::shape::{Member, Of};
use crate::call::Value;
use crate::class::Class;
use crate::payload::Payload;
use trocar_plugin_api::desc::TypeDesc;
use trocar_plugin_api::manifest::PortType;

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
