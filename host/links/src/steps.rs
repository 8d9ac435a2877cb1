//! Steps of a greeting, at either end: which answer follows which message, and which process is turned away.
//!
//! Invariant: nothing said in a greeting is kept or passed on before it was checked for its length and its
//! characters.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::PathBuf;

use trocar_rt::pulse::Pulse;

use crate::card::{Card, random};
use crate::greeting::{Greeting, VERSION};
use crate::plain::plain;
use crate::socket::send;

/// Stage of a greeting. The dialling side knows the address.
pub(crate) enum Stage {
    /// Hello is awaited.
    Knocking,
    /// Echo is awaited.
    Welcomed { card: Card, pulse: Pulse },
    /// Welcome is awaited.
    Calling { at: PathBuf },
    /// Ready is awaited.
    Echoed { at: PathBuf, card: Card, pulse: Pulse },
}

impl Stage {
    pub(crate) fn at(&self) -> Option<&PathBuf> {
        match self {
            Stage::Knocking | Stage::Welcomed { .. } => None,
            Stage::Calling { at } | Stage::Echoed { at, .. } => Some(at),
        }
    }

    /// Tells, of a greeting that a caller began, whether the caller has said something; those that said
    /// nothing come first.
    pub(crate) fn is_guest(&self) -> Option<bool> {
        self.at().is_none().then_some(!matches!(self, Stage::Knocking))
    }
}

pub(crate) enum Step {
    On(Stage),
    Met(Card, Pulse),
}

pub(crate) struct Refusal {
    pub(crate) why: String,
    pub(crate) by: By,
}

/// Side that ended a greeting.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum By {
    /// This process, which tells the other one.
    Us,
    Them,
    /// Neither side: the other end hung up in the middle, perhaps since its time was over. It is called
    /// again.
    Nobody,
}

impl Refusal {
    pub(crate) fn told(why: String) -> Refusal {
        Refusal { why, by: By::Us }
    }
}

/// The next step of a greeting.
///
/// # Errors
/// The greeting is over, and why.
pub(crate) fn step(
    own: &Card,
    socket: &OwnedFd,
    stage: Stage,
    said: Greeting,
    files: Vec<OwnedFd>,
) -> Result<Step, Refusal> {
    let tell = |said: &Greeting, files: &[BorrowedFd<'_>]| {
        send(socket.as_fd(), &[&said.encode()], files)
            .map_err(|e| Refusal { why: format!("it cannot be answered: {e}"), by: By::Nobody })
    };
    let fits = |card: &Card| {
        card.check().map_err(Refusal::told)?;
        own.reaches(card).map_err(|e| Refusal::told(e.to_string()))
    };
    match (stage, said) {
        (Stage::Knocking, Greeting::Hello { version, card }) => {
            if version != VERSION {
                return Err(Refusal::told(format!(
                    "it greets in version {version}, this process in {VERSION}"
                )));
            }
            fits(&card)?;
            let page = random().and_then(|number| Pulse::create(words(number)));
            let pulse = page.map_err(|e| Refusal::told(format!("no memory to share: {e}")))?;
            let shared = pulse.fd().into_iter().collect::<Vec<_>>();
            tell(&Greeting::Welcome { card: own.clone() }, &shared)?;
            Ok(Step::On(Stage::Welcomed { card, pulse }))
        }
        (Stage::Calling { at }, Greeting::Welcome { card }) => {
            fits(&card)?;
            let page = files.into_iter().next().ok_or_else(|| {
                Refusal::told("no memory came along: this process may open no more files".into())
            })?;
            let pulse =
                Pulse::open(page).map_err(|e| Refusal::told(format!("the memory that came along: {e}")))?;
            tell(&Greeting::Echo { nonce: pulse.nonce() }, &[])?;
            Ok(Step::On(Stage::Echoed { at, card, pulse }))
        }
        (Stage::Welcomed { card, pulse }, Greeting::Echo { nonce }) => {
            if nonce != pulse.nonce() {
                return Err(Refusal::told("it does not see the memory it was given".into()));
            }
            tell(&Greeting::Ready, &[])?;
            Ok(Step::Met(card, pulse))
        }
        (Stage::Echoed { card, pulse, .. }, Greeting::Ready) => Ok(Step::Met(card, pulse)),
        (stage, Greeting::Refused { why }) if stage.at().is_some() => {
            Err(Refusal { why: plain(&why), by: By::Them })
        }
        (_, said) => Err(Refusal::told(format!("out of turn: {}", said.name()))),
    }
}

pub(crate) fn refuse(socket: &OwnedFd, why: String) {
    // The peer may not listen; then it is not told.
    let _ = send(socket.as_fd(), &[&Greeting::Refused { why }.encode()], &[]);
}

fn words(bytes: [u8; 16]) -> [u64; 2] {
    let (a, b) = bytes.split_at(8);
    [a, b].map(|half| half.iter().fold(0, |word, byte| word << 8 | u64::from(*byte)))
}
