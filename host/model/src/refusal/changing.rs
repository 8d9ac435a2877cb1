//! Rows of [`Refusal`](crate::Refusal): what was asked for cannot be done now, or was not done in time.

macro_rules! changing {
    ($next:ident $($then:ident)*; $($rows:tt)*) => { $next! { $($then)*; $($rows)*

    WrongState { id: ComponentId, state: State, verb: Verb, allowed: Vec<Verb>, why: String } => {
        code: FailedPrecondition, reason: "WRONG_STATE",
        sentence: {
            let others: Vec<_> = allowed.iter().filter(|other| *other != verb).collect();
            format!(
                "{verb} of `{id}` is not allowed in state {state}{}{}",
                unless_empty(": ", why),
                unless_none("; allowed are ", &others)
            )
        },
        help: match (verb, state) {
            (Verb::Start | Verb::Resume, State::Fault) => activate(id, State::Fault),
            (_, State::Fault) => format!("Reset it first: `trocar reset {id}`."),
            (Verb::Configure, _) => format!("Stop it first: `trocar stop {id}`."),
            (_, State::Created) => {
                format!("Configure it first; `trocar describe {id}` shows what is missing.")
            }
            (Verb::Start | Verb::Resume, State::Active) => "It runs already: nothing is left to do.".into(),
            (Verb::Resume, State::Ready) => {
                format!("It has nothing to resume; start it: `trocar start {id}`.")
            }
            _ if allowed.contains(verb) => format!(
                "Remove what is in its way, then ask again; `trocar describe {id}` shows how it runs."
            ),
            _ => "Ask for one of the allowed verbs.".into(),
        },
        metadata: put("component", id).put("state", state).put("verb", verb).list("allowed", allowed),
        example: WrongState {
            id: robot(),
            state: State::Fault,
            verb: Verb::Start,
            allowed: allowed(State::Fault),
            why: String::new(),
        },
    }

    /// Start or Resume while required ends are open.
    Unconnected { id: ComponentId, verb: Verb, ports: Vec<String> } => {
        code: FailedPrecondition, reason: "UNCONNECTED",
        sentence: format!(
            "`{id}` cannot {}: {} {} not connected",
            verb.to_string().to_lowercase(),
            list(ports),
            is_are(ports.len())
        ),
        help: "Connect each of them, then ask again; or declare the end optional in the class.",
        metadata: put("component", id).put("verb", verb).list("ports", ports),
        example: Unconnected { id: id("host/bscan"), verb: Verb::Start, ports: texts(&["robot", "ascan"]) },
    }

    ConfigInvalid { id: ComponentId, violations: Vec<Violation> } => {
        code: InvalidArgument, reason: "CONFIG_INVALID",
        sentence: {
            let messages: Vec<&str> = violations.iter().map(|v| v.message.as_str()).collect();
            format!("the configuration of `{id}` is not valid: {}", clauses(&messages))
        },
        help: "Correct each of the values; `trocar describe CLASS` shows every setting with its unit, limits \
               and default.",
        metadata: put("component", id),
        violations: violations.iter().map(|v| (format!("config{}", v.pointer), v.message.clone())),
        example: ConfigInvalid {
            id: id("host/filter"),
            violations: vec![Violation {
                pointer: "/cutoff_hz".into(),
                message: "cutoff_hz: 1000 Hz is above 400 Hz".into(),
            }],
        },
    }

    ComponentRefused { id: ComponentId, entry: &'static str, text: String } => {
        code: FailedPrecondition, reason: "COMPONENT_REFUSED",
        sentence: format!("`{id}` refused to {entry}: {text}"),
        help: "The component's own words say why; correct that and ask again. It is as it was before.",
        metadata: put("component", id).put("entry", entry).put("text", text),
        example: ComponentRefused {
            id: robot(),
            entry: "configure",
            text: "port /dev/ttyUSB1 is busy".into(),
        },
    }

    ComponentFault { id: ComponentId, text: String } => {
        code: Internal, reason: "COMPONENT_FAULT",
        sentence: format!("`{id}` is in FAULT: {text}"),
        help: format!(
            "Remove the cause, then `trocar reset {id}` and ask again, or create it again where it was not \
             made; `trocar logs` has the details."
        ),
        metadata: put("component", id).put("text", text),
        example: ComponentFault { id: robot(), text: "panic in step: index out of bounds".into() },
    }

    /// There is no memory for the frames of these outputs: `bytes` were asked for, `why` says what there is.
    NoMemory { id: ComponentId, outputs: Vec<String>, bytes: u64, why: String } => {
        code: ResourceExhausted, reason: "NO_MEMORY",
        sentence: format!("`{id}` asks for {bytes} bytes for the frames of {}: {why}", list(outputs)),
        help: format!(
            "Give the outputs a smaller max_bytes (in the plugin, or in the configuration of `{id}` if it \
             decides), or give the process more memory: end others, raise the limit of its container or of \
             `ulimit -v`."
        ),
        metadata: put("component", id).list("outputs", outputs).put("bytes", bytes).put("why", why),
        example: NoMemory {
            id: id("host/camera"),
            outputs: texts(&["left", "right"]),
            bytes: 17_179_869_184,
            why: "8392286208 bytes of memory are available, an eighth of which must stay free".into(),
        },
    }

    /// The processes of a connection's ends cannot be linked.
    Unreachable { client: PortId, server: PortId, why: String } => {
        code: Unavailable, reason: "UNREACHABLE",
        sentence: format!("`{client}` cannot be connected to `{server}` in another process: {why}"),
        help: "Look at both processes with `trocar ls`; on one machine they must run as one user, of one \
               release; between machines each needs an identity (docs/MACHINES.md).",
        metadata: ends(client, server).put("why", why),
        example: Unreachable {
            client: port("gui/viewer/image"),
            server: port("host/camera/frames"),
            why: "nobody answers at /run/trocar/host/links.sock".into(),
        },
    }

    /// The machine gives no thread for it.
    NoThread { id: ComponentId, why: String } => {
        code: ResourceExhausted, reason: "NO_THREAD",
        sentence: format!("the machine gives no thread for `{id}`: {why}"),
        help: "Remove components, let several share a thread (stream_of, inside), or raise the limits of \
               `ulimit -u` and of its container; `trocar doctor` shows them.",
        metadata: put("component", id).put("why", why),
        example: NoThread { id: id("host/camera"), why: "Resource temporarily unavailable".into() },
    }

    InUse { id: ComponentId, by: Vec<String> } => {
        code: FailedPrecondition, reason: "IN_USE",
        sentence: format!("`{id}` is in use by {}", list(by)),
        help: format!(
            "Disconnect those connections (`trocar disconnect ID`) and remove what runs in its thread; or \
             remove it all the same: `trocar rm --force {id}`."
        ),
        metadata: put("component", id).list("by", by),
        example: InUse { id: robot(), by: texts(&["connection 3 (host/robot/arm → host/bscan/robot)"]) },
    }

    PluginAbi { file: String, text: String } => {
        code: FailedPrecondition, reason: "PLUGIN_ABI",
        sentence: format!("plugin `{file}` does not fit this host: {}", without_file(file, text)),
        help: "Rebuild the plugin with the trocar-sdk of this host's version.",
        metadata: put("file", file).put("text", text),
        example: PluginAbi {
            file: "libtrocar_old.so".into(),
            text: "it speaks ABI 2, this host speaks ABI 1".into(),
        },
    }

    PluginUntrusted { file: String, text: String } => {
        code: FailedPrecondition, reason: "PLUGIN_UNTRUSTED",
        sentence: format!("plugin `{file}` is not trusted: {}", without_file(file, text)),
        help: "Do what the sentence says, or start the host with another trust mode (`--trust`); `trocar \
               plugin inspect FILE` shows hash, owner and permissions.",
        metadata: put("file", file).put("text", text),
        example: PluginUntrusted {
            file: "libtrocar_sine.so".into(),
            text: "its hash is not on the allow-list".into(),
        },
    }

    PluginBadFile { file: String, text: String } => {
        code: FailedPrecondition, reason: "PLUGIN_BAD_FILE",
        sentence: format!("`{file}` is not a usable plugin: {}", without_file(file, text)),
        help: "Do what the sentence says, then ask again; `trocar plugin check FILE` tries the file without \
               a host.",
        metadata: put("file", file).put("text", text),
        example: PluginBadFile {
            file: "libtrocar_sine.so".into(),
            text: "it ends at byte 4096, but its header claims 548352 bytes".into(),
        },
    }

    RevisionConflict { expected: u64, actual: u64 } => {
        code: Aborted, reason: "REVISION_CONFLICT",
        sentence: format!(
            "the request was made for revision {expected}, but the graph is at revision {actual}"
        ),
        help: "Read the graph again and decide anew; leave out expected_revision to act on whatever is \
               there.",
        metadata: put("expected", expected).put("actual", actual),
        example: RevisionConflict { expected: 41, actual: 42 },
    }

    /// WaitFor: none of the wanted states came in time.
    NotReached { id: ComponentId, state: State, wanted: Vec<State>, after_ns: u64 } => {
        code: DeadlineExceeded, reason: "NOT_REACHED",
        sentence: {
            let wanted: Vec<String> = wanted.iter().map(ToString::to_string).collect();
            let waited = duration(*after_ns);
            format!("`{id}` is {state} and did not become {} within {waited}", wanted.join(" or "))
        },
        help: {
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
        },
        metadata: put("component", id).put("state", state).list("wanted", wanted).put("after_ns", after_ns),
        example: NotReached {
            id: robot(),
            state: State::Ready,
            wanted: vec![State::Active],
            after_ns: 2_000_000_000,
        },
    }

    /// WaitFor: the event did not come in time. `state` is that of the component then.
    EventNotSeen { member: MemberId, state: State, after_ns: u64 } => {
        code: DeadlineExceeded, reason: "EVENT_NOT_SEEN",
        sentence: format!(
            "event `{member}` did not come within {}; its component is {state}",
            duration(*after_ns)
        ),
        help: match state {
            State::Active => {
                format!("`trocar echo {member}` shows when it is sent; a longer deadline can be given.")
            }
            _ => {
                let component = &member.port.component;
                format!("Only an ACTIVE component sends events. {}", activate(component, *state))
            }
        },
        metadata: put("member", member).put("state", state).put("after_ns", after_ns),
        example: EventNotSeen {
            member: member("host/robot/arm/operating_state"),
            state: State::Active,
            after_ns: 2_000_000_000,
        },
    }

    /// Read: an output gave no sample in time. `state` is that of its component then.
    NoSample { port: PortId, state: State, after_ns: u64 } => {
        code: DeadlineExceeded, reason: "NO_SAMPLE",
        sentence: format!(
            "output `{port}` gave no sample within {}; its component is {state}",
            duration(after_ns / 1_000_000 * 1_000_000)
        ),
        help: match state {
            State::Active => format!(
                "Look what it waits for, e.g. an input without data (`trocar describe {}`); a longer \
                 deadline can be given.",
                port.component
            ),
            _ => format!("Only an ACTIVE component gives samples. {}", activate(&port.component, *state)),
        },
        metadata: put("port", port).put("state", state).put("after_ns", after_ns),
        example: NoSample { port: port("host/sensor/force"), state: State::Ready, after_ns: 2_000_000_000 },
    }

    /// The process, or a component of it, was not done before the deadline.
    LcmTimeout { process: Name, what: String } => {
        code: DeadlineExceeded, reason: "LCM_TIMEOUT",
        sentence: format!("process `{process}` was not done in time with this: {what}"),
        help: format!(
            "What was begun is taken back. Look whether a component hangs or the process is overloaded \
             (`trocar ls {process}`, `trocar logs`), then ask again; a longer deadline can be given."
        ),
        metadata: put("process", process).put("what", what),
        example: LcmTimeout { process: name("host"), what: "Start host/robot".into() },
    }

    /// Another request had what this one needs until its deadline; the same request may be under way under
    /// its id. This one leaves nothing changed.
    Busy { doing: String } => {
        code: DeadlineExceeded, reason: "BUSY",
        sentence: format!("the request did not get its turn in time: {doing} is still being carried out"),
        help: "Ask again when that is done (`trocar logs` tells), or with a longer deadline. Stop waits for \
               no other request.",
        metadata: put("doing", doing),
        example: Busy { doing: "Start host/robot".into() },
    }

    /// A later part of a request, which could be planned only after the first was done, needs what another
    /// request has. This one does not wait for it, and leaves nothing changed.
    PartTaken { doing: String } => {
        code: Aborted, reason: "PART_TAKEN",
        sentence: format!(
            "a later part of the request needs what another one has, so all of it was taken back: {doing} is \
             still being carried out"
        ),
        help: "Ask again when that is done (`trocar logs` tells). Or ask in two requests, the second one \
               beginning with the connection of a port that the first one makes: that one waits its turn.",
        metadata: put("doing", doing),
        example: PartTaken { doing: "Start host/robot".into() },
    }

    } };
}
