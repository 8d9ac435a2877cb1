//! Dynamic component services: a component's own code asks for services that the GCM offers to everybody.
//!
//! Invariant: asking never waits, locks or allocates on the asking thread, so commands and event handlers of
//! a real-time thread may ask; `step` may not. A reply is handed over between two steps, by the component's
//! own thread, or dropped when the instance that asked is gone.

use std::io;
use std::sync::Arc;

use trocar_loader::system;
use trocar_model::{ComponentId, State};
use trocar_rt::os;

use super::executor::Executor;
use super::instance::Instance;
use super::request_queue::{Asked, RequestQueue};
use super::watch::Entry;

/// Longest wait of a reply for a thread inside the component, ns, before it queues again.
const PATIENCE_NS: u64 = 20_000_000;
/// Number of times a reply queues before it is given up.
const ATTEMPTS: u32 = 500;

/// Takes the reply, as JSON; called once, from any thread.
pub type ReplyTo = Box<dyn FnOnce(String) + Send>;

/// Executor of the components' requests; given to an LCM from above, see [`crate::LocalLcm::offer_services`].
pub trait Services: Send + Sync {
    /// Begins to carry out `request`, a JSON object with its verb, and returns at once.
    fn request(&self, from: ComponentId, request: String, reply: ReplyTo);
}

/// Finds a component by its number, with its thread; `None` when it is gone.
pub(super) trait Find: Fn(u32) -> Option<(Arc<Instance>, Arc<Executor>)> + Send + Sync {}

impl<F: Fn(u32) -> Option<(Arc<Instance>, Arc<Executor>)> + Send + Sync> Find for F {}

/// Opens the queue: requests are carried out by `services`, and replies handed to components that `find`
/// knows.
///
/// # Errors
/// The machine gives no more threads.
pub(super) fn open(
    request_queue: &Arc<RequestQueue>,
    services: Arc<dyn Services>,
    find: impl Find + 'static,
) -> io::Result<()> {
    let find = Arc::new(find);
    request_queue.open(move |asked, request| {
        let (id, find) = (asked.id.clone(), find.clone());
        let reply = Box::new(move |reply: String| {
            if let Some((instance, executor)) = find(asked.number) {
                hand_over(instance, &executor, asked, reply, ATTEMPTS);
            }
        });
        services.request(id, request, reply);
    })
}

/// Queues a reply behind the jobs of the component's thread.
fn hand_over(instance: Arc<Instance>, executor: &Arc<Executor>, asked: Asked, reply: String, left: u32) {
    let (here, runs_on) = (executor.clone(), Arc::downgrade(executor));
    here.submit(move |_| {
        let gone = instance.account().made() != asked.made;
        if gone || instance.state() == State::Fault {
            return;
        }
        let Some(mut entered) = instance.object.enter_until(os::now_ns() + PATIENCE_NS) else {
            // A callback thread, or a caller of a passive component, is inside.
            match runs_on.upgrade().filter(|_| left > 0) {
                Some(executor) => hand_over(instance, &executor, asked, reply, left - 1),
                None => log::error!("{}: a service's reply was given up: it is never free", instance.id),
            }
            return;
        };
        let token = asked.token;
        // Frees its place before the component may ask again.
        drop(asked);
        match instance.as_running(Entry::Service, || entered.on_service(token, &reply)) {
            Ok(()) => instance.publish_state(&mut entered),
            Err(e) if e.panicked() => instance.fail(&mut entered, "on_service", &e),
            Err(e) => {
                let text = format!("on_service: {}", e.text);
                instance.message(system::ERROR, &text);
                instance.warn(&text);
                instance.publish_state(&mut entered);
            }
        }
        instance.pay_safe(&mut entered);
        drop(entered);
        instance.drain_if_passive();
    });
}
