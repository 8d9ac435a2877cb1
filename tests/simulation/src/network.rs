//! Lines between processes and managers: each carries the messages of a side in their order, late, or never.
//!
//! Invariant: a line that is cut says so at once to both ends; one whose network is down says nothing, each
//! direction for itself.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tokio_stream::{Stream, StreamExt};
use tonic::Status;
use trocar::control::{AttachEdge, Inbound, Line, Refused, Way};
use trocar::gcm::Gcm;
use trocar_model::Name;
use trocar_proto::v1;

use crate::chance::Chance;
use crate::truth::{Kind, Truth};

/// Messages under way at once, in one direction.
const UNDER_WAY: usize = 256;

/// The network of a run.
#[derive(Clone)]
pub(crate) struct Network {
    lines: Arc<Mutex<Lines>>,
    chance: Chance,
    truth: Truth,
}

#[derive(Default)]
struct Lines {
    port: Option<Port>,
    /// No message takes long.
    is_calm: bool,
    /// Directions in which messages are held up.
    down: BTreeMap<(Name, Towards), watch::Sender<bool>>,
}

/// Direction of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Towards {
    Manager,
    Process,
}

/// The open port of a manager.
#[derive(Clone)]
struct Port {
    edge: Arc<AttachEdge>,
    /// Closed when the manager ends.
    open: watch::Receiver<()>,
}

impl Network {
    pub(crate) fn new(chance: Chance, truth: Truth) -> Network {
        Network { lines: Arc::default(), chance, truth }
    }

    /// Opens the port of a manager; it is closed, and all its lines cut, when the returned end is dropped.
    pub(crate) fn open(&self, gcm: &Gcm) -> watch::Sender<()> {
        let (close, open) = watch::channel(());
        let edge = Arc::new(AttachEdge::new(gcm.clone(), open.clone()));
        self.lines.lock().port = Some(Port { edge, open });
        close
    }

    pub(crate) fn closed(&self) {
        self.lines.lock().port = None;
    }

    /// Lets no message take long, or some.
    pub(crate) fn calm(&self, is_calm: bool) {
        self.lines.lock().is_calm = is_calm;
    }

    /// Holds the messages of a process up, or lets them go on.
    pub(crate) fn down(&self, process: &Name, towards: &[Towards], is_down: bool) {
        self.truth.event(Kind::Network, || format!("{process}: down {is_down}, towards {towards:?}"));
        towards.iter().for_each(|towards| {
            self.is_down(process, *towards, |down| _ = down.send_replace(is_down));
        });
    }

    fn is_down<R>(
        &self,
        process: &Name,
        towards: Towards,
        look: impl FnOnce(&watch::Sender<bool>) -> R,
    ) -> R {
        let mut lines = self.lines.lock();
        look(lines.down.entry((process.clone(), towards)).or_insert_with(|| watch::Sender::new(false)))
    }

    pub(crate) fn way(&self, process: Name) -> ModelWay {
        ModelWay { network: self.clone(), process }
    }

    /// Waits until a message gets through.
    async fn passes(&self, down: &mut watch::Receiver<bool>) {
        let takes = match self.chance.below(400) {
            0 if self.lines.lock().is_calm => Duration::ZERO,
            0 => self.chance.ms(100, 1500),
            1..200 => self.chance.ms(0, 2),
            _ => Duration::ZERO,
        };
        if !takes.is_zero() {
            tokio::time::sleep(takes).await;
        }
        // The sender lives as long as the network.
        let _ = down.wait_for(|down| !down).await;
    }

    /// Carries messages until either end lets go.
    async fn carry<T: Message + Send + 'static>(
        self,
        (process, towards): (Name, Towards),
        mut from: impl Stream<Item = T> + Send + Unpin + 'static,
        to: mpsc::Sender<T>,
        mut open: watch::Receiver<()>,
    ) {
        let mut down = self.is_down(&process, towards, watch::Sender::subscribe);
        let carried = async {
            loop {
                // A line whose end is gone is let go of, if only that gets through.
                let message = tokio::select! {
                    biased;
                    () = to.closed() => None,
                    message = from.next() => message,
                };
                self.passes(&mut down).await;
                let Some(message) = message else { return };
                if !message.is_beat() {
                    self.truth.event(Kind::Sent, || format!("{process}: {}", brief(&message)));
                }
                if to.send(message).await.is_err() {
                    return;
                }
            }
        };
        tokio::select! {
            biased;
            _ = open.changed() => {}
            () = carried => {}
        }
    }
}

/// A message of either side.
trait Message: fmt::Debug {
    /// Tells whether it says no more than that its sender is there.
    fn is_beat(&self) -> bool;
}

impl Message for Result<v1::AttachRequest, Status> {
    fn is_beat(&self) -> bool {
        let message = self.as_ref().ok().and_then(|said| said.message.as_ref());
        matches!(message, Some(v1::attach_request::Message::Heartbeat(_)))
    }
}

impl Message for Result<v1::AttachResponse, Status> {
    fn is_beat(&self) -> bool {
        let message = self.as_ref().ok().and_then(|said| said.message.as_ref());
        matches!(message, Some(v1::attach_response::Message::Heartbeat(_)))
    }
}

fn brief(message: &impl fmt::Debug) -> String {
    let mut text = format!("{message:?}");
    text.truncate(text.floor_char_boundary(400));
    text
}

/// The way of one process to whichever manager there is.
pub(crate) struct ModelWay {
    network: Network,
    process: Name,
}

/// A line to a manager that has answered.
pub(crate) struct ModelLine {
    network: Network,
    process: Name,
    port: Port,
}

impl Way for ModelWay {
    type Line = ModelLine;

    async fn dial(&self) -> Result<ModelLine, Refused> {
        for towards in [Towards::Manager, Towards::Process] {
            let mut down = self.network.is_down(&self.process, towards, watch::Sender::subscribe);
            self.network.passes(&mut down).await;
        }
        let port = self.network.lines.lock().port.clone();
        let port = port.ok_or_else(|| Refused::Unheard("connection refused".into()))?;
        Ok(ModelLine { network: self.network.clone(), process: self.process.clone(), port })
    }
}

impl Line for ModelLine {
    async fn attach(self, outgoing: mpsc::Receiver<v1::AttachRequest>) -> Result<Inbound, Refused> {
        let ModelLine { network, process, port: Port { edge, open } } = self;
        let (up, arriving) = mpsc::channel(UNDER_WAY);
        let messages = ReceiverStream::new(outgoing).map(Ok);
        tokio::spawn(network.clone().carry((process.clone(), Towards::Manager), messages, up, open.clone()));
        let (down, inbound) = mpsc::channel(UNDER_WAY);
        // A manager takes a process in whether that waits or not.
        let taken = tokio::spawn(async move {
            let outbound = edge.hear(ReceiverStream::new(arriving)).await;
            outbound.map(|outbound| {
                tokio::spawn(network.carry((process, Towards::Process), outbound, down, open))
            })
        });
        match taken.await {
            Ok(Ok(_)) => Ok(Box::pin(ReceiverStream::new(inbound))),
            Ok(Err(status)) => Err(Refused::Unheard(status.message().to_owned())),
            Err(e) => Err(Refused::Unheard(e.to_string())),
        }
    }
}
