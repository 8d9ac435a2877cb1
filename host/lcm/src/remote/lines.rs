//! The medium between machines: encrypted lines, on which stand-ins tell each other what is put into the
//! memory at either end.

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use trocar_links::Card;
use trocar_net::line::{Ends, Handler, Lane, Line, Lines, Outbox, Place, Traffic, Who};
use trocar_net::{Identity, Revoked};

use super::medium::{Medium, Message, Session};
use super::stand_in::{Kind, StandIns};
use super::todo::Teller;
use super::words::Words;

/// Name of the carrier.
pub(crate) const NAME: &str = "net";
/// Bytes of words that may come at once.
const MOST_AT_ONCE: usize = 4 << 20;
/// Bytes of words of one line that may wait to be handled, each with [`WORDS`] more.
const MOST_WAITING: usize = 16 << 20;
/// Bytes that count for whatever words cost.
const WORDS: usize = 4 << 10;

/// The way by which other machines reach this process.
#[derive(Clone, Debug)]
pub struct Afar {
    /// Address it listens at; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Name or address that other machines are told, if it is another one.
    pub told: Option<String>,
    pub identity: Arc<Identity>,
    pub revoked: Option<Arc<Revoked>>,
    /// Bytes/s that large samples take at most on the line to one process.
    pub most_rate: Option<u64>,
}

struct Net {
    card: Card,
    lines: Lines,
    talks: Talks,
}

/// The live sessions by the number of their line.
type Talks = Arc<Mutex<BTreeMap<u64, Arc<Talk>>>>;

/// Listens for other machines, and tells of what comes.
///
/// # Errors
/// The address cannot be had, or the machine gives no more threads.
pub(super) fn start(afar: Afar, mut card: Card, teller: Teller) -> io::Result<Arc<dyn Medium>> {
    let Afar { listen, told, identity, revoked, most_rate } = afar;
    let talks = Talks::default();
    let who = Who { process: card.process.clone(), instance: card.instance.clone() };
    let handler = Meets { teller, talks: talks.clone() };
    let lines = Lines::start(listen, Ends { who, identity, revoked, most_rate }, handler)?;
    let host = told.unwrap_or_else(|| match listen.ip() {
        std::net::IpAddr::V6(ip) => format!("[{ip}]"),
        ip => ip.to_string(),
    });
    card.net = format!("{host}:{}", lines.port());
    Ok(Arc::new(Net { card, lines, talks }))
}

struct Meets {
    teller: Teller,
    talks: Talks,
}

impl Handler for Meets {
    fn met(&self, line: &Arc<Line>) -> Arc<dyn Traffic> {
        let (line, teller) = (line.clone(), self.teller.clone());
        let talk = Arc::new_cyclic(|me| Talk {
            me: me.clone(),
            stand_ins: StandIns::new(line.clone()),
            line,
            teller,
            waiting: Arc::default(),
        });
        self.talks.lock().insert(talk.line.number(), talk.clone());
        self.teller.met(talk.clone());
        talk
    }

    fn lost(&self, line: &Arc<Line>, why: &str) {
        if let Some(talk) = self.talks.lock().remove(&line.number()) {
            self.teller.lost(talk, why.to_owned());
        }
    }
}

/// A session over one line.
struct Talk {
    me: Weak<Talk>,
    line: Arc<Line>,
    teller: Teller,
    stand_ins: StandIns,
    /// Bytes of words that wait to be handled.
    waiting: Arc<AtomicUsize>,
}

/// Counts words that wait until they are handled.
struct Held {
    all: Arc<AtomicUsize>,
    mine: usize,
}

impl Drop for Held {
    fn drop(&mut self) {
        self.all.fetch_sub(self.mine, Ordering::Relaxed);
    }
}

impl Traffic for Talk {
    fn came(&self, lane: Lane, kind: u8, content: &[u8]) -> Result<(), String> {
        let kind = Kind::of(kind).ok_or_else(|| format!("a message of kind {kind}, which is none"))?;
        if kind != Kind::Words {
            return self.stand_ins.came(lane, kind, content);
        }
        if lane != Lane::Prompt {
            return Err("words on the bulk lane".into());
        }
        let mine = content.len() + WORDS;
        let held = Held { all: self.waiting.clone(), mine };
        let before = self.waiting.fetch_add(mine, Ordering::Relaxed);
        if content.len() > MOST_AT_ONCE || before + mine > MOST_WAITING {
            return Err("more than this process can listen to".into());
        }
        if let Some(me) = self.me.upgrade() {
            let (bytes, held) = (content.to_vec(), Some(Box::new(held) as _));
            self.teller.said(me, Message { bytes, files: Vec::new(), announced: 0, _held: held });
        }
        Ok(())
    }

    fn fill(&self, lane: Lane, out: &mut Outbox) -> bool {
        self.stand_ins.fill(lane, out)
    }
}

impl Session for Talk {
    fn number(&self) -> u64 {
        self.line.number()
    }

    fn process(&self) -> &str {
        &self.line.who().process
    }

    fn instance(&self) -> &str {
        &self.line.who().instance
    }

    fn is_lost(&self) -> bool {
        self.line.is_lost()
    }

    fn say(&self, words: &Words, behind: &[u8], _: &[OwnedFd]) -> Result<(), String> {
        self.line.say(Kind::Words as u8, words.encode(behind)).map_err(|e| e.to_string())
    }

    fn condemn(&self, what: &str) {
        self.line.end(&format!("it said what it may not: {what}"));
    }

    fn stand_ins(&self) -> Option<&StandIns> {
        Some(&self.stand_ins)
    }
}

fn place(card: &Card) -> Place {
    Place { process: card.process.clone(), instance: card.instance.clone(), address: card.net.clone() }
}

impl Medium for Net {
    fn name(&self) -> &'static str {
        NAME
    }

    fn card(&self) -> &Card {
        &self.card
    }

    fn reaches(&self, card: &Card) -> Result<(), String> {
        match card.net.is_empty() {
            false => Ok(()),
            true => Err(format!(
                "{} has no address for connections between machines: it was started without an identity (--identity)",
                card.process
            )),
        }
    }

    fn want(&self, card: &Card) {
        self.lines.want(&place(card));
    }

    fn leave(&self, card: &Card) {
        self.lines.leave(&place(card));
    }

    fn session(&self, card: &Card) -> Option<Arc<dyn Session>> {
        let line = self.lines.line(&place(card))?;
        self.talks.lock().get(&line.number()).cloned().map(|talk| talk as Arc<dyn Session>)
    }

    fn why_not(&self, card: &Card) -> Option<String> {
        self.lines.why_not(&place(card))
    }

    fn refused(&self, card: &Card) -> Option<String> {
        self.lines.refused(&place(card))
    }

    fn stop(&self) {
        self.lines.stop();
    }
}
