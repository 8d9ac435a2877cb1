//! Rows of [`Refusal`](crate::Refusal): calls, their arguments, and who may ask.

macro_rules! calling {
    ($next:ident $($then:ident)*; $($rows:tt)*) => { $next! { $($then)*; $($rows)*

    /// An execution setting or another argument of a request is not acceptable.
    ArgumentInvalid { what: String, why: String, field: String } => {
        code: InvalidArgument, reason: "ARGUMENT_INVALID",
        sentence: format!("{why} ({what})"),
        help: argument_help(what, field),
        metadata: put("what", what).put("field", field),
        violations: [(field.clone(), why.clone())],
        example: ArgumentInvalid {
            what: "ProcessServer/Server/Provided/Write".into(),
            why: beyond_its_limits(),
            field: "json".into(),
        },
    }

    Unbound { member: MemberId } => {
        code: FailedPrecondition, reason: "UNBOUND",
        sentence: format!("`{member}` is not connected to anything"),
        help: "Connect the required interface first.",
        metadata: put("member", member),
        example: Unbound { member: call() },
    }

    Disabled { member: MemberId } => {
        code: FailedPrecondition, reason: "DISABLED",
        sentence: format!("command `{member}` is not among its component's ports any more"),
        help: format!(
            "Its ports have changed: `trocar describe {}` shows those it has now.",
            member.port.component
        ),
        metadata: put("member", member),
        example: Disabled { member: call() },
    }

    NotActive { member: MemberId, state: State } => {
        code: FailedPrecondition, reason: "NOT_ACTIVE",
        sentence: format!("`{member}` cannot run: its component is {state}, not ACTIVE"),
        help: activate(&member.port.component, *state),
        metadata: put("member", member).put("state", state),
        example: NotActive { member: call(), state: State::Stopped(StopReason::Restarted) },
    }

    WouldBlock { member: MemberId } => {
        code: FailedPrecondition, reason: "WOULD_BLOCK",
        sentence: format!("`{member}` would have to wait, which a real-time thread must not do"),
        help: "Send it without waiting, or let both components share one executor.",
        metadata: put("member", member),
        example: WouldBlock { member: call() },
    }

    CommandFailed { member: MemberId, text: String } => {
        code: Aborted, reason: "COMMAND_FAILED",
        sentence: format!("command `{member}` failed: {text}"),
        help: format!(
            "The component's own words say why; `trocar describe {member}` shows what the command needs."
        ),
        metadata: put("member", member).put("text", text),
        example: CommandFailed { member: call(), text: "joint 3 would leave its limit of 0.02 m".into() },
    }

    Deadline { member: MemberId, after_ns: u64, may_still_run: bool } => {
        code: DeadlineExceeded, reason: "DEADLINE",
        sentence: {
            let still = match may_still_run {
                true => "it may still run",
                false => "it was taken back and will not run",
            };
            format!("`{member}` did not finish within {}; {still}", duration(*after_ns))
        },
        help: "Give a longer deadline if the command is slow by nature; otherwise look at the component's \
               health in `trocar ls`.",
        metadata: put("member", member).put("after_ns", after_ns).put("may_still_run", may_still_run),
        example: Deadline { member: call(), after_ns: 1_500_000_000, may_still_run: true },
    }

    PeerLost { member: MemberId } => {
        code: Unavailable, reason: "PEER_LOST",
        sentence: format!("the process or component behind `{member}` is gone"),
        help: "Look for the process with `trocar ls`; connections return by themselves when it is back, \
               motion waits for Resume.",
        metadata: put("member", member),
        example: PeerLost { member: call() },
    }

    /// A newer call took its place before it ran, as the command's policy says.
    Replaced { member: MemberId } => {
        code: Aborted, reason: "REPLACED",
        sentence: format!("a newer call of `{member}` took its place before it ran"),
        help: format!(
            "Nothing, where the newer call was yours; otherwise `trocar describe {}` shows who else is \
             connected: let one of them command.",
            member.port.component
        ),
        metadata: put("member", member),
        example: Replaced { member: call() },
    }

    QueueFull { member: MemberId, depth: usize } => {
        code: ResourceExhausted, reason: "QUEUE_FULL",
        sentence: format!("the queue of `{member}` is full: {depth} calls are waiting already"),
        help: format!(
            "Wait for each answer before the next call, or call again later: its component takes calls at \
             its steps (`trocar ls {}` shows whether it does). In the class, the policy latest_wins keeps \
             the newest call only.",
            member.port.component
        ),
        metadata: put("member", member).put("depth", depth),
        example: QueueFull { member: call(), depth: 16 },
    }

    NotImplemented { what: String, hint: String } => {
        code: Unimplemented, reason: "NOT_IMPLEMENTED",
        sentence: format!("{what} is not in this version"),
        help: match hint.as_str() {
            "" => "Do without it in this version.",
            hint => hint,
        },
        metadata: put("what", what),
        example: NotImplemented {
            what: "a connection between two processes".into(),
            hint: "Create both components in one process.".into(),
        },
    }

    /// A component of this class starts programs, and its process lets none do that.
    ProgramsNotAllowed { process: Name, class: String } => {
        code: PermissionDenied, reason: "PROGRAMS_NOT_ALLOWED",
        sentence: format!(
            "class {class} starts programs as this host's user, and process `{process}` lets no component do \
             that"
        ),
        help: format!(
            "Start `{process}` with --allow-exec, or write \"allow_exec\": true for it into \"processes\" of \
             the system file."
        ),
        metadata: put("process", process).put("class", class),
        example: ProgramsNotAllowed { process: name("host"), class: "stereo/pipe_source".into() },
    }

    /// A change asked by a caller that is neither the host's user nor has that user's token.
    Forbidden {
        what: String,
        /// As the kernel and the caller tell.
        caller: String,
        /// Number of the host's user.
        user: u32,
    } => {
        code: PermissionDenied, reason: "FORBIDDEN",
        sentence: {
            let owner = match user {
                0 => "only root changes".into(),
                _ => format!("only user {user} and root change"),
            };
            format!("{what} is refused to {caller}, who may read: {owner} things here")
        },
        help: format!(
            "Ask as user {user}; or let that user give you what `trocar token` prints, and set TROCAR_TOKEN \
             to it (`trocar`, Python) or send the header `authorization: Bearer TOKEN` (grpcurl -H)."
        ),
        metadata: put("what", what).put("caller", caller).put("user", user),
        example: Forbidden {
            what: "Remove".into(),
            caller: "user 65534 at 127.0.0.1:40404".into(),
            user: 1000,
        },
    }

    /// Something that a certificate does not let its holder do.
    RoleForbidden {
        what: String,
        /// By the certificate.
        caller: String,
        /// Words that the certificate would have to have.
        needs: String,
    } => {
        code: PermissionDenied, reason: "ROLE_FORBIDDEN",
        sentence: format!("{what} is refused to {caller}: it takes a certificate of {needs}"),
        help: "Whoever keeps the authority issues one: `trocar ca issue NAME --role operator` (`--process NAME` for \
               a host); `trocar ca ls` lists those there are.",
        metadata: put("what", what).put("caller", caller).put("needs", needs),
        example: RoleForbidden {
            what: "Remove".into(),
            caller: "operator anna at 10.0.0.7:40404".into(),
            needs: "the role administrator".into(),
        },
    }

    /// The request would change something, and came from a page that only reads.
    ReadOnly { what: String } => {
        code: PermissionDenied, reason: "READ_ONLY",
        sentence: format!("{what} changes something, and this viewer only reads"),
        help: "Ask with `trocar` or grpcurl, or start the program without --viewer-read-only.",
        metadata: put("what", what),
        example: ReadOnly { what: "Remove".into() },
    }

    Internal { text: String } => {
        code: Internal, reason: "INTERNAL",
        sentence: format!("trocar itself made a mistake: {text}"),
        help: "Please report it with the log; nothing was changed on purpose.",
        metadata: put("text", text),
        example: Internal { text: "the plan left a connection without a client".into() },
    }

    } };
}
