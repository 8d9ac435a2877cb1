//! Rows of [`Refusal`](crate::Refusal): names that are not there, or are there already.

macro_rules! naming {
    ($next:ident $($then:ident)*; $($rows:tt)*) => { $next! { $($then)*; $($rows)*

    BadPath { text: String, why: String } => {
        code: InvalidArgument, reason: "BAD_PATH",
        sentence: format!("`{}` is not a path: {why}", brief(text)),
        help: "Write a path as process/component/interface/command, as far as it is needed, without a slash \
               in front. Names begin with a letter or _ and hold letters, digits, _ . and -. Start, Stop, \
               Resume, Reset and List also take patterns: * is any part of a name, ** everything below.",
        metadata: put("text", text),
        violations: [("path".to_owned(), why.clone())],
        example: BadPath {
            text: "/host/robot".into(),
            why: "it begins with a slash; wanted process/component".into(),
        },
    }

    ProcessNotFound { process: Name, known: Vec<Name> } => {
        code: NotFound, reason: "PROCESS_NOT_FOUND",
        sentence: format!("there is no process `{process}`{}", choices(process.as_str(), known)),
        help: format!(
            "Use one of the processes listed by `trocar ls`, or start it under this GCM, whose address ADDR \
             is: `{}`.",
            by_hand(process)
        ),
        metadata: put("process", process).known(process.as_str(), known),
        example: ProcessNotFound { process: name("hots"), known: vec![name("gui"), name("host")] },
    }

    /// The process is known and cannot be asked. `state` says what becomes of it, `last_exit` how it ended;
    /// "" when that is unknown.
    ProcessLost { process: Name, state: ProcessState, last_exit: String } => {
        code: Unavailable, reason: "PROCESS_LOST",
        sentence: {
            let ended = unless_empty(": it ", &brief(last_exit));
            match state {
                ProcessState::Restarting => format!(
                    "process `{process}` is being restarted{ended}; it is not there yet, or not all of its \
                     components are"
                ),
                ProcessState::Failed => {
                    format!("process `{process}` has failed and is not started again{ended}")
                }
                ProcessState::Lost | ProcessState::Attached if !last_exit.is_empty() => {
                    format!("process `{process}` has ended{ended}")
                }
                ProcessState::Lost | ProcessState::Attached => {
                    format!("process `{process}` is lost: it is known but does not answer")
                }
            }
        },
        help: match state {
            ProcessState::Restarting => {
                "Ask again in a moment: its supervisor starts it and its components are made anew; what \
                 moves something then is STOPPED and waits for Resume. `trocar ls` shows when it is ATTACHED."
                    .into()
            }
            ProcessState::Failed => format!(
                "Correct what ends it: `trocar ls` shows how it ended, {process}.output.log in its \
                 supervisor's state directory has what it printed, `trocar rm --force COMPONENT` removes a \
                 component of it. Then `trocar restart {process}`, or `trocar forget {process}` when it is \
                 not wanted any more."
            ),
            ProcessState::Lost | ProcessState::Attached => format!(
                "Start the process again, as `trocar up` does by itself: `{}`, ADDR being the GCM's address. \
                 Its components are made anew, and what moves something comes back STOPPED and waits for \
                 Resume. `trocar forget {process}` takes a process that is not wanted any more off the list, \
                 with its components.",
                by_hand(process)
            ),
        },
        metadata: put("process", process).put("state", state).put_unless_empty("last_exit", last_exit),
        example: ProcessLost {
            process: name("host"),
            state: ProcessState::Restarting,
            last_exit: "was killed by SIGSEGV (core dumped)".into(),
        },
    }

    /// The component was to be stopped and may be moving; `why`: its process cannot be told.
    StopNotTold { id: ComponentId, why: String } => {
        code: Unavailable, reason: "STOP_NOT_TOLD",
        sentence: format!("{id} could not be told to stop and may be moving: {}", brief(why)),
        help: format!(
            "The Stop is noted: {id} is stopped as soon as its process is heard, and does not move again by \
             itself. What it does until then must be stopped at its machine, by its emergency stop or its \
             power. `trocar ls` shows when process {} is ATTACHED.",
            id.process
        ),
        metadata: put("path", id).put("why", why),
        example: StopNotTold {
            id: id("host/robot"),
            why: "process `host` is lost: it is known but does not answer".into(),
        },
    }

    /// No supervisor is there that would make a process beside this one; `known`: those that a supervisor
    /// keeps.
    NotSupervised { process: Name, known: Vec<Name> } => {
        code: FailedPrecondition, reason: "NOT_SUPERVISED",
        sentence: format!(
            "process `{process}` has no supervisor, which would start it again or make another process \
             beside it{}",
            unless_none("; there is one of ", known)
        ),
        help: format!(
            "Bring the system up with `trocar up FILE`, whose processes have a supervisor, and ask there. \
             Without one, end and start the process by hand (`{}`, ADDR being the GCM's address), and create \
             the component without isolation: it is then made in {process}.",
            by_hand(process)
        ),
        metadata: put("process", process).list("known", known),
        example: NotSupervised { process: name("host"), known: vec![name("gui")] },
    }

    /// An agent keeps processes of the system for somebody who is heard.
    SystemKept { system: Name, caller: String } => {
        code: AlreadyExists, reason: "SYSTEM_KEPT",
        sentence: format!("the agent keeps processes of the system `{system}` already, for {}", brief(caller)),
        help: format!(
            "Take that one down where it was brought up (`trocar down {system}`), or bring yours up under \
             another name: `trocar up FILE --name NAME`."
        ),
        metadata: put("system", system).put("caller", caller),
        example: SystemKept { system: name("bscan"), caller: "gcm or1 at 10.0.0.1:40112".into() },
    }

    /// A process that was to be made for a component.
    ProcessNotUp { process: Name, why: String } => {
        code: Unavailable, reason: "PROCESS_NOT_UP",
        sentence: format!("process `{process}` did not come up: {}", brief(why)),
        help: format!(
            "What it printed is in {process}.output.log of its supervisor's state directory; correct that \
             and ask again. One that was to be made for a component alone is gone, and the component can be \
             created without isolation."
        ),
        metadata: put("process", process).put("why", why),
        example: ProcessNotUp { process: name("host.robot"), why: "it was killed by SIGKILL".into() },
    }

    /// The process was to be forgotten, and has not ended.
    ProcessRuns { process: Name, state: ProcessState, pid: u32 } => {
        code: FailedPrecondition, reason: "PROCESS_RUNS",
        sentence: {
            let stands = match state {
                ProcessState::Restarting => "is being started again".into(),
                _ => format!("runs (pid {pid})"),
            };
            format!("process `{process}` {stands}: only one that has ended is forgotten")
        },
        help: match state {
            ProcessState::Restarting => format!(
                "Wait until `trocar ls` shows it ATTACHED or FAILED. Take it out of its system file and \
                 bring the system up again when {process} is not to come back."
            ),
            _ => format!(
                "End it first: Ctrl-C in its terminal, `kill {pid}`, or `trocar down` for a whole system; \
                 then ask again."
            ),
        },
        metadata: put("process", process).put("state", state).put("pid", pid),
        example: ProcessRuns { process: name("host"), state: ProcessState::Attached, pid: 4242 },
    }

    /// The name is held by a process that answers.
    ProcessExists { process: Name, endpoint: String, pid: u32 } => {
        code: AlreadyExists, reason: "PROCESS_EXISTS",
        sentence: format!(
            "the name `{process}` is taken by a process that answers (pid {pid}{})",
            unless_empty(", listening on ", endpoint)
        ),
        help: format!(
            "Use the one that runs, or end it first (`kill {pid}`). A second one beside it needs an address \
             of its own (`--listen 127.0.0.1:0`) and, under the same GCM, another name (`--name`)."
        ),
        metadata: put("process", process).put("endpoint", endpoint).put("pid", pid),
        example: ProcessExists { process: name("host"), endpoint: "127.0.0.1:50551".into(), pid: 4242 },
    }

    /// `elsewhere`: processes that have it; `ambiguous`: full names the short name could mean.
    ClassNotFound {
        process: Name,
        class: String,
        known: Vec<String>,
        elsewhere: Vec<Name>,
        ambiguous: Vec<String>,
    } => {
        code: NotFound, reason: "CLASS_NOT_FOUND",
        sentence: match ambiguous.as_slice() {
            [] => format!(
                "process `{process}` has no class `{}`{}{}",
                brief(class),
                choices(class, known),
                unless_none("; it is available in ", elsewhere)
            ),
            several => {
                format!("class `{}` could be any of {} in process `{process}`", brief(class), list(several))
            }
        },
        help: match ambiguous.as_slice() {
            [] => format!(
                "Take a class of a listed plugin, or put the plugin's .so into the plugin directory of \
                 {process}; `trocar plugin ls {process}` shows what was found there and why a file was \
                 refused."
            ),
            _ => "Write the class with its plugin in front, as plugin/class.".into(),
        },
        metadata: put("process", process)
            .put("class", class)
            .known(class, known)
            .list("elsewhere", elsewhere)
            .list("ambiguous", ambiguous),
        example: ClassNotFound {
            process: name("host"),
            class: "eyerobt".into(),
            known: texts(&["eyerobot", "sine"]),
            elsewhere: vec![name("gui")],
            ambiguous: vec![],
        },
    }

    ComponentExists { id: ComponentId } => {
        code: AlreadyExists, reason: "COMPONENT_EXISTS",
        sentence: format!("component `{id}` exists already"),
        help: format!(
            "Take another name, or remove it first: `trocar rm {id}`. Configure changes it in place."
        ),
        metadata: put("component", id),
        example: ComponentExists { id: id("host/robot") },
    }

    ComponentNotFound { id: ComponentId, known: Vec<ComponentId> } => {
        code: NotFound, reason: "COMPONENT_NOT_FOUND",
        sentence: format!("there is no component `{id}`{}", choices(&id.to_string(), known)),
        help: "Use a component listed by `trocar ls`, or create it first.",
        metadata: put("component", id).known(&id.to_string(), known),
        example: ComponentNotFound { id: id("host/robt"), known: vec![id("host/ascan"), id("host/robot")] },
    }

    /// A glob that matches nothing.
    NothingMatches { pattern: String, known: Vec<ComponentId> } => {
        code: NotFound, reason: "NOTHING_MATCHES",
        sentence: format!("no component matches `{}`{}", brief(pattern), choices(pattern, known)),
        help: "Check the pattern against `trocar ls`: * stays within one part of the path, process/** means \
               everything in a process.",
        metadata: put("pattern", pattern).known(pattern, known),
        example: NothingMatches { pattern: "gui/**".into(), known: vec![id("host/robot")] },
    }

    InterfaceNotFound { port: PortId, known: Vec<String> } => {
        code: NotFound, reason: "INTERFACE_NOT_FOUND",
        sentence: format!(
            "component `{}` has no interface, input or output `{}`{}",
            port.component,
            port.port,
            choices(port.port.as_str(), known)
        ),
        help: format!("`trocar describe {}` shows its interfaces, inputs and outputs.", port.component),
        metadata: put("port", port).known(port.port.as_str(), known),
        example: InterfaceNotFound { port: port("host/robot/amr"), known: texts(&["arm", "tip"]) },
    }

    MemberNotFound { member: MemberId, known: Vec<String> } => {
        code: NotFound, reason: "MEMBER_NOT_FOUND",
        sentence: format!(
            "`{}` has no `{}`{}",
            member.port,
            member.member,
            choices(member.member.as_str(), known)
        ),
        help: format!("`trocar describe {}` shows the commands and events.", member.port.component),
        metadata: put("member", member).known(member.member.as_str(), known),
        example: MemberNotFound {
            member: member("host/robot/arm/servo_jo"),
            known: texts(&["hold", "measured_cp", "servo_jp"]),
        },
    }

    /// The member is there, but is something else than what was asked of it: `is` "a read command", `wanted`
    /// "an event".
    WrongKind { member: MemberId, is: String, wanted: String } => {
        code: InvalidArgument, reason: "WRONG_KIND",
        sentence: format!("`{member}` is {is}, not {wanted}"),
        help: match is.ends_with("command") {
            true => format!("Call it: `trocar call {member}`."),
            false => format!("Follow it: `trocar echo {member}`."),
        },
        metadata: put("member", member).put("is", is).put("wanted", wanted),
        example: WrongKind {
            member: member("host/robot/arm/measured_cp"),
            is: "a read command".into(),
            wanted: "an event".into(),
        },
    }

    /// This port belongs to a process that another GCM manages.
    ManagedElsewhere { at: String } => {
        code: FailedPrecondition, reason: "MANAGED_ELSEWHERE",
        sentence: format!("this process is managed by the GCM at {at}"),
        help: format!("Ask there: `--gcm {at}`, or grpcurl with that address."),
        metadata: put("gcm", at),
        example: ManagedElsewhere { at: "127.0.0.1:50551".into() },
    }

    /// Several GCMs stand for one system, and this one does not decide. `leader` is empty where nobody knows
    /// who does; `why` then says what is known.
    NotLeader { leader: String, why: String } => {
        code: Unavailable, reason: "NOT_LEADER",
        sentence: match leader.as_str() {
            "" => format!("this GCM does not lead its system: {why}"),
            leader => format!("this GCM does not lead its system: the GCM at {leader} does"),
        },
        help: match leader.as_str() {
            "" => "Ask again in a moment: with the addresses of all GCMs, `--gcm A,B,C`, trocar finds the one that leads.".to_owned(),
            leader => format!("Ask there: `--gcm {leader}`. With the addresses of all GCMs, `--gcm A,B,C`, trocar finds the one that leads."),
        },
        metadata: put("leader", leader),
        example: NotLeader { leader: "127.0.0.1:50552".into(), why: String::new() },
    }

    /// Several GCMs stand for one system, and what this one decides is not on record: another would not know
    /// it.
    JournalUnavailable {
        /// True: it was done nevertheless, or may yet be on record.
        carried_out: bool,
        why: String,
    } => {
        code: Unavailable, reason: "JOURNAL_UNAVAILABLE",
        sentence: match carried_out {
            true => format!("it was carried out, but nobody knows whether it is on record: {why}"),
            false => format!("nothing was changed, since nothing can be put on record: {why}"),
        },
        help: match carried_out {
            true => "See with `trocar ls` what is so when a GCM leads again; what is not on record is taken back then.",
            false => "Ask again when the journal can be written; a Stop works meanwhile.",
        },
        metadata: put("carried_out", carried_out).put("why", why),
        example: JournalUnavailable { carried_out: false, why: "etcd gave no answer within 2000 ms".into() },
    }

    /// No plugin or class of that name in any process.
    PluginNotFound { name: String, known: Vec<String> } => {
        code: NotFound, reason: "PLUGIN_NOT_FOUND",
        sentence: format!(
            "there is no plugin or class \"{}\" in any process{}",
            brief(name),
            choices(name, known)
        ),
        help: "`trocar plugin ls` lists every plugin and why a file was refused.",
        metadata: put("name", name).known(name, known),
        example: PluginNotFound { name: "eyerobt".into(), known: texts(&["eyerobot", "filters"]) },
    }

    ConnectionNotFound { asked: String, known: Vec<String> } => {
        code: NotFound, reason: "CONNECTION_NOT_FOUND",
        sentence: {
            let there = match known.as_slice() {
                [] => "there are none".into(),
                [one] => format!("there is connection {one}"),
                several => format!("there are connections {}", list(several)),
            };
            format!("there is no connection {}; {there}", brief(asked))
        },
        help: "`trocar ls` lists the connections with their numbers.",
        metadata: put("asked", asked).list("known", known),
        example: ConnectionNotFound {
            asked: "7".into(),
            known: texts(&["3: host/robot/arm → host/bscan/robot"]),
        },
    }

    } };
}
