//! The first words of both ends of a line, after both have shown their certificates.
//!
//! Each end says which process it is; a certificate that does not name that process ends it. Then the ends
//! exchange a few beats, so that whatever is said later has a time. The second connection, for the bulk lane,
//! names the line that it belongs to, by the number that the dialled end gave. Invariant: nothing that was
//! said is kept before it was checked.

use std::time::Instant;

use serde::{Deserialize, Serialize};
use trocar_rt::os::now_ns;

use super::clock::{Beat, Clock};
use super::wire::{Inbox, Outbox, Wire};
use crate::holder::Holder;
use crate::role::Role;

/// Version of the messages and their order.
pub(super) const VERSION: u32 = 2;
/// Kind of the messages of a greeting.
const GREETING: u8 = 255;
/// Kind of a beat, also later.
pub(super) const BEAT: u8 = 0;
/// Beats of each end in a greeting.
const BEATS: usize = 6;
/// Characters of a name.
const MOST_NAME: usize = 128;

/// A run of a process, as it says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Who {
    pub process: String,
    /// Identifies this run of the process: two runs never have the same.
    pub instance: String,
}

#[derive(Debug, Serialize, Deserialize)]
enum Greeting {
    /// `line`: 0 where a line is begun, else its number at the end that is dialled.
    Hello {
        version: u32,
        who: Who,
        line: u64,
    },
    Refused {
        why: String,
        for_long: bool,
    },
}

/// Why nothing came of a greeting.
#[derive(Debug)]
pub(super) struct Refused {
    pub(super) why: String,
    /// One end said no: to try again is of little use.
    pub(super) for_long: bool,
}

impl Refused {
    /// Names who refused, or was refused.
    pub(super) fn by(self, who: &str) -> Refused {
        Refused { why: format!("{who}: {}", self.why), ..self }
    }
}

impl From<String> for Refused {
    fn from(why: String) -> Refused {
        Refused { why, for_long: false }
    }
}

/// Result of a greeting.
pub(super) struct Met {
    pub(super) who: Who,
    /// Number of the line at the end that was dialled.
    pub(super) line: u64,
    pub(super) clock: Clock,
    /// Whatever came behind the greeting.
    pub(super) inbox: Inbox,
}

/// Greets from the dialling end, where a line is begun.
pub(super) fn call(
    (wire, mut inbox): (&mut Wire, Inbox),
    holder: &Holder,
    own: &Who,
    until: Instant,
) -> Result<Met, Refused> {
    hello(wire, own, 0)?;
    let (who, line) = hear(wire, &mut inbox, holder, until)?;
    let clock = Clock::default();
    for _ in 0..BEATS {
        beat(wire, &clock)?;
        take_beat(wire, &mut inbox, &clock, until)?;
    }
    beat(wire, &clock)?;
    known(Met { who, line, clock, inbox })
}

/// Greets from the dialling end on the second connection of a line.
pub(super) fn call_beside(
    (wire, mut inbox): (&mut Wire, Inbox),
    holder: &Holder,
    own: &Who,
    (met, until): (&Met, Instant),
) -> Result<Inbox, Refused> {
    hello(wire, own, met.line)?;
    match hear(wire, &mut inbox, holder, until)? {
        (who, line) if who == met.who && line == met.line => Ok(inbox),
        (who, _) => Err(format!("{} answers in its place, or for another line", who.process).into()),
    }
}

/// Greets from the end that was dialled, where a line is begun: it has the number `line` here.
pub(super) fn answer(
    (wire, mut inbox): (&mut Wire, Inbox),
    (own, who): (&Who, Who),
    line: u64,
    until: Instant,
) -> Result<Met, Refused> {
    hello(wire, own, line)?;
    let clock = Clock::default();
    for _ in 0..BEATS {
        take_beat(wire, &mut inbox, &clock, until)?;
        beat(wire, &clock)?;
    }
    take_beat(wire, &mut inbox, &clock, until)?;
    known(Met { who, line, clock, inbox })
}

/// Hears who dials, and to which line this connection belongs; 0: it begins one.
pub(super) fn asked(
    (wire, inbox): (&mut Wire, &mut Inbox),
    holder: &Holder,
    until: Instant,
) -> Result<(Who, u64), Refused> {
    hear(wire, inbox, holder, until).inspect_err(|refused| turn_away(wire, refused))
}

/// Tells a caller why it is refused. It may be gone.
pub(super) fn turn_away(wire: &Wire, Refused { why, for_long }: &Refused) {
    let _ = say(wire, &Greeting::Refused { why: why.clone(), for_long: *for_long });
}

fn known(met: Met) -> Result<Met, Refused> {
    match met.clock.is_known() {
        true => Ok(met),
        false => {
            Err(Refused { why: "its clock cannot be made out: its beats are none".into(), for_long: true })
        }
    }
}

/// Says who this process is.
pub(super) fn hello(wire: &Wire, own: &Who, line: u64) -> Result<(), Refused> {
    say(wire, &Greeting::Hello { version: VERSION, who: own.clone(), line })
}

fn say(wire: &Wire, words: &Greeting) -> Result<(), Refused> {
    let mut out = Outbox::default();
    let words = serde_json::to_vec(words).map_err(|e| e.to_string())?;
    out.message(GREETING, |content| content.extend_from_slice(&words));
    wire.send(out.bytes()).map_err(|e| e.to_string().into())
}

fn hear(wire: &mut Wire, inbox: &mut Inbox, holder: &Holder, until: Instant) -> Result<(Who, u64), Refused> {
    let no = |why: String| Refused { why, for_long: true };
    let (kind, content) = wire.hear(inbox, until)?;
    let words = if kind == GREETING { serde_json::from_slice(&content).ok() } else { None };
    match words.ok_or_else(|| no("it does not greet as processes of trocar do".into()))? {
        Greeting::Refused { why, for_long } => {
            Err(Refused { why: format!("it refuses: {}", plain(&why)), for_long })
        }
        Greeting::Hello { version, .. } if version != VERSION => Err(no(format!(
            "it speaks version {version} of the protocol, this process {VERSION}: both must be of one release"
        ))),
        Greeting::Hello { who, .. } if !is_name(&who.process) || !is_name(&who.instance) => {
            Err(no("it gives a name that is none".into()))
        }
        Greeting::Hello { who, .. } if !is(holder, &who.process) => Err(no(format!(
            "it says that it is process {}, and its certificate, of the {holder}, does not name that process",
            who.process
        ))),
        Greeting::Hello { who, line, .. } => Ok((who, line)),
    }
}

/// Tells whether the holder of this certificate may be that process: a manager may hold any.
fn is(holder: &Holder, process: &str) -> bool {
    holder.role == Role::Gcm || (holder.role == Role::Host && holder.is_process(process))
}

fn is_name(text: &str) -> bool {
    let of_name = |c: char| c.is_ascii_alphanumeric() || "_.-".contains(c);
    (1..=MOST_NAME).contains(&text.len()) && text.chars().all(of_name)
}

/// A sentence of the other end, without control characters and not too long.
pub(super) fn plain(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(300).collect()
}

/// Appends a beat.
pub(super) fn put_beat(out: &mut Outbox, beat: Beat) {
    out.message(BEAT, |content| {
        for time in [beat.sent_ns, beat.heard_ns, beat.came_ns] {
            content.extend_from_slice(&time.to_le_bytes());
        }
    });
}

/// The beat in a message.
pub(super) fn beat_in(content: &[u8]) -> Result<Beat, String> {
    let (times, rest) = content.as_chunks::<8>();
    match (times, rest) {
        ([sent, heard, came], []) => {
            let [sent_ns, heard_ns, came_ns] = [sent, heard, came].map(|time| u64::from_le_bytes(*time));
            Ok(Beat { sent_ns, heard_ns, came_ns })
        }
        _ => Err(format!("a beat of {} bytes", content.len())),
    }
}

fn beat(wire: &Wire, clock: &Clock) -> Result<(), Refused> {
    let mut out = Outbox::default();
    put_beat(&mut out, clock.beat(now_ns()));
    wire.send(out.bytes()).map_err(|e| e.to_string().into())
}

fn take_beat(wire: &mut Wire, inbox: &mut Inbox, clock: &Clock, until: Instant) -> Result<(), Refused> {
    let (kind, content) = wire.hear(inbox, until)?;
    let now = now_ns();
    if kind != BEAT {
        return Err(Refused { why: "it says something before its clock is known".into(), for_long: true });
    }
    clock.heard(beat_in(&content)?, now);
    Ok(())
}
