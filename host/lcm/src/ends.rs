//! The ends of a connection, as carriers are given them and as they join them.

use std::sync::{Arc, Weak};

use tokio::sync::oneshot;
use trocar_lcm_api::LinkDetail;
use trocar_model::{Binding, ComponentId};

use super::boundary::OwnClass;
use super::described::PortSet;
use super::executor::Executor;
use super::inbox::{From, Party};
use super::instance::Instance;

/// A component of this process and its thread.
#[derive(Clone)]
pub(super) struct Here {
    pub(super) instance: Arc<Instance>,
    pub(super) executor: Arc<Executor>,
    /// The component at the other end, if that is in this process, too.
    pub(super) other: Option<Weak<Instance>>,
}

impl Here {
    pub(super) fn new(instance: Arc<Instance>, executor: Arc<Executor>) -> Here {
        Here { instance, executor, other: None }
    }

    /// Source of the entries in a queue of this end.
    pub(super) fn from(&self, other: &ComponentId) -> From {
        match &self.other {
            Some(other) => From::Component(other.clone() as Weak<dyn Party>),
            None => From::Remote(other.clone()),
        }
    }
}

/// The end of the connection that is here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Client,
    Server,
}

/// Is told once the result of the first try to link; on failure the reason.
pub(super) type Tell = oneshot::Sender<Result<(), String>>;

/// Looks for the class of a connection's server in this process.
pub(super) type SameClass = Box<dyn Fn() -> Option<OwnClass> + Send + Sync>;

/// Two ends of this process as a carrier has joined them.
pub(super) trait Joined: Send + Sync {
    /// Cuts the connection; waiting callers are answered.
    fn cut(&self);

    /// Tells whether this binding of these ports, the client's and the server's, would join it in just the
    /// same way.
    fn still_fits(&self, binding: &Binding, ports: (&PortSet, &PortSet)) -> bool;

    fn is_stream(&self) -> bool;

    /// The carrier's name and figures so far.
    fn detail(&self) -> LinkDetail;
}
