//! Connect and Disconnect: what fits, and every way in which two ends do not.

use trocar_model::*;

use crate::scene::*;

fn options(f: impl FnOnce(&mut ConnectOptions)) -> ConnectOptions {
    let mut options = ConnectOptions::default();
    f(&mut options);
    options
}

fn with(client: &str, server: &str, options: ConnectOptions) -> Request {
    Request::Connect { client: port(client), server: port(server), options }
}

/// Binds required `r` with `function` to provided `p` with `command`.
fn bind(function: Function, command: Command) -> Result<Link, Refusal> {
    let client = Ports { required: vec![required("r", vec![function], vec![])], ..Ports::default() };
    let server = Ports { provided: vec![provided("p", vec![command], vec![])], ..Ports::default() };
    bindings(&client, &port("a/c/r"), &server, &port("a/s/p"), &ConnectOptions::default())
}

fn stream(client: PortType, server: PortType, adapt: bool) -> Result<Link, Refusal> {
    let client = Ports { inputs: vec![input("i", client)], ..Ports::default() };
    let server = Ports { outputs: vec![output("o", server)], ..Ports::default() };
    bindings(&client, &port("a/c/i"), &server, &port("a/s/o"), &options(|o| o.adapt = adapt))
}

#[test]
fn members_bind_by_name_with_numbers_counted_over_the_whole_class() {
    let (client, server) = (controller().ports, robot().ports);
    let link =
        bindings(&client, &port("host/c/robot"), &server, &port("host/r/arm"), &ConnectOptions::default())
            .unwrap();
    // Command 0 is `park` and event 0 `parked`, of the interface before `arm`.
    let binding = Binding { functions: vec![(0, 1), (1, 3)], handlers: vec![(0, 1)] };
    assert_eq!(link, Link::Interface { required: 0, provided: 1, binding });
}

#[test]
fn a_function_binds_to_every_kind_that_has_its_argument_and_result() {
    let t = f64_type;
    let cases = [
        (None, None, vec![CommandKind::Void]),
        (Some(t()), None, vec![CommandKind::Write]),
        (None, Some(t()), vec![CommandKind::Read, CommandKind::VoidReturn]),
        (Some(t()), Some(t()), vec![CommandKind::QualifiedRead, CommandKind::WriteReturn]),
    ];
    for (arg, ret, kinds) in cases {
        for kind in kinds {
            let offered = command("f", kind, arg.clone().map(|t| (t, "")), ret.clone());
            let link = bind(function("f", arg.clone(), ret.clone()), offered);
            assert!(link.is_ok(), "{kind:?}: {}", link.unwrap_err());
        }
    }
}

#[test]
fn a_function_without_result_does_not_bind_to_a_returning_command() {
    let refusal =
        bind(function("f", None, None), command("f", CommandKind::VoidReturn, None, Some(f64_type())));
    let text = refusal.unwrap_err().to_string();
    assert_eq!(text, "`f` is wanted by `a/c/r` as void, but `a/s/p` offers it as void-return → f64");
    let refusal = bind(function("f", Some(f64_type()), None), command("f", CommandKind::Void, None, None));
    assert_eq!(refusal.unwrap_err().reason(), "COMMAND_KIND_MISMATCH");
}

#[test]
fn a_missing_command_lists_what_is_offered_unless_the_function_is_optional() {
    let offered = || command("measured_cp", CommandKind::Void, None, None);
    let refusal = bind(function("measured_pc", None, None), offered()).unwrap_err();
    assert_eq!(refusal.reason(), "COMMAND_MISSING");
    assert!(refusal.to_string().contains("did you mean `measured_cp`?"), "{refusal}");
    let optional = Function { optional: true, ..function("other", None, None) };
    let link = bind(optional, offered()).unwrap();
    assert_eq!(link, Link::Interface { required: 0, provided: 0, binding: Binding::default() });
}

#[test]
fn a_connection_in_which_nothing_optional_is_found_says_what_is_there() {
    let optional = |name: &str| Function { optional: true, ..function(name, None, None) };
    let said = |functions: Vec<Function>, handlers: Vec<Handler>| {
        let client = Ports { required: vec![required("r", functions, handlers)], ..Ports::default() };
        let commands = ["hold", "move"].map(|c| command(c, CommandKind::Void, None, None)).to_vec();
        let events = vec![event("moved", None)];
        let server = Ports { provided: vec![provided("p", commands, events)], ..Ports::default() };
        idle_connection(&client, &port("a/c/r"), &server, &port("a/s/p"))
    };
    assert_eq!(
        said(vec![optional("hold_w")], vec![]).unwrap(),
        "`a/c/r` finds nothing optional of its own in `a/s/p`, so nothing passes through this connection: it looks for \
         `hold_w` (did you mean `hold`?), and there are hold, move, moved"
    );
    let partly = said(vec![function("move", None, None), optional("zoom")], vec![]).unwrap();
    assert!(partly.starts_with("`a/c/r` finds nothing optional of its own in `a/s/p`: it looks for `zoom`"));
    let deaf = said(vec![], vec![Handler { optional: true, ..handler("mover", None) }]).unwrap();
    assert!(deaf.contains("`mover` (did you mean `moved`?)"), "{deaf}");
    assert_eq!(
        said(vec![optional("zoom"), optional("hold")], vec![]),
        None,
        "one says that it is the right one"
    );
    assert_eq!(said(vec![function("hold", None, None)], vec![]), None);
    assert_eq!(said(vec![], vec![]), None);
}

#[test]
fn a_mismatch_of_two_structs_names_them() {
    let scalar = structure("Scalar", 8, vec![field("x", 0, f64_type(), "")]);
    let text = stream(PortType::Plain(force("N")), PortType::Plain(scalar), false).unwrap_err().to_string();
    assert!(
        text.ends_with("differ: it is Force here and Scalar there: field `stamp` is missing there"),
        "{text}"
    );
    let text =
        stream(PortType::Plain(force("N")), PortType::Plain(force("mN")), false).unwrap_err().to_string();
    assert!(text.contains("differ: both are Force, but field `f[…]` has unit N here"), "{text}");
}

#[test]
fn an_untyped_function_takes_the_type_of_its_command() {
    let any = Function { any: true, ..function("f", None, None) };
    assert!(
        bind(any, command("f", CommandKind::WriteReturn, Some((force("N"), "")), Some(f64_type()))).is_ok()
    );
}

#[test]
fn types_units_and_payloads_are_compared_before_anything_runs() {
    let offered = || command("f", CommandKind::Write, Some((force("mN"), "")), None);
    let text = bind(function("f", Some(force("N")), None), offered()).unwrap_err().to_string();
    assert!(text.contains("field `f[…]` has unit N here and unit mN there"), "{text}");
    let scalar = Function { unit: "m".into(), ..function("f", Some(f64_type()), None) };
    let refusal = bind(scalar, command("f", CommandKind::Write, Some((f64_type(), "mm")), None)).unwrap_err();
    assert_eq!(refusal.reason(), "TYPE_MISMATCH");
    assert!(refusal.to_string().ends_with("it has unit m here and unit mm there"), "{refusal}");

    let client =
        Ports { required: vec![required("r", vec![], vec![handler("e", None)])], ..Ports::default() };
    let server = Ports {
        provided: vec![provided("p", vec![], vec![event("e", Some(f64_type()))])],
        ..Ports::default()
    };
    let refusal =
        bindings(&client, &port("a/c/r"), &server, &port("a/s/p"), &ConnectOptions::default()).unwrap_err();
    assert!(refusal.to_string().ends_with("it is none here and f64 there"), "{refusal}");
}

#[test]
fn streams_fit_when_equal_adapted_or_untyped() {
    let plain = |t: Type| PortType::Plain(t);
    let fits = |adapt| Ok(Link::Stream { input: 0, output: 0, adapt });
    assert_eq!(stream(plain(force("N")), plain(force("N")), false), fits(false));
    assert_eq!(stream(plain(force("N")), plain(moved_force("N")), true), fits(true));
    assert_eq!(stream(PortType::Any, frame("image", 0), false), fits(false));
    assert_eq!(stream(frame("image", 100), frame("image", 50), false), fits(false));
    let text = stream(plain(force("N")), plain(moved_force("N")), false).unwrap_err().to_string();
    assert!(text.ends_with("adapt: true would copy it by name"), "{text}");
    let refusal = stream(plain(force("N")), plain(moved_force("mN")), true).unwrap_err();
    assert_eq!(refusal.reason(), "TYPE_MISMATCH", "{refusal}");
}

#[test]
fn frames_of_another_format_or_beyond_the_room_are_refused() {
    for (client, server) in [
        (frame("image", 0), frame("spectra", 0)),
        (frame("image", 10), frame("image", 20)),
        (frame("image", 0), PortType::Plain(f64_type())),
        (PortType::Plain(f64_type()), frame("image", 0)),
    ] {
        let refusal = stream(client, server, false).unwrap_err();
        assert_eq!(refusal.reason(), "FORMAT_MISMATCH", "{refusal}");
    }
}

#[test]
fn connect_to_a_missing_interface_lists_what_exists() {
    let refusal = refused(&theatre(), &connect("host/controller/robot", "host/robot/amr"));
    assert_eq!(refusal.reason(), "INTERFACE_NOT_FOUND");
    let text = refusal.to_string();
    assert!(text.ends_with("did you mean `arm`? There are force, base, arm"), "{text}");
}

#[test]
fn swapped_ends_and_ends_of_one_direction_are_told_apart_from_unknown_ones() {
    let graph = theatre();
    let refusal = refused(&graph, &connect("host/robot/arm", "host/controller/robot"));
    assert_eq!(refusal.reason(), "WRONG_DIRECTION");
    assert!(refusal.help().starts_with("Exchange client and server."), "{}", refusal.help());
    let refusal = refused(&graph, &connect("host/log/force", "host/robot/arm"));
    assert_eq!(refusal.reason(), "WRONG_DIRECTION");
    assert!(
        !refusal.help().starts_with("Exchange"),
        "exchanging an input and a provided interface does not help"
    );
}

#[test]
fn a_client_end_has_one_source_and_replace_rewires_in_one_plan() {
    let mut graph = theatre();
    done(&mut graph, &[create("host/robot2", "eyerobot")]);
    let same = connect("host/controller/robot", "host/robot/arm");
    assert!(matches!(refused(&graph, &same), Refusal::ConnectionExists { id: 1, .. }));
    let other = connect("host/controller/robot", "host/robot2/arm");
    assert_eq!(refused(&graph, &other).reason(), "ALREADY_CONNECTED");
    let replace = with("host/controller/robot", "host/robot2/arm", options(|o| o.replace = true));
    let plan = plan(&graph, &replace).unwrap();
    let rewires = |plan: &Plan| {
        matches!(plan.changes[..], [Change::Disconnect { replaced: true, .. }, Change::Connect { .. }])
    };
    assert!(rewires(&plan), "the LCM is told that another source follows: {plan:?}");
    assert!(rewires(&inverse(&plan)), "taken back it is a replacement, too: {plan:?}");
    graph.apply(&plan);
    assert_eq!(graph.source_of(&port("host/controller/robot")).unwrap().server, port("host/robot2/arm"));
}

#[test]
fn connection_numbers_begin_at_one_and_are_never_used_again() {
    let mut graph = theatre();
    let numbers = |g: &SystemGraph| g.connections.keys().map(|id| id.0).collect::<Vec<_>>();
    assert_eq!(numbers(&graph), [1, 2]);
    let which = Which::Id(ConnectionId(2));
    done(&mut graph, &[Request::Disconnect { which }, connect("host/log/force", "host/robot/force")]);
    assert_eq!(numbers(&graph), [1, 3]);
}

#[test]
fn a_connection_across_processes_is_checked_as_any_other() {
    let mut graph = theatre();
    done(&mut graph, &[create("gui/log", "logger")]);
    done(&mut graph, &[connect("gui/log/force", "host/robot/force")]);
    assert_eq!(refused(&graph, &connect("gui/log/force", "host/robot/arm")).reason(), "WRONG_DIRECTION");
}

#[test]
fn disconnect_goes_by_number_or_by_pair_and_lists_what_there_is() {
    let graph = theatre();
    let pair = Which::Pair { client: port("host/log/force"), server: port("host/robot/force") };
    let changes = plan(&graph, &Request::Disconnect { which: pair }).unwrap().changes;
    assert!(
        matches!(changes[..], [Change::Disconnect { replaced: false, .. }]),
        "nothing follows: {changes:?}"
    );
    let refusal = refused(&graph, &Request::Disconnect { which: Which::Id(ConnectionId(9)) });
    assert_eq!(refusal.reason(), "CONNECTION_NOT_FOUND");
    assert!(refusal.to_string().contains("1: host/robot/arm → host/controller/robot"), "{refusal}");
}

#[test]
fn options_that_mean_nothing_or_are_out_of_bounds_are_refused_not_ignored() {
    let mut graph = theatre();
    done(&mut graph, &[create("host/log2", "logger"), create("host/controller2", "controller")]);
    let stream = ("host/log2/force", "host/robot/force");
    let interface = ("host/controller2/robot", "host/robot/arm");
    let fifo = |depth| Some(Queue::Fifo { depth, drop_oldest: true });
    let cases = [
        (stream, options(|o| o.queue = fifo(0)), "options.queue"),
        (stream, options(|o| o.queue = fifo(1 << 30)), "options.queue"),
        (stream, options(|o| o.mailbox = Some(4)), "options.mailbox"),
        (stream, options(|o| o.deadline_ns = Some(4)), "options.deadline"),
        (stream, options(|o| o.max_age_ns = Some(0)), "options.max_age"),
        (stream, options(|o| o.carrier = "pigeon".into()), "options.carrier"),
        (interface, options(|o| o.queue = fifo(4)), "options.queue"),
        (interface, options(|o| o.mailbox = Some(0)), "options.mailbox"),
        (interface, options(|o| o.deadline_ns = Some(u64::MAX)), "options.deadline"),
    ];
    for ((client, server), options, want) in cases {
        let refusal = refused(&graph, &with(client, server, options));
        assert!(
            matches!(&refusal, Refusal::ArgumentInvalid { field, .. } if field == want),
            "{want}: {refusal}"
        );
    }
}

#[test]
fn a_circle_within_one_stream_is_refused_unless_one_connection_is_queued() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            create_in("host/a", "vision/gray", "host/source"),
            create_in("host/b", "twin", "host/a"),
            connect("host/a/raw", "host/source/image"),
            connect("host/b/raw", "host/a/image"),
        ],
    );
    let refusal = refused(&graph, &connect("host/source/feedback", "host/b/image"));
    let Refusal::SyncCycle { path } = &refusal else { panic!("{refusal}") };
    let path: Vec<String> = path.iter().map(ToString::to_string).collect();
    assert_eq!(path, ["host/b", "host/source", "host/a", "host/b"]);
    done(&mut graph, &[with("host/source/feedback", "host/b/image", options(|o| o.carrier = "heap".into()))]);
}

#[test]
fn a_circle_between_threads_is_no_circle() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            create("host/a", "vision/gray"),
            connect("host/a/raw", "host/source/image"),
            connect("host/source/feedback", "host/a/image"),
        ],
    );
}

#[test]
fn rewiring_an_end_that_closed_a_circle_is_judged_without_the_old_wire() {
    let mut graph = empty();
    done(
        &mut graph,
        &[
            create("host/source", "image_source"),
            create_in("host/a", "vision/gray", "host/source"),
            create_in("host/b", "vision/gray", "host/source"),
            connect("host/b/raw", "host/a/image"),
            connect("host/a/raw", "host/source/image"),
        ],
    );
    assert_eq!(
        refused(&graph, &with("host/a/raw", "host/b/image", options(|o| o.replace = true))).reason(),
        "SYNC_CYCLE"
    );
    done(
        &mut graph,
        &[
            with("host/b/raw", "host/source/image", options(|o| o.replace = true)),
            with("host/a/raw", "host/b/image", options(|o| o.replace = true)),
        ],
    );
}

#[test]
fn only_what_takes_any_type_and_does_nothing_with_it_looks_on() {
    let number = || PortType::Plain(Type::Prim(Prim::F64));
    let looks = |ty, required, outputs: Vec<Output>| {
        let ports = Ports { inputs: vec![input("i", ty)], required, outputs, ..Ports::default() };
        ports.looks_on(0)
    };
    assert!(looks(PortType::Any, vec![], vec![]));
    assert!(looks(PortType::Any, vec![], vec![output(TAPS[0], number())]), "every component has taps");
    assert!(!looks(number(), vec![], vec![]), "it knows what it takes");
    assert!(!looks(PortType::Any, vec![], vec![output("o", number())]), "a filter");
    assert!(!looks(PortType::Any, vec![required("r", vec![], vec![])], vec![]), "it tells somebody");
    assert!(!Ports::default().looks_on(0));
}
