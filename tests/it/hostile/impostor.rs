//! Takes the place of a process that ended, as far as another one can see, and says and writes what it likes.

use std::fs::File;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex};

use serde_json::{Value, json};
use trocar_links::{Card, Handler, Links, Lost, Message, Session};
use trocar_tests::eventually;

enum News {
    Met,
    Said(Arc<Session>, Message),
    Lost,
}

struct Teller(Mutex<Sender<News>>);

impl Teller {
    fn tell(&self, news: News) {
        let _ = self.0.lock().unwrap().send(news);
    }
}

impl Handler for Teller {
    fn met(&mut self, _: &Arc<Session>) {
        self.tell(News::Met);
    }

    fn said(&mut self, session: &Arc<Session>, message: Message) {
        self.tell(News::Said(session.clone(), message));
    }

    fn lost(&mut self, _: &Arc<Session>, _: &Lost) {
        self.tell(News::Lost);
    }
}

/// Listens where a process of that name would, and calls another one.
pub(super) struct Impostor {
    links: Links,
    news: Receiver<News>,
}

/// One thing its victim said.
pub(super) struct Words {
    pub(super) session: Arc<Session>,
    /// `Open`, `Opened`, `Offered`, ….
    pub(super) verb: String,
    pub(super) body: Value,
    pub(super) files: Vec<OwnedFd>,
}

fn encode(words: &Value) -> Vec<u8> {
    let words = words.to_string();
    [&(words.len() as u32).to_le_bytes()[..], words.as_bytes()].concat()
}

impl Impostor {
    pub(super) fn as_process((name, instance): (&str, String), socket: &Path, victim: &Path) -> Impostor {
        let (tell, news) = channel();
        let card = Card { instance, ..Card::own(name, socket.to_owned()).unwrap() };
        let links = Links::start(card, Teller(Mutex::new(tell))).unwrap();
        links.want(victim);
        Impostor { links, news }
    }

    /// The next words of its victim; `None` when it has said nothing yet.
    pub(super) fn hears(&mut self) -> Option<Words> {
        loop {
            match self.news.try_recv() {
                Ok(News::Said(session, message)) => {
                    let bytes = &message.bytes;
                    let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
                    let words: Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
                    let (verb, body) = words.as_object().unwrap().iter().next().unwrap();
                    let (verb, body) = (verb.clone(), body.clone());
                    return Some(Words { session, verb, body, files: message.files });
                }
                Ok(News::Met | News::Lost) => {}
                Err(TryRecvError::Empty) => return None,
                Err(TryRecvError::Disconnected) => panic!("its own thread ended"),
            }
        }
    }

    /// The session it asked for itself.
    pub(super) fn session(&self, victim: &Path) -> Arc<Session> {
        eventually("the victim lets it in", || {
            self.links.session(victim).ok_or_else(|| self.links.why_not(victim).unwrap_or_default())
        })
    }
}

pub(super) fn say(session: &Session, words: &Value, files: &[BorrowedFd<'_>]) {
    // A victim that does not listen any more is none.
    let _ = session.send(&encode(words), files);
}

/// The hash the victim works with, as it says when it declines another one.
pub(super) fn hash_in(why: &str) -> Option<u64> {
    let at = why.find("(hash 0x")? + "(hash 0x".len();
    u64::from_str_radix(why.get(at..at + 16)?, 16).ok()
}

pub(super) fn open(connection: u64, hash: u64) -> Value {
    json!({ "Open": { "connection": connection, "hash": hash } })
}

pub(super) fn opened(connection: u64, epoch: u64, pools: Value) -> Value {
    json!({ "Opened": { "connection": connection, "epoch": epoch, "pools": pools } })
}

pub(super) fn length(file: BorrowedFd<'_>) -> usize {
    let file = File::from(file.as_fd().try_clone_to_owned().unwrap());
    file.metadata().unwrap().len() as usize
}
