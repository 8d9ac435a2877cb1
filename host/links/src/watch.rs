//! The thread that sleeps until the kernel marks the word of a process that died, and tells the thread of the
//! sessions.
//!
//! Invariant: another process that plays with its word costs a few wakes and the early sign of its own end,
//! which its heart and its socket tell as well.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::JoinHandle;

use parking_lot::Mutex;
use trocar_rt::house;
use trocar_rt::os::{MOST_WORDS, Scope, futex_wait_each, futex_wake};
use trocar_rt::pulse::Life;

use crate::asked::{Ask, Shared};
use crate::session::Session;

/// Wakes for nothing by one process until its word is watched no more.
const MOST_FALSE: u32 = 16;

/// The sessions whose word is watched.
pub(crate) struct Watch {
    asked: Arc<Asked>,
    shared: Arc<Shared>,
    /// From the first session on.
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Asked {
    book: Mutex<Book>,
    /// Changes whenever another thread has changed the book.
    bell: AtomicU32,
}

#[derive(Default)]
struct Book {
    watched: Vec<Watched>,
    /// The thread has ended, or is to end.
    over: bool,
}

#[derive(Clone)]
struct Watched {
    session: Arc<Session>,
    /// Value of the word while the process lived.
    word: u32,
    false_wakes: u32,
}

impl Asked {
    fn ring(&self) {
        self.bell.fetch_add(1, Ordering::Release);
        futex_wake(&self.bell, 1, Scope::Process);
    }
}

impl Watch {
    pub(crate) fn new(shared: Arc<Shared>) -> Watch {
        Watch { asked: Arc::default(), shared, thread: None }
    }

    /// Watches the process of this session. Returns false when that cannot be (yet): the process has written
    /// no word, there are too many, the kernel cannot, or the machine gives no thread.
    pub(crate) fn add(&mut self, session: &Arc<Session>) -> bool {
        let Life::Lives(word) = session.pulse.life() else { return false };
        let mut book = self.asked.book.lock();
        if book.over || book.watched.len() + 1 >= MOST_WORDS {
            return false;
        }
        if self.thread.is_none() {
            let (asked, shared) = (self.asked.clone(), self.shared.clone());
            let thread = std::thread::Builder::new().name("trocar-watch".into());
            let Ok(thread) = house::spawn(thread, move || watch(&asked, &shared)) else { return false };
            self.thread = Some(thread);
        }
        book.watched.push(Watched { session: session.clone(), word, false_wakes: 0 });
        drop(book);
        self.asked.ring();
        true
    }

    pub(crate) fn remove(&self, session: &Arc<Session>) {
        let mut book = self.asked.book.lock();
        let all = book.watched.len();
        book.watched.retain(|watched| !Arc::ptr_eq(&watched.session, session));
        let was_there = book.watched.len() < all;
        drop(book);
        if was_there {
            self.asked.ring();
        }
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.asked.book.lock().over = true;
        self.asked.ring();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the thread that watches other processes panicked");
        }
    }
}

fn watch(asked: &Asked, shared: &Shared) {
    let mut woken = None;
    loop {
        let rung = asked.bell.load(Ordering::Acquire);
        let watched = {
            let mut book = asked.book.lock();
            if book.over {
                return;
            }
            book.watched.retain_mut(|watched| watched.stays(woken, shared));
            book.watched.clone()
        };
        let words = watched.iter().map(|w| (w.session.pulse.life_word(), w.word, Scope::Machine));
        let own = std::iter::once((&asked.bell, rung, Scope::Process));
        woken = match futex_wait_each(own.chain(words)) {
            Ok(place) => place.and_then(|at| watched.get(at.checked_sub(1)?)).map(|w| w.session.number()),
            Err(_) => {
                log::info!(
                    "the kernel lets no thread sleep on several words: the death of a process is seen later"
                );
                *asked.book.lock() = Book { over: true, ..Book::default() };
                return;
            }
        };
    }
}

impl Watched {
    /// Tells whether to watch it on; `woken` is the session whose word woke the sleeper.
    fn stays(&mut self, woken: Option<u64>, shared: &Shared) -> bool {
        match self.session.pulse.life() {
            Life::Died => {
                shared.ask(Ask::Died(self.session.number()));
                false
            }
            // The process began with this very word; any other one ends the watch.
            Life::Lives(word) if word == self.word => {
                self.false_wakes += u32::from(woken == Some(self.session.number()));
                self.false_wakes < MOST_FALSE
            }
            _ => false,
        }
    }
}
