//! The sentence of a refusal and the help that goes with it.
//!
//! Invariant: the sentence says what was asked, what is wrong and what exists; `help` says what to do. No list is longer
//! than [`MOST`] entries.

use std::borrow::Cow;
use std::fmt::{self, Display, Write as _};

use crate::{MAX_COPIES, ProcessState, Refusal, Tag, nearest};

/// Entries of a list that are spelled out.
const MOST: usize = 12;

/// Characters of a text somebody sent that are repeated to him.
const ECHO: usize = 200;

/// Ends the difference of two types whose fields only moved.
pub(crate) const ADAPTABLE: &str = "; adapt: true would copy it by name";

/// Ends the difference of two types whose fields only moved, but too many of them.
pub(crate) fn scattered() -> String {
    format!(
        "; adapt: true cannot help, it would have to copy more than {MAX_COPIES} runs of bytes for each sample"
    )
}

/// What was sent, cut where it is longer than anybody reads; an answer must fit the header it travels in.
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
    // Nothing that long was a slip, and the distance costs the product of the lengths.
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
                    "nobody is there who keeps process `{process}`, and would start it again or make another beside it"
                )?;
                if known.is_empty() { Ok(()) } else { write!(f, "; kept by somebody: {}", list(known)) }
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
                write!(f, "`{id}` cannot {verb}: not connected {} {}", is_are(ports.len()), list(ports))
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
                write!(f, "process `{process}` did not answer in time ({what}); the change was taken back")
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

/// What to do about an argument, by the field it is in: only a command's argument has limits that its class declares.
fn argument_help(field: &str) -> &'static str {
    match field.split('.').next().unwrap_or_default() {
        "json" | "encoded" => "Correct the value and ask again; `trocar describe` shows units and limits.",
        "execution" => {
            "Correct the setting and ask again; `trocar create --help` lists the settings of an execution."
        }
        "options" => {
            "Correct the option and ask again; `trocar connect --help` lists the options of a connection."
        }
        _ => "Correct it and ask again.",
    }
}

impl Refusal {
    /// What to do about it, as one or two whole sentences.
    pub fn help(&self) -> String {
        use Refusal::*;
        match self {
            BadPath { .. } => "Write a path as process/component/interface/command, as far as it is needed, without a \
                slash in front. Names begin with a letter or _ and hold letters, digits, _ . and -. Start, Stop, Resume, Reset \
                and List also take patterns: * is any part of a name, ** everything below."
                .into(),
            ProcessNotFound { process, .. } => format!(
                "Use one of the processes listed by `trocar ls`, or start it: `trocar host --name {process} --plugins DIR`."
            ),
            ProcessLost { state: ProcessState::Restarting, .. } => {
                "Ask again in a moment: its supervisor starts it and its components are made anew; what moves something \
                 then is STOPPED and waits for Resume. `trocar ls` shows when it is ATTACHED."
                    .into()
            }
            ProcessLost { process, state: ProcessState::Failed, .. } => format!(
                "Correct what ends it (`trocar ls` shows how it ended, what it printed is in its supervisor's state \
                 directory, {process}.output.log; `trocar rm --force` takes out a component of it), then \
                 `trocar restart {process}`, or `trocar forget {process}` when it is not wanted any more."
            ),
            NotSupervised { process, .. } => format!(
                "Bring the system up with `trocar up FILE`, which keeps processes, starts them again and makes more, or start one \
                 by hand (`trocar host --name NAME --gcm ADDR`); a component without isolation is made in {process}."
            ),
            ProcessNotUp { process, .. } => format!(
                "What it printed is in {process}.output.log of its supervisor's state directory; correct that and ask again. One that \
                 was to be made for a component alone is gone, and the component can be created without isolation."
            ),
            ProcessLost { process, .. } => format!(
                "Start the process again (`trocar host --name {process}`, which `trocar up` does by itself); its components \
                are made anew, and what moves something comes back STOPPED and waits for Resume. `trocar forget {process}` \
                takes one that is not wanted any more off the list, with its components."
            ),
            ProcessRuns { process, state: ProcessState::Restarting, .. } => format!(
                "Wait until `trocar ls` shows it ATTACHED or FAILED. Take it out of its system file and bring the system up \
                 again when {process} is not to come back."
            ),
            ProcessRuns { pid, .. } => format!(
                "End it first: Ctrl-C in its terminal, `kill {pid}`, or `trocar down` for a whole system; then ask again."
            ),
            ProcessExists { pid, .. } => format!(
                "Use the one that runs, or end it first (`kill {pid}`). A second one beside it needs an address of its own \
                 (`--listen 127.0.0.1:0`) and, under the same GCM, another name (`--name`)."
            ),
            ClassNotFound { ambiguous, .. } if !ambiguous.is_empty() => {
                "Write the class with its plugin in front, as plugin/class.".into()
            }
            ClassNotFound { .. } => "Put the plugin's .so into the process's plugin directory; `trocar plugin ls` shows \
                what was found there and why a file was refused."
                .into(),
            ComponentExists { id } => {
                format!("Take another name, or remove it first: `trocar rm {id}`. Configure changes it in place.")
            }
            ComponentNotFound { .. } => "Use a component listed by `trocar ls`, or create it first.".into(),
            NothingMatches { .. } => "Check the pattern against `trocar ls`: * stays within one part of the path, \
                process/** means everything in a process."
                .into(),
            InterfaceNotFound { port, .. } => {
                format!("`trocar describe {}` shows its interfaces, inputs and outputs.", port.component)
            }
            MemberNotFound { member, .. } => {
                format!("`trocar describe {}` shows the commands and events.", member.port.component)
            }
            WrongKind { member, is, .. } if is.ends_with("command") => format!("Call it: `trocar call {member}`."),
            WrongKind { member, .. } => format!("Follow it: `trocar echo {member}`."),
            ManagedElsewhere { at } => format!("Ask there: `--gcm {at}`, or grpcurl with that address."),
            PluginNotFound { .. } => "`trocar plugin ls` lists every plugin and why a file was refused.".into(),
            ConnectionNotFound { .. } => "`trocar ls` lists the connections with their numbers.".into(),
            WrongDirection { client_is, server_is, .. } => {
                let swapped = matches!(*client_is, "an output" | "a provided interface")
                    && matches!(*server_is, "an input" | "a required interface");
                let first = if swapped { "Exchange client and server. " } else { "" };
                format!(
                    "{first}An input (client) takes an output (server); a required interface (client) takes a provided \
                    interface (server)."
                )
            }
            AlreadyConnected { .. } => {
                "Disconnect it first, or connect with `--replace`, which rewires in one step.".into()
            }
            ConnectionExists { id, .. } => format!(
                "Nothing is left to do; to change its options connect with `--replace`, to undo it `trocar disconnect {id}`."
            ),
            CommandMissing { server, .. } => format!(
                "Connect to an interface that offers it (`trocar describe {}`), or make the function (or handler) optional \
                in the client's class.",
                server.component
            ),
            CommandKindMismatch { .. } => "Declare the function in the client's class with the argument and result the \
                command has: without a result it binds to void and write commands, with one to reads and returning \
                commands."
                .into(),
            TypeMismatch { difference, .. } => {
                let adapt = if difference.ends_with(ADAPTABLE) { " Or ask with adapt: true: the fields only moved." } else { "" };
                format!(
                    "Build both plugins against the same payload type, or put a converting component between them.{adapt}"
                )
            }
            FormatMismatch { .. } => "Put a filter between them that converts, or set the server's format in its \
                configuration."
                .into(),
            TagMismatch { .. } => "Connect it to a simulated device's port that is tagged sim; `trocar describe` shows tags.".into(),
            TruthToActuator { .. } => "Let the controller take what its sensors measure. Recorders, plots and tests may be \
                told the truth, as long as nothing leads from them to an actuator."
                .into(),
            SyncCycle { .. } => "Let one of them run in a thread of its own (execution without stream_of or inside), or \
                leave one of the connections queued (carrier: \"heap\")."
                .into(),
            WrongState { id, state, verb, .. } => match (verb, state) {
                (_, crate::State::Fault) => format!("Reset it first: `trocar reset {id}`."),
                (crate::Verb::Configure, _) => format!("Stop it first: `trocar stop {id}`."),
                (_, crate::State::Created) => format!("Configure it first; `trocar describe {id}` shows what is missing."),
                _ => "Ask for one of the allowed verbs.".into(),
            },
            Unconnected { .. } => "Connect each of them, then ask again; or declare the end optional in the class.".into(),
            ConfigInvalid { .. } => "Correct each of the values; `trocar describe` shows every setting with its unit, \
                limits and default."
                .into(),
            ArgumentInvalid { field, .. } => argument_help(field).into(),
            ComponentRefused { .. } => "The component's own words say why; correct that and ask again. It is as it was \
                before."
                .into(),
            ComponentFault { id, .. } => {
                format!(
                    "Remove the cause, then `trocar reset {id}`, or create it again where it was not made; `trocar logs` \
                    has the details."
                )
            }
            NoMemory { id, .. } => format!(
                "Give the outputs a smaller max_bytes (in the plugin, or in the configuration of `{id}` if it decides), or \
                give the process more memory: end others, raise the limit of its container or of `ulimit -v`."
            ),
            Unreachable { .. } => "Look at both processes with `trocar ls`; they must run on one machine, as one user, of one release."
                .into(),
            NoThread { .. } => "Remove components, let several share a thread (stream_of, inside), or raise the limits of \
                `ulimit -u` and of its container; `trocar doctor` shows them."
                .into(),
            InUse { .. } => "Disconnect or remove those first, or remove with `--force`, which disconnects.".into(),
            PluginAbi { .. } => "Rebuild the plugin with the trocar-sdk of this host's version.".into(),
            PluginUntrusted { .. } => "Install a copy that the trust mode of this process accepts, or change the mode; \
                `trocar plugin inspect FILE` shows hash, owner and permissions."
                .into(),
            PluginBadFile { .. } => "Correct and build it again, or copy it again; `trocar plugin check FILE` says the same \
                without a host."
                .into(),
            RevisionConflict { .. } => "Read the graph again and decide anew; leave out expected_revision to act on \
                whatever is there."
                .into(),
            NotReached { id, .. } => {
                format!("`trocar describe {id}` shows what it does; a longer deadline can be given.")
            }
            EventNotSeen { member, state: crate::State::Active, .. } => {
                format!("`trocar echo {member}` shows when it is sent; a longer deadline can be given.")
            }
            EventNotSeen { member, state, .. } => {
                let verb = if matches!(state, crate::State::Stopped(_)) { "resume" } else { "start" };
                format!("Only an ACTIVE component sends events: `trocar {verb} {}`.", member.port.component)
            }
            NoSample { port, state: crate::State::Active, .. } => format!(
                "Look what it waits for, e.g. an input without data (`trocar describe {}`); a longer deadline can be given.",
                port.component
            ),
            NoSample { port, state, .. } => {
                let verb = match state {
                    crate::State::Stopped(_) => "resume",
                    crate::State::Fault => "reset",
                    _ => "start",
                };
                format!("Only an ACTIVE component gives samples: `trocar {verb} {}`.", port.component)
            }
            LcmTimeout { process, .. } => format!(
                "Look whether process `{process}` hangs or is overloaded (`trocar ls {process}`, `trocar logs`), then ask \
                again; a longer deadline can be given."
            ),
            Unbound { .. } => "Connect the required interface first.".into(),
            Disabled { member } => format!(
                "Its ports have changed: `trocar describe {}` shows those it has now.",
                member.port.component
            ),
            NotActive { member, state } => match state {
                crate::State::Fault => format!("`trocar reset {0}`, then `trocar start {0}`.", member.port.component),
                crate::State::Stopped(_) => format!("`trocar resume {}`.", member.port.component),
                _ => format!("`trocar start {}`.", member.port.component),
            },
            WouldBlock { .. } => "Send it without waiting, or let both components share one executor.".into(),
            CommandFailed { .. } => "The component's own words say why; `trocar describe` shows what the command needs.".into(),
            Deadline { .. } => "Give a longer deadline if the command is slow by nature; otherwise look at the \
                component's health in `trocar ls`."
                .into(),
            PeerLost { .. } => "Look for the process with `trocar ls`; connections return by themselves when it is back, \
                motion waits for Resume."
                .into(),
            Replaced { .. } => "Nothing, where the newer call was yours; otherwise find out with `trocar describe` who else is \
                connected, and let one of them command."
                .into(),
            QueueFull { .. } => "Call more slowly, give the connection a deeper mailbox, or let the command's policy be \
                latest_wins."
                .into(),
            NotImplemented { hint, .. } if !hint.is_empty() => hint.clone(),
            NotImplemented { .. } => "Do without it in this version.".into(),
            ProgramsNotAllowed { process, .. } => format!(
                "Start `{process}` with --allow-exec, or write \"allow_exec\": true for it into \"processes\" of the system file."
            ),
            Forbidden { user, .. } => format!(
                "Ask as user {user}; or let that user give you what `trocar token` prints, and set TROCAR_TOKEN to it \
                 (`trocar`, Python) or send the header `authorization: Bearer TOKEN` (grpcurl -H)."
            ),
            ReadOnly { .. } => "Ask with `trocar` or grpcurl, or start the program without --viewer-read-only.".into(),
            Internal { .. } => "Please report it with the log; nothing was changed on purpose.".into(),
        }
    }
}

/// What is wrong with a file, which the sentence has named already.
fn without_file<'a>(file: &str, text: &'a str) -> &'a str {
    let name = file.rsplit('/').next().unwrap_or(file);
    let rest = text.strip_prefix(file).or_else(|| text.strip_prefix(name));
    rest.and_then(|rest| rest.strip_prefix(": ")).unwrap_or(text)
}
