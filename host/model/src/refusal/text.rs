//! The sentence of a refusal.
//!
//! Invariant: it says what was asked, what is wrong and what exists. No list is longer than [`MOST`] entries.

use std::borrow::Cow;
use std::fmt::{self, Display, Write as _};

use crate::{MAX_COPIES, ProcessState, Refusal, Tag, nearest};

/// Entries of a list that are spelled out.
const MOST: usize = 12;

/// Most characters of a sent text that are repeated to its sender.
const ECHO: usize = 200;

/// Ends the difference of two types whose fields only moved.
pub(crate) const ADAPTABLE: &str = "; adapt: true would copy it by name";

/// Ends the difference of two types whose fields only moved, but too many of them.
pub(crate) fn scattered() -> String {
    format!(
        "; adapt: true cannot help, it would have to copy more than {MAX_COPIES} runs of bytes for each sample"
    )
}

/// Returns the text that was sent, cut where it is longer than any reader needs; an answer must fit the
/// header it travels in.
pub fn brief(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(ECHO) {
        None => Cow::Borrowed(text),
        Some((end, _)) => Cow::Owned(format!("{}… ({} bytes)", &text[..end], text.len())),
    }
}

/// "a, b, c and 5 more".
pub(super) fn list<T: Display>(items: &[T]) -> String {
    let mut out = String::new();
    for (i, item) in items.iter().take(MOST).enumerate() {
        // Writing to a String cannot fail.
        let _ = write!(out, "{}{item}", if i > 0 { ", " } else { "" });
    }
    if items.len() > MOST {
        let _ = write!(out, " and {} more", items.len() - MOST);
    }
    out
}

/// The known name nearest to the mistyped one.
pub(super) fn near<T: Display>(wanted: &str, known: &[T]) -> Option<String> {
    // A word that long is no typing error, and the distance costs the product of the lengths.
    if wanted.len() > ECHO {
        return None;
    }
    let names: Vec<String> = known.iter().map(ToString::to_string).collect();
    nearest(wanted, names.iter().map(String::as_str)).map(str::to_owned)
}

/// "; did you mean `host`? There are gcm, host" — or only the part that helps.
fn choices<T: Display>(wanted: &str, known: &[T]) -> String {
    let there = if known.len() == 1 { "There is" } else { "There are" };
    match near(wanted, known) {
        _ if known.is_empty() => "; there are none".to_owned(),
        Some(name) => format!("; did you mean `{name}`? {there} {}", list(known)),
        None => format!("; {} {}", there.to_lowercase(), list(known)),
    }
}

/// 1500000 ns → "1.5 ms".
pub(crate) fn duration(ns: u64) -> String {
    let (scale, unit) = match ns {
        0..1_000 => (1.0, "ns"),
        1_000..1_000_000 => (1e3, "µs"),
        1_000_000..1_000_000_000 => (1e6, "ms"),
        _ => (1e9, "s"),
    };
    format!("{} {unit}", ns as f64 / scale)
}

impl Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use Refusal::*;
        match self {
            BadPath { text, why } => write!(f, "`{}` is not a path: {why}", brief(text)),
            ProcessNotFound { process, known } => {
                write!(f, "there is no process `{process}`{}", choices(process.as_str(), known))
            }
            ProcessLost { process, state, last_exit } => {
                let ended = if last_exit.is_empty() { "" } else { &format!(": it {}", brief(last_exit)) };
                match state {
                    ProcessState::Restarting => write!(
                        f,
                        "process `{process}` is being restarted{ended}; it is not there yet, or not all of its \
                         components are"
                    ),
                    ProcessState::Failed => {
                        write!(f, "process `{process}` has failed and is not started again{ended}")
                    }
                    ProcessState::Lost | ProcessState::Attached if !last_exit.is_empty() => {
                        write!(f, "process `{process}` has ended{ended}")
                    }
                    ProcessState::Lost | ProcessState::Attached => {
                        write!(f, "process `{process}` is lost: it is known but does not answer")
                    }
                }
            }
            NotSupervised { process, known } => {
                write!(
                    f,
                    "process `{process}` has no supervisor, which would start it again or make another process beside it"
                )?;
                if known.is_empty() { Ok(()) } else { write!(f, "; there is one of {}", list(known)) }
            }
            ProcessNotUp { process, why } => {
                write!(f, "process `{process}` did not come up: {}", brief(why))
            }
            ProcessRuns { process, state: ProcessState::Restarting, .. } => {
                write!(f, "process `{process}` is being started again: only one that has ended is forgotten")
            }
            ProcessRuns { process, pid, .. } => {
                write!(f, "process `{process}` runs (pid {pid}): only one that has ended is forgotten")
            }
            ProcessExists { process, endpoint, pid } => {
                let endpoint = if endpoint.is_empty() { "" } else { &format!(", listening on {endpoint}") };
                write!(f, "the name `{process}` is taken by a process that answers (pid {pid}{endpoint})")
            }
            ClassNotFound { process, class, ambiguous, .. } if !ambiguous.is_empty() => {
                write!(
                    f,
                    "class `{}` could be any of {} in process `{process}`",
                    brief(class),
                    list(ambiguous)
                )
            }
            ClassNotFound { process, class, known, elsewhere, .. } => {
                write!(f, "process `{process}` has no class `{}`{}", brief(class), choices(class, known))?;
                if elsewhere.is_empty() {
                    Ok(())
                } else {
                    write!(f, "; it is available in {}", list(elsewhere))
                }
            }
            ComponentExists { id } => write!(f, "component `{id}` exists already"),
            ComponentNotFound { id, known } => {
                write!(f, "there is no component `{id}`{}", choices(&id.to_string(), known))
            }
            NothingMatches { pattern, known } => {
                write!(f, "no component matches `{}`{}", brief(pattern), choices(pattern, known))
            }
            InterfaceNotFound { port, known } => write!(
                f,
                "component `{}` has no interface, input or output `{}`{}",
                port.component,
                port.port,
                choices(port.port.as_str(), known)
            ),
            MemberNotFound { member, known } => {
                write!(
                    f,
                    "`{}` has no `{}`{}",
                    member.port,
                    member.member,
                    choices(member.member.as_str(), known)
                )
            }
            WrongKind { member, is, wanted } => write!(f, "`{member}` is {is}, not {wanted}"),
            ManagedElsewhere { at } => write!(f, "this process is managed by the GCM at {at}"),
            PluginNotFound { name, known } => {
                write!(
                    f,
                    "there is no plugin or class \"{}\" in any process{}",
                    brief(name),
                    choices(name, known)
                )
            }
            ConnectionNotFound { asked, known } => {
                write!(f, "there is no connection {}", brief(asked))?;
                match known.as_slice() {
                    [] => f.write_str("; there are none"),
                    [one] => write!(f, "; there is connection {one}"),
                    several => write!(f, "; there are connections {}", list(several)),
                }
            }
            WrongDirection { client, client_is, server, server_is } => write!(
                f,
                "`{client}` is {client_is} and `{server}` is {server_is}, which do not go together as client and server"
            ),
            AlreadyConnected { client, server } => {
                write!(f, "`{client}` is already connected, to `{server}`")
            }
            ConnectionExists { id, client, server } => {
                write!(f, "`{client}` is already connected to `{server}`: that is connection {id}")
            }
            CommandMissing { client, server, function, known } => {
                write!(
                    f,
                    "`{client}` needs `{function}`, which `{server}` does not offer{}",
                    choices(function, known)
                )
            }
            CommandKindMismatch { client, server, function, wants, has } => {
                write!(
                    f,
                    "`{function}` is wanted by `{client}` as {wants}, but `{server}` offers it as {has}"
                )
            }
            TypeMismatch { client, server, what, difference } => {
                write!(f, "the {what} of `{client}` (here) and `{server}` (there) differ: {difference}")
            }
            FormatMismatch { client, server, wants, has } => {
                write!(f, "`{client}` takes {wants}, but `{server}` gives {has}")
            }
            TagMismatch { client, server, has } => {
                let has = match has {
                    Tag::None => "has no tag".to_owned(),
                    tag => format!("is tagged {}", tag.name()),
                };
                write!(f, "`{client}` is tagged sim and takes only what is, too, but `{server}` {has}")
            }
            TruthToActuator { client, server, tag, path } => {
                let path: Vec<String> = path.iter().map(|id| format!("`{id}`")).collect();
                write!(
                    f,
                    "`{server}` is tagged {}, and what it tells `{client}` would reach an actuator: {}",
                    tag.name(),
                    path.join(" → ")
                )
            }
            SyncCycle { path } => {
                let path: Vec<String> = path.iter().map(|id| format!("`{id}`")).collect();
                write!(
                    f,
                    "the components would call each other in a circle, in one thread: {}",
                    path.join(" → ")
                )
            }
            WrongState { id, state, verb, allowed, why } => {
                write!(f, "{verb} of `{id}` is not allowed in state {state}")?;
                if !why.is_empty() {
                    write!(f, ": {why}")?;
                }
                let others: Vec<_> = allowed.iter().filter(|other| *other != verb).collect();
                if others.is_empty() { Ok(()) } else { write!(f, "; allowed are {}", list(&others)) }
            }
            Unconnected { id, verb, ports } => {
                let verb = verb.to_string().to_lowercase();
                write!(f, "`{id}` cannot {verb}: {} {} not connected", list(ports), is_are(ports.len()))
            }
            ConfigInvalid { id, violations } => {
                let messages = violations.iter().take(MOST).map(|v| v.message.as_str());
                let messages = messages.collect::<Vec<_>>().join("; ");
                write!(f, "the configuration of `{id}` is not valid: {messages}")?;
                match violations.len().saturating_sub(MOST) {
                    0 => Ok(()),
                    more => write!(f, "; and {more} more"),
                }
            }
            ArgumentInvalid { what, why, .. } => write!(f, "{why} ({what})"),
            ComponentRefused { id, entry, text } => write!(f, "`{id}` refused to {entry}: {text}"),
            ComponentFault { id, text } => write!(f, "`{id}` is in FAULT: {text}"),
            NoMemory { id, outputs, bytes, why } => {
                write!(f, "`{id}` asks for {bytes} bytes for the frames of {}: {why}", list(outputs))
            }
            Unreachable { client, server, why } => {
                write!(f, "`{client}` cannot be connected to `{server}` in another process: {why}")
            }
            NoThread { id, why } => write!(f, "the machine gives no thread for `{id}`: {why}"),
            InUse { id, by } => write!(f, "`{id}` is in use by {}", list(by)),
            PluginAbi { file, text } => {
                write!(f, "plugin `{file}` does not fit this host: {}", without_file(file, text))
            }
            PluginUntrusted { file, text } => {
                write!(f, "plugin `{file}` is not trusted: {}", without_file(file, text))
            }
            PluginBadFile { file, text } => {
                write!(f, "`{file}` is not a usable plugin: {}", without_file(file, text))
            }
            RevisionConflict { expected, actual } => {
                write!(
                    f,
                    "the request was made for revision {expected}, but the graph is at revision {actual}"
                )
            }
            NotReached { id, state, wanted, after_ns } => {
                let wanted: Vec<String> = wanted.iter().map(ToString::to_string).collect();
                let waited = duration(*after_ns);
                write!(f, "`{id}` is {state} and did not become {} within {waited}", wanted.join(" or "))
            }
            EventNotSeen { member, state, after_ns } => {
                let waited = duration(*after_ns);
                write!(f, "event `{member}` did not come within {waited}; its component is {state}")
            }
            NoSample { port, state, after_ns } => {
                let waited = duration(after_ns / 1_000_000 * 1_000_000);
                write!(f, "output `{port}` gave no sample within {waited}; its component is {state}")
            }
            LcmTimeout { process, what } => {
                write!(f, "process `{process}` was not done in time with this: {what}")
            }
            Busy { doing } => {
                write!(f, "the request did not get its turn in time: {doing} is still being carried out")
            }
            Unbound { member } => write!(f, "`{member}` is not connected to anything"),
            Disabled { member } => {
                write!(f, "command `{member}` is not among its component's ports any more")
            }
            NotActive { member, state } => {
                write!(f, "`{member}` cannot run: its component is {state}, not ACTIVE")
            }
            WouldBlock { member } => {
                write!(f, "`{member}` would have to wait, which a real-time thread must not do")
            }
            CommandFailed { member, text } => write!(f, "command `{member}` failed: {text}"),
            Deadline { member, after_ns, may_still_run } => {
                let still =
                    if *may_still_run { "it may still run" } else { "it was taken back and will not run" };
                write!(f, "`{member}` did not finish within {}; {still}", duration(*after_ns))
            }
            PeerLost { member } => write!(f, "the process or component behind `{member}` is gone"),
            Replaced { member } => write!(f, "a newer call of `{member}` took its place before it ran"),
            QueueFull { member, depth } => {
                write!(f, "the queue of `{member}` is full: {depth} calls are waiting already")
            }
            NotImplemented { what, .. } => write!(f, "{what} is not in this version"),
            ProgramsNotAllowed { process, class } => {
                write!(
                    f,
                    "class {class} starts programs as this host's user, and process `{process}` lets no component do that"
                )
            }
            Forbidden { what, caller, user } => {
                let owner = if *user == 0 {
                    "only root changes".into()
                } else {
                    format!("only user {user} and root change")
                };
                write!(f, "{what} is refused to {caller}, who may read: {owner} things here")
            }
            ReadOnly { what } => write!(f, "{what} changes something, and this viewer only reads"),
            Internal { text } => write!(f, "trocar itself made a mistake: {text}"),
        }
    }
}

impl std::error::Error for Refusal {}

fn is_are(n: usize) -> &'static str {
    if n == 1 { "is" } else { "are" }
}

/// Returns what is wrong with a file, without its name: the sentence has named it already.
fn without_file<'a>(file: &str, text: &'a str) -> &'a str {
    let name = file.rsplit('/').next().unwrap_or(file);
    let rest = text.strip_prefix(file).or_else(|| text.strip_prefix(name));
    rest.and_then(|rest| rest.strip_prefix(": ")).unwrap_or(text)
}
