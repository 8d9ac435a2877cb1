//! All halves of this process, and the receivers of their news.
//!
//! Invariant: a half is in the list from the moment it is added until it is removed; only the thread
//! `trocar-remote` (`linking.rs`) links and unlinks. The thread of the sessions never waits for it.

use std::io;
use std::sync::Arc;
use std::thread::JoinHandle;

use parking_lot::Mutex;
use tokio::sync::oneshot;
use trocar_lcm_api::{HalfReport, LinkDetail};
use trocar_links::Card;
use trocar_model::ComponentId;
use trocar_rt::house;

use super::super::loss::Loss;
use super::half::Half;
use super::lines::{self, Afar};
use super::linking::Linking;
use super::medium::Medium;
use super::memory;
use super::todo::{Halves, Teller, Todo, Todos, all, locked};

/// All connections of this process to others over one medium.
pub(crate) struct Remote {
    medium: Arc<dyn Medium>,
    halves: Halves,
    todos: Arc<Todos>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Remote {
    /// Listens for other processes of this machine at the socket of the card; `news` gets the state of each
    /// half.
    ///
    /// # Errors
    /// The socket cannot be made there, or the machine gives no more threads.
    pub(crate) fn in_memory(card: Card, news: impl Fn(HalfReport) + Send + 'static) -> io::Result<Remote> {
        Self::over(|teller| memory::start(card, teller), news)
    }

    /// As [`Remote::in_memory`], for processes of other machines.
    ///
    /// # Errors
    /// The address cannot be had, or the machine gives no more threads.
    pub(crate) fn afar(
        afar: Afar,
        card: Card,
        news: impl Fn(HalfReport) + Send + 'static,
    ) -> io::Result<Remote> {
        Self::over(|teller| lines::start(afar, card, teller), news)
    }

    fn over(
        medium: impl FnOnce(Teller) -> io::Result<Arc<dyn Medium>>,
        news: impl Fn(HalfReport) + Send + 'static,
    ) -> io::Result<Remote> {
        let halves = Halves::default();
        let todos = Arc::new(Todos::default());
        let medium = medium(Teller { halves: halves.clone(), todos: todos.clone() })?;
        let linking = Linking::new(medium.clone(), halves.clone(), todos.clone(), news);
        let thread =
            house::spawn(std::thread::Builder::new().name("trocar-remote".into()), move || linking.run())?;
        Ok(Remote { medium, halves, todos, thread: Mutex::new(Some(thread)) })
    }

    /// Name of the carrier.
    pub(crate) fn name(&self) -> &'static str {
        self.medium.name()
    }

    /// # Errors
    /// The sentence why the process of this card cannot be reached.
    pub(crate) fn reaches(&self, card: &Card) -> Result<(), String> {
        self.medium.reaches(card)
    }

    /// Data by which other processes reach this one.
    pub(crate) fn card(&self) -> &Card {
        self.medium.card()
    }

    /// Links this half from now on whenever possible; it replaces another one of the same connection.
    pub(crate) fn add(&self, half: Arc<Half>) {
        let before = locked(&self.halves).insert(half.number(), half.clone());
        self.todos.push(Todo::Added(half, before));
    }

    /// Removes the half of a connection and returns it; `tell` is sent when its wires are cut.
    pub(crate) fn remove(&self, connection: u64, how: Loss, tell: oneshot::Sender<()>) -> Option<Arc<Half>> {
        let half = locked(&self.halves).remove(&connection)?;
        self.todos.push(Todo::Removed(half.clone(), how, tell));
        Some(half)
    }

    /// Removes the connections at those `lost` ports of this component that have changed; returns their
    /// numbers.
    pub(crate) fn cut_misfits(&self, component: &ComponentId, lost: &[String]) -> Vec<u64> {
        let of = |half: &&Arc<Half>| {
            let port = half.port();
            port.component == *component && lost.iter().any(|lost| lost == port.port.as_str())
        };
        let halves = self.halves();
        let misfits = halves.iter().filter(of).filter(|half| !half.still_fits()).map(|half| half.number());
        let misfits: Vec<u64> = misfits.collect();
        for connection in &misfits {
            self.remove(*connection, Loss::Cut, oneshot::channel().0);
        }
        misfits
    }

    pub(crate) fn connections(&self) -> Vec<u64> {
        locked(&self.halves).keys().copied().collect()
    }

    fn halves(&self) -> Vec<Arc<Half>> {
        all(&self.halves)
    }

    /// Reason why it is not linked, as far as known.
    pub(crate) fn why_not(&self, connection: u64) -> String {
        let Some(half) = locked(&self.halves).get(&connection).cloned() else {
            return "it was disconnected".into();
        };
        let why = half.stage().why.clone();
        if why.is_empty() { half.unsaid(&*self.medium) } else { why }
    }

    pub(crate) fn details(&self) -> Vec<LinkDetail> {
        let halves = self.halves().into_iter().map(|half| {
            let HalfReport { end, proxy, .. } = half.report(|| half.unsaid(&*self.medium));
            LinkDetail { halves: proxy.map(|proxy| (end, proxy)).into_iter().collect(), ..half.detail() }
        });
        halves.collect()
    }

    /// State of each half.
    pub(crate) fn reports(&self) -> Vec<HalfReport> {
        self.halves().iter().map(|half| half.report(|| half.unsaid(&*self.medium))).collect()
    }

    /// Cuts all and ends the threads.
    pub(crate) fn stop(&self) {
        self.todos.push(Todo::Stop);
        let thread = self.thread.lock().take();
        if let Some(thread) = thread
            && thread.join().is_err()
        {
            log::error!("the thread of the connections to other processes panicked");
        }
        self.medium.stop();
    }
}

impl Drop for Remote {
    fn drop(&mut self) {
        self.stop();
    }
}
