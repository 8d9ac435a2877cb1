//! The help of a refusal.
//!
//! Invariant: doing what it says helps. A command in backticks can be typed as it stands, words in capitals
//! replaced; tests type them (`host/tests/cli_surface.rs`, `tests/it/control_plane/helps.rs`).

use super::text::ADAPTABLE;
use crate::{ComponentId, MemberId, Name, ProcessState, Refusal, State, Verb};

impl Refusal {
    /// The help, as one or two whole sentences.
    pub fn help(&self) -> String {
        use Refusal::*;
        match self {
            BadPath { .. } => "Write a path as process/component/interface/command, as far as it is needed, without a \
                slash in front. Names begin with a letter or _ and hold letters, digits, _ . and -. Start, Stop, Resume, Reset \
                and List also take patterns: * is any part of a name, ** everything below."
                .into(),
            ProcessNotFound { process, .. } => format!(
                "Use one of the processes listed by `trocar ls`, or start it under this GCM, whose address ADDR is: `{}`.",
                by_hand(process)
            ),
            ProcessLost { state: ProcessState::Restarting, .. } => {
                "Ask again in a moment: its supervisor starts it and its components are made anew; what moves something \
                 then is STOPPED and waits for Resume. `trocar ls` shows when it is ATTACHED."
                    .into()
            }
            ProcessLost { process, state: ProcessState::Failed, .. } => format!(
                "Correct what ends it: `trocar ls` shows how it ended, {process}.output.log in its supervisor's state directory \
                 has what it printed, `trocar rm --force COMPONENT` removes a component of it. Then `trocar restart {process}`, or \
                 `trocar forget {process}` when it is not wanted any more."
            ),
            NotSupervised { process, .. } => format!(
                "Bring the system up with `trocar up FILE`, whose processes have a supervisor, and ask there. Without one, end \
                 and start the process by hand (`{}`, ADDR being the GCM's address), and create the component without isolation: \
                 it is then made in {process}.",
                by_hand(process)
            ),
            ProcessNotUp { process, .. } => format!(
                "What it printed is in {process}.output.log of its supervisor's state directory; correct that and ask again. One that \
                 was to be made for a component alone is gone, and the component can be created without isolation."
            ),
            ProcessLost { process, .. } => format!(
                "Start the process again, as `trocar up` does by itself: `{}`, ADDR being the GCM's address. Its components are \
                 made anew, and what moves something comes back STOPPED and waits for Resume. `trocar forget {process}` takes \
                 a process that is not wanted any more off the list, with its components.",
                by_hand(process)
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
            ClassNotFound { process, .. } => format!(
                "Take a class of a listed plugin, or put the plugin's .so into the plugin directory of {process}; \
                 `trocar plugin ls {process}` shows what was found there and why a file was refused."
            ),
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
            AlreadyConnected { client, .. } => format!(
                "Disconnect it first (`trocar disconnect {client}`), or let the new connection take its place in one step: \
                 `--replace`, in a request options.replace: true."
            ),
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
            TagMismatch { server, .. } => format!(
                "Connect it to a simulated device's port that is tagged sim; `trocar describe {}` shows the tags of what was asked \
                 for.",
                server.component
            ),
            TruthToActuator { .. } => "Let the controller take what its sensors measure. Recorders, plots and tests may be \
                told the truth, as long as nothing leads from them to an actuator."
                .into(),
            SyncCycle { .. } => "Let one of them run in a thread of its own (execution without stream_of or inside), or \
                leave one of the connections queued (carrier: \"heap\")."
                .into(),
            WrongState { id, state, verb, allowed, .. } => match (verb, state) {
                (Verb::Start | Verb::Resume, State::Fault) => activate(id, State::Fault),
                (_, State::Fault) => format!("Reset it first: `trocar reset {id}`."),
                (Verb::Configure, _) => format!("Stop it first: `trocar stop {id}`."),
                (_, State::Created) => {
                    format!("Configure it first; `trocar describe {id}` shows what is missing.")
                }
                (Verb::Start | Verb::Resume, State::Active) => "It runs already: nothing is left to do.".into(),
                (Verb::Resume, State::Ready) => format!("It has nothing to resume; start it: `trocar start {id}`."),
                _ if allowed.contains(verb) => {
                    format!("Remove what is in its way, then ask again; `trocar describe {id}` shows how it runs.")
                }
                _ => "Ask for one of the allowed verbs.".into(),
            },
            Unconnected { .. } => "Connect each of them, then ask again; or declare the end optional in the class.".into(),
            ConfigInvalid { .. } => "Correct each of the values; `trocar describe CLASS` shows every setting with its unit, \
                limits and default."
                .into(),
            ArgumentInvalid { what, field, .. } => argument_help(what, field),
            ComponentRefused { .. } => "The component's own words say why; correct that and ask again. It is as it was \
                before."
                .into(),
            ComponentFault { id, .. } => format!(
                "Remove the cause, then `trocar reset {id}` and ask again, or create it again where it was not made; `trocar logs` \
                 has the details."
            ),
            NoMemory { id, .. } => format!(
                "Give the outputs a smaller max_bytes (in the plugin, or in the configuration of `{id}` if it decides), or \
                give the process more memory: end others, raise the limit of its container or of `ulimit -v`."
            ),
            Unreachable { .. } => "Look at both processes with `trocar ls`; they must run on one machine, as one user, of one release."
                .into(),
            NoThread { .. } => "Remove components, let several share a thread (stream_of, inside), or raise the limits of \
                `ulimit -u` and of its container; `trocar doctor` shows them."
                .into(),
            InUse { id, .. } => format!(
                "Disconnect those connections (`trocar disconnect ID`) and remove what runs in its thread; or remove it all the same: \
                 `trocar rm --force {id}`."
            ),
            PluginAbi { .. } => "Rebuild the plugin with the trocar-sdk of this host's version.".into(),
            PluginUntrusted { .. } => "Do what the sentence says, or start the host with another trust mode (`--trust`); \
                `trocar plugin inspect FILE` shows hash, owner and permissions."
                .into(),
            PluginBadFile { .. } => "Do what the sentence says, then ask again; `trocar plugin check FILE` tries the file without \
                a host."
                .into(),
            RevisionConflict { .. } => "Read the graph again and decide anew; leave out expected_revision to act on \
                whatever is there."
                .into(),
            NotReached { id, state, wanted, .. } => {
                let longer = "while that is under way, give a longer deadline.";
                let wants = |is_it: fn(&State) -> bool| wanted.iter().any(is_it) && !is_it(state);
                match state {
                    _ if wants(|s| *s == State::Active) => format!("{} Or, {longer}", activate(id, *state)),
                    State::Active if wants(|s| matches!(s, State::Stopped(_))) => {
                        format!("`trocar stop {id}` stops it; {longer}")
                    }
                    State::Active | State::Stopped(_) | State::Fault if wants(|s| *s == State::Ready) => {
                        format!("`trocar reset {id}` makes it READY; {longer}")
                    }
                    _ => format!("`trocar describe {id}` shows how it stands; a longer deadline can be given."),
                }
            }
            EventNotSeen { member, state: State::Active, .. } => {
                format!("`trocar echo {member}` shows when it is sent; a longer deadline can be given.")
            }
            EventNotSeen { member, state, .. } => {
                format!("Only an ACTIVE component sends events. {}", activate(&member.port.component, *state))
            }
            NoSample { port, state: State::Active, .. } => format!(
                "Look what it waits for, e.g. an input without data (`trocar describe {}`); a longer deadline can be given.",
                port.component
            ),
            NoSample { port, state, .. } => {
                format!("Only an ACTIVE component gives samples. {}", activate(&port.component, *state))
            }
            LcmTimeout { process, .. } => format!(
                "What was begun is taken back. Look whether a component hangs or the process is overloaded \
                 (`trocar ls {process}`, `trocar logs`), then ask again; a longer deadline can be given."
            ),
            Busy { .. } => "Ask again when that is done (`trocar logs` tells), or with a longer deadline. Stop waits for no other request."
                .into(),
            Unbound { .. } => "Connect the required interface first.".into(),
            Disabled { member } => format!(
                "Its ports have changed: `trocar describe {}` shows those it has now.",
                member.port.component
            ),
            NotActive { member, state } => activate(&member.port.component, *state),
            WouldBlock { .. } => "Send it without waiting, or let both components share one executor.".into(),
            CommandFailed { member, .. } => format!(
                "The component's own words say why; `trocar describe {member}` shows what the command needs."
            ),
            Deadline { .. } => "Give a longer deadline if the command is slow by nature; otherwise look at the \
                component's health in `trocar ls`."
                .into(),
            PeerLost { .. } => "Look for the process with `trocar ls`; connections return by themselves when it is back, \
                motion waits for Resume."
                .into(),
            Replaced { member } => format!(
                "Nothing, where the newer call was yours; otherwise `trocar describe {}` shows who else is connected: let one of \
                 them command.",
                member.port.component
            ),
            QueueFull { member, .. } => format!(
                "Wait for each answer before the next call, or call again later: its component takes calls at its steps \
                 (`trocar ls {}` shows whether it does). In the class, the policy latest_wins keeps the newest call only.",
                member.port.component
            ),
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

/// The command that starts a process by hand under a GCM that is there.
fn by_hand(process: &Name) -> String {
    format!("trocar host --name {process} --gcm ADDR --listen 127.0.0.1:0 --plugins DIR")
}

/// The command that makes a component ACTIVE that stands so.
fn activate(id: &ComponentId, state: State) -> String {
    match state {
        State::Created => {
            format!("Configure it (`trocar describe {id}` shows what is missing), then `trocar start {id}`.")
        }
        State::Ready | State::Active => format!("Start it: `trocar start {id}`."),
        State::Stopped(_) => format!("Resume it: `trocar resume {id}`."),
        State::Fault => format!("Reset it, then start it: `trocar reset {id}`, `trocar start {id}`."),
    }
}

/// The help for an argument, by the field it is in: only a command's argument has limits that its class
/// declares.
fn argument_help(what: &str, field: &str) -> String {
    match field.split('.').next().unwrap_or_default() {
        "json" | "encoded" if MemberId::parse(what).is_ok() => {
            format!("Correct the value and ask again; `trocar describe {what}` shows units and limits.")
        }
        "execution" => {
            "Correct the setting and ask again; `trocar create --help` lists the settings of an execution."
                .into()
        }
        "options" => {
            "Correct the option and ask again; `trocar connect --help` lists the options of a connection."
                .into()
        }
        _ => "Correct it and ask again.".into(),
    }
}
