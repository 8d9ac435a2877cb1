//! Answers to the reads that other processes have to ask for.
//!
//! Invariant: a read that does not return holds up the questions of its own connection only, and those run
//! into their deadlines.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock, Weak};

use trocar_plugin_api::abi::{INVALID_ARGUMENT, NOT_ACTIVE};
use trocar_rt::{house, os};

use super::super::boundary::{ERR_BYTES, RangeCheck, Reader, read_published};
use super::super::instance::Instance;
use super::medium::Session;
use super::words::Words;

/// Most questions that may wait.
const DEPTH: usize = 64;

/// A read a client may ask for.
pub(super) struct Served {
    /// Its place among the functions of the connection.
    pub(super) index: u32,
    pub(super) from: Reader,
    pub(super) arg_bytes: usize,
    pub(super) range: Option<RangeCheck>,
    pub(super) ret_bytes: usize,
}

/// One question.
pub(super) struct Question {
    pub(super) number: u64,
    pub(super) index: u32,
    /// Time at which the caller stops waiting, ns.
    pub(super) until_ns: u64,
    pub(super) arg: Vec<u8>,
}

/// Queue of the questions of one link: they are answered on a thread of its own, which starts with the first
/// question and ends with the queue.
pub(super) struct QuestionQueue {
    /// `None`: there are no questions.
    clerk: Option<Arc<Clerk>>,
    thread: OnceLock<Option<SyncSender<Question>>>,
}

impl QuestionQueue {
    /// A queue without questions.
    pub(super) fn closed() -> QuestionQueue {
        QuestionQueue { clerk: None, thread: OnceLock::new() }
    }

    pub(super) fn open(
        server: &Arc<Instance>,
        session: &Arc<dyn Session>,
        (connection, epoch): (u64, u64),
        served: Vec<Served>,
    ) -> QuestionQueue {
        let server = Arc::downgrade(server);
        let clerk = Arc::new(Clerk { server, session: session.clone(), connection, epoch, served });
        QuestionQueue { clerk: Some(clerk), thread: OnceLock::new() }
    }

    /// Takes a question; one too many is not answered.
    pub(super) fn ask(&self, question: Question) {
        // The thread starts late: most connections have reads that are never asked for.
        if let Some(thread) = self.thread.get_or_init(|| self.begin()) {
            let _ = thread.try_send(question);
        }
    }

    fn begin(&self) -> Option<SyncSender<Question>> {
        let clerk = self.clerk.clone()?;
        let (ask, asked) = sync_channel(DEPTH);
        let connection = clerk.connection;
        let begun =
            house::spawn(std::thread::Builder::new().name("trocar-reads".into()), move || clerk.run(&asked));
        if let Err(e) = begun {
            log::error!("connection {connection}: reads are not answered: no thread for it: {e}");
            return None;
        }
        Some(ask)
    }
}

struct Clerk {
    server: Weak<Instance>,
    session: Arc<dyn Session>,
    connection: u64,
    epoch: u64,
    served: Vec<Served>,
}

impl Clerk {
    fn run(&self, asked: &Receiver<Question>) {
        while let Ok(question) = asked.recv() {
            if question.until_ns > os::now_ns() {
                self.answer(&question);
            }
        }
    }

    fn answer(&self, question: &Question) {
        let (mut value, mut text) = (Vec::new(), vec![0; ERR_BYTES]);
        let mut told = (INVALID_ARGUMENT, 0, 0);
        if let Some(served) = self.served.iter().find(|served| served.index == question.index)
            && question.arg.len() == served.arg_bytes
            && served.range.as_ref().is_none_or(|range| range.holds_in(&question.arg))
        {
            value = vec![0; served.ret_bytes];
            told = match self.server.upgrade() {
                Some(server) => {
                    let read =
                        read_published(&server, &served.from, &question.arg, &mut value, &mut text, false);
                    (read.outcome, read.stamp_ns, read.text_bytes)
                }
                None => (NOT_ACTIVE, 0, 0),
            };
        }
        let (outcome, stamp_ns, text_bytes) = told;
        let words = Words::Told {
            connection: self.connection,
            epoch: self.epoch,
            number: question.number,
            outcome,
            stamp_ns,
            value_bytes: value.len() as u32,
        };
        value.extend_from_slice(&text[..text_bytes]);
        // A failure needs no answer: the caller has its deadline.
        let _ = self.session.say(&words, &value, &[]);
    }
}
