//! Rows of [`Refusal`](crate::Refusal): two ends that do not go together.

macro_rules! connecting {
    ($next:ident $($then:ident)*; $($rows:tt)*) => { $next! { $($then)*; $($rows)*

    /// Client and server are swapped, or both are of the same direction.
    WrongDirection { client: PortId, client_is: &'static str, server: PortId, server_is: &'static str } => {
        code: InvalidArgument, reason: "WRONG_DIRECTION",
        sentence: format!(
            "`{client}` is {client_is} and `{server}` is {server_is}, which do not go together as client and \
             server"
        ),
        help: {
            let swapped = matches!(*client_is, "an output" | "a provided interface")
                && matches!(*server_is, "an input" | "a required interface");
            let first = if swapped { "Exchange client and server. " } else { "" };
            format!(
                "{first}An input (client) takes an output (server); a required interface (client) takes a \
                 provided interface (server)."
            )
        },
        metadata: ends(client, server).put("client_is", client_is).put("server_is", server_is),
        violations: [
            ("client".to_owned(), format!("it is {client_is}")),
            ("server".to_owned(), format!("it is {server_is}")),
        ],
        example: WrongDirection {
            client: server(),
            client_is: "a provided interface",
            server: client(),
            server_is: "a required interface",
        },
    }

    AlreadyConnected { client: PortId, server: PortId } => {
        code: AlreadyExists, reason: "ALREADY_CONNECTED",
        sentence: format!("`{client}` is already connected, to `{server}`"),
        help: format!(
            "Disconnect it first (`trocar disconnect {client}`), or let the new connection take its place in \
             one step: `--replace`, in a request options.replace: true."
        ),
        metadata: ends(client, server),
        example: AlreadyConnected { client: client(), server: port("host/phantom/arm") },
    }

    ConnectionExists { id: u64, client: PortId, server: PortId } => {
        code: AlreadyExists, reason: "CONNECTION_EXISTS",
        sentence: format!("`{client}` is already connected to `{server}`: that is connection {id}"),
        help: format!(
            "Nothing is left to do; to change its options connect with `--replace`, to undo it `trocar \
             disconnect {id}`."
        ),
        metadata: put("id", id).ends(client, server),
        example: ConnectionExists { id: 3, client: client(), server: server() },
    }

    CommandMissing { client: PortId, server: PortId, function: String, known: Vec<String> } => {
        code: FailedPrecondition, reason: "COMMAND_MISSING",
        sentence: format!(
            "`{client}` needs `{function}`, which `{server}` does not offer{}",
            choices(function, known)
        ),
        help: format!(
            "Connect to an interface that offers it (`trocar describe {}`), or make the function (or \
             handler) optional in the client's class.",
            server.component
        ),
        metadata: ends(client, server).put("function", function).known(function, known),
        example: CommandMissing {
            client: client(),
            server: server(),
            function: "servo_jq".into(),
            known: texts(&["hold", "measured_cp", "servo_jp"]),
        },
    }

    CommandKindMismatch { client: PortId, server: PortId, function: String, wants: String, has: String } => {
        code: FailedPrecondition, reason: "COMMAND_KIND_MISMATCH",
        sentence: format!(
            "`{function}` is wanted by `{client}` as {wants}, but `{server}` offers it as {has}"
        ),
        help: "Declare the function in the client's class with the argument and result the command has: \
               `Function<()>` for a command without an argument (void), `Function<T>` for one that takes a T \
               (write), and with a result for reads and commands that return one.",
        metadata: ends(client, server).put("function", function).put("wants", wants).put("has", has),
        example: CommandKindMismatch {
            client: client(),
            server: server(),
            function: "hold".into(),
            wants: "write (f64)".into(),
            has: "void".into(),
        },
    }

    /// `difference` names the first difference by field.
    TypeMismatch { client: PortId, server: PortId, what: String, difference: String } => {
        code: FailedPrecondition, reason: "TYPE_MISMATCH",
        sentence: format!("the {what} of `{client}` (here) and `{server}` (there) differ: {difference}"),
        help: {
            let adapt = match difference.ends_with(ADAPTABLE) {
                true => " Or ask with adapt: true: the fields only moved.",
                false => "",
            };
            format!(
                "Build both plugins against the same payload type, or put a converting component between \
                 them.{adapt}"
            )
        },
        metadata: ends(client, server).put("what", what).put("difference", difference),
        example: TypeMismatch {
            client: input(),
            server: output(),
            what: "samples".into(),
            difference: "field `f[…]` has unit N here and unit mN there".into(),
        },
    }

    FormatMismatch { client: PortId, server: PortId, wants: String, has: String } => {
        code: FailedPrecondition, reason: "FORMAT_MISMATCH",
        sentence: format!("`{client}` takes {wants}, but `{server}` gives {has}"),
        help: "Put a filter between them that converts, or set the server's format in its configuration.",
        metadata: ends(client, server).put("wants", wants).put("has", has),
        example: FormatMismatch {
            client: input(),
            server: output(),
            wants: "frames of \"image\"".into(),
            has: "frames of \"spectra\"".into(),
        },
    }

    /// A port for simulated devices only, and one that is not.
    TagMismatch { client: PortId, server: PortId, has: Tag } => {
        code: FailedPrecondition, reason: "TAG_MISMATCH",
        sentence: {
            let has = match has {
                Tag::None => "has no tag".into(),
                tag => format!("is tagged {}", tag.name()),
            };
            format!("`{client}` is tagged sim and takes only what is, too, but `{server}` {has}")
        },
        help: format!(
            "Connect it to a simulated device's port that is tagged sim; `trocar describe {}` shows the tags \
             of what was asked for.",
            server.component
        ),
        metadata: ends(client, server).put("has", if *has == Tag::None { "none" } else { has.name() }),
        example: TagMismatch { client: input(), server: output(), has: Tag::None },
    }

    /// Data of `server` would reach an actuator; `path` leads from the client to it.
    TruthToActuator { client: PortId, server: PortId, tag: Tag, path: Vec<ComponentId> } => {
        code: FailedPrecondition, reason: "TRUTH_TO_ACTUATOR",
        sentence: format!(
            "`{server}` is tagged {}, and what it tells `{client}` would reach an actuator: {}",
            tag.name(),
            route(path)
        ),
        help: "Let the controller take what its sensors measure. Recorders, plots and tests may be told the \
               truth, as long as nothing leads from them to an actuator.",
        metadata: ends(client, server).put("tag", tag.name()).list("path", path),
        example: TruthToActuator {
            client: input(),
            server: output(),
            tag: Tag::Truth,
            path: vec![id("host/bscan"), id("host/robot")],
        },
    }

    SyncCycle { path: Vec<ComponentId> } => {
        code: FailedPrecondition, reason: "SYNC_CYCLE",
        sentence: format!(
            "the components would call each other in a circle, in one thread: {}",
            route(path)
        ),
        help: "Let one of them run in a thread of its own (execution without stream_of or inside), or leave \
               one of the connections queued (carrier: \"heap\").",
        metadata: Metadata::default().list("path", path),
        example: SyncCycle { path: vec![id("host/gray"), id("host/resize"), id("host/gray")] },
    }

    } };
}
