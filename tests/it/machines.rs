//! A manager that is reached from other machines.
//!
//! Promise: beyond the loopback both sides show certificates of one authority, each holder does what its role
//! says and nothing else, and one whose certificate is taken back is cut off at once.

#[path = "machines/agents.rs"]
mod agents;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, Output, Trocar, World, eventually};

/// A manager that other machines reach, and the authority of its system.
struct Lab {
    gcm: HostProcess,
    world: World,
}

impl Lab {
    fn new() -> Lab {
        let world = World::with_plugins(&["example", "fixture_gauge"]);
        let trocar = Trocar::new(&world);
        trocar.run(&["ca", "init"]).ends_with(0);
        let issue = |rest: &str| {
            let typed = format!("ca issue {rest}");
            trocar.run(&typed.split(' ').collect::<Vec<_>>()).ends_with(0)
        };
        issue("or1 --role gcm --address 127.0.0.1");
        issue("cart --role host --process cart --process cart-*");
        issue("vera --role viewer");
        issue("anna --role operator");
        issue("chief --role administrator");
        let list = trocar.run(&["ca", "revoked"]).ends_with(0).stdout.trim().to_owned();
        let state = world.state().join("gcm");
        let mut args: Vec<std::ffi::OsString> = [
            "gcm",
            "--listen",
            "127.0.0.1:0",
            "--listen-tls",
            "127.0.0.1:0",
            "--revoked",
            &list,
            "--identity",
        ]
        .map(Into::into)
        .to_vec();
        args.extend([world.path("or1.pem").into(), "--state".into(), state.into()]);
        let gcm = HostProcess::spawn(&world, "gcm", &args);
        Lab { gcm, world }
    }

    /// The address at which other machines reach the manager, `HOST:PORT`.
    fn address(&self) -> String {
        // It serves before it has said all.
        eventually("it says where other machines reach it", || {
            let printed = self.gcm.printed();
            let said = printed.split_once("https://").map(|(_, behind)| behind);
            let found =
                said.and_then(|behind| behind.split_once(char::is_whitespace)).map(|(found, _)| found);
            found.map(str::to_owned).ok_or(printed)
        })
    }

    fn identity(&self, name: &str) -> PathBuf {
        self.world.path(&format!("{name}.pem"))
    }

    fn types(&self, line: &str) -> Output {
        let typed: Vec<&str> = line.split(' ').collect();
        Trocar::at(&self.world, &format!("https://{}", self.address())).run(&typed)
    }

    fn grpc(&self, who: &str) -> Grpcurl {
        Grpcurl::showing(&self.address(), &self.identity(who))
    }

    fn host(&self, name: &str, identity: &str) -> HostProcess {
        let gcm = format!("https://{}", self.address());
        let identity = self.identity(identity).display().to_string();
        let host = HostProcess::start_with(&self.world, name, &["--gcm", &gcm, "--identity", &identity]);
        eventually("it is attached", || self.is(name, "PROCESS_STATE_ATTACHED"));
        host
    }

    fn is(&self, process: &str, state: &str) -> Result<(), String> {
        let list = self.gcm.grpcurl().ok("GcmService/List", json!({ "brief": true }));
        let all = list["processes"].as_array().cloned().unwrap_or_default();
        let found = all.iter().find(|one| one["name"] == process).cloned().unwrap_or(Value::Null);
        if found["state"] == state { Ok(()) } else { Err(format!("{process}: {found}")) }
    }
}

#[test]
fn a_host_and_the_tools_reach_the_manager_by_their_certificates() {
    let lab = Lab::new();
    let _host = lab.host("cart", "cart");
    let (chief, anna) = (lab.grpc("chief"), lab.grpc("anna"));
    chief.await_class("cart", "Server");
    chief.create("cart/server", "Server", json!({}));
    anna.start("cart/server");
    anna.invoke("cart/server/Provided/Write", json!(30));
    assert_eq!(lab.grpc("vera").invoke("cart/server/Provided/Read", Value::Null), json!(30));
    lab.types("ls --identity anna.pem").ends_with(0).says("cart/server");
    lab.types("stop cart/server --identity anna.pem").ends_with(0);
    assert_eq!(chief.state("cart/server"), "STOPPED");
    // Programs of this user on the manager's own machine need nothing, as ever.
    assert_eq!(lab.gcm.grpcurl().state("cart/server"), "STOPPED");
    let audit = std::fs::read_to_string(lab.world.state().join("gcm/audit.log")).unwrap_or_default();
    assert!(audit.contains("operator anna at 127.0.0.1:"), "who asked is in the audit:\n{audit}");
}

#[test]
fn each_role_does_what_it_may_and_is_told_what_it_takes_otherwise() {
    let lab = Lab::new();
    let _host = lab.host("cart", "cart");
    lab.grpc("chief").await_class("cart", "Server");
    lab.grpc("chief").create("cart/server", "Server", json!({}));
    let create = json!({ "path": "cart/more", "class": "Server" });
    let all = json!({ "paths": ["cart/**"] });
    for (who, method, body, needs) in [
        ("vera", "GcmService/Stop", &all, "the role operator"),
        ("vera", "GcmService/Create", &create, "the role"),
        ("anna", "GcmService/Create", &create, "the role administrator"),
        ("anna", "PluginService/Recheck", &json!({}), "the role administrator"),
        ("anna", "GuestService/Hold", &json!({ "component": "cart/server" }), "the role administrator"),
        ("cart", "GcmService/Create", &create, "the role administrator"),
        ("cart", "GcmService/Start", &all, "the role operator"),
    ] {
        let refused = lab.grpc(who).refused(method, body.clone());
        let told = (refused.code, refused.reason.as_str(), refused.message.contains(needs));
        assert_eq!(told, ("PERMISSION_DENIED", "ROLE_FORBIDDEN", true), "{who} {method}: {refused}");
    }
    let write = json!({ "path": "cart/server/Provided/Write", "json": 1 });
    let refused = lab.grpc("vera").refused("InteractService/Invoke", write);
    assert_eq!(refused.reason, "ROLE_FORBIDDEN", "{refused}");
    // Everybody may ask who leads, and nobody tells of processes that it is not.
    let tells = json!({ "processes": [{ "process": "left", "fate": "FATE_FAILED" }] });
    for who in ["vera", "anna", "chief", "cart"] {
        assert_eq!(lab.grpc(who).ok("AttachService/Tell", json!({}))["term"], "1", "{who}");
        let refused = lab.grpc(who).refused("AttachService/Tell", tells.clone());
        assert_eq!(refused.reason, "ROLE_FORBIDDEN", "{who}: {refused}");
    }
    lab.grpc("anna").ok("GcmService/Start", all);
    assert_eq!(lab.grpc("vera").state("cart/server"), "ACTIVE");
}

#[test]
fn a_host_is_no_process_that_its_certificate_does_not_name() {
    let lab = Lab::new();
    let _named = lab.host("cart-left", "cart");
    let gcm = format!("https://{}", lab.address());
    let line = format!("host --name left --listen 127.0.0.1:0 --state s --gcm {gcm} --identity cart.pem");
    let trocar = Trocar::new(&lab.world);
    let refused = trocar.run(&line.split(' ').collect::<Vec<_>>());
    assert!(refused.code != 0, "{refused:?}");
    refused.says("as process left").says("the process left");
    // A person is no process at all.
    let line = line.replace("cart.pem", "chief.pem");
    trocar.run(&line.split(' ').collect::<Vec<_>>()).says("the role host or gcm");
    assert!(lab.is("left", "PROCESS_STATE_ATTACHED").is_err());
}

#[test]
fn whoever_shows_no_certificate_or_a_foreign_one_is_answered_nothing() {
    let lab = Lab::new();
    let address = lab.address();
    lab.types("ls").ends_with(3).says("--identity FILE");
    // Another authority's, of the same name and role.
    let trocar = Trocar::new(&lab.world);
    trocar.run(&["ca", "init", "--dir", "other"]).ends_with(0);
    trocar
        .run(&["ca", "issue", "--dir", "other", "chief", "--role", "administrator", "-o", "stranger.pem"])
        .ends_with(0);
    lab.types("ls --identity stranger.pem").ends_with(3).says("another authority");
    let foreign = Grpcurl::showing(&address, &lab.identity("stranger")).call("GcmService/List", json!({}));
    assert!(foreign.is_err(), "{foreign:?}");
    // Plain text, and nothing at all.
    assert!(Grpcurl::new(&address).call("GcmService/List", json!({})).is_err());
    for said in [&b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"[..], &[0x16, 3, 1, 0xff, 0xff], &[0; 64]] {
        let mut stranger = TcpStream::connect(&address).unwrap_or_else(|e| panic!("{e}"));
        stranger.write_all(said).unwrap_or_else(|e| panic!("{e}"));
        let mut heard = Vec::new();
        // It ends at the latest after two seconds; a reset is an end as well.
        let _ = stranger.read_to_end(&mut heard);
        assert!(!String::from_utf8_lossy(&heard).contains("HTTP"), "{heard:?}");
    }
    lab.types("ls --identity vera.pem").ends_with(0);
}

#[test]
fn strangers_that_say_nothing_keep_nobody_out() {
    let lab = Lab::new();
    let address = lab.address();
    let silent: Vec<TcpStream> = (0..48).filter_map(|_| TcpStream::connect(&address).ok()).collect();
    assert!(silent.len() > 32, "{} connections", silent.len());
    // Each is let go after two seconds; those of one address have sixteen places meanwhile.
    eventually("one that shows a certificate is answered", || {
        lab.grpc("vera").call("GcmService/List", json!({ "brief": true })).map(drop)
    });
    drop(silent);
}

#[test]
fn a_certificate_that_is_taken_back_ends_what_is_open_and_opens_nothing() {
    let lab = Lab::new();
    let _host = lab.host("cart", "cart");
    let mut watch = lab.grpc("anna").stream("GcmService/Watch", &json!({}));
    watch.until("it follows the system", |said| said.get("snapshot").is_some());
    let trocar = Trocar::new(&lab.world);
    trocar.run(&["ca", "revoke", "anna"]).ends_with(0).says("operator anna");
    watch.ended("its certificate was revoked");
    lab.types("ls --identity anna.pem").ends_with(3).says("revoked");
    trocar.run(&["ca", "revoke", "anna"]).ends_with(1).says("no valid certificate");
    lab.types("ls --identity vera.pem").ends_with(0);
    // A process, too: it runs on, and is lost to its manager.
    trocar.run(&["ca", "revoke", "cart"]).ends_with(0);
    eventually("the process is lost", || lab.is("cart", "PROCESS_STATE_LOST"));
    // With another certificate in its file it comes back by itself.
    trocar.run(&["ca", "issue", "cart", "--role", "host", "--process", "cart"]).ends_with(0);
    eventually("the process is back", || lab.is("cart", "PROCESS_STATE_ATTACHED"));
}

/// Follows the system over HTTP/1.1, as a page does, and says more than it was asked, so that the server has
/// something to read all the while. Prints a line when it hears something, and ends when it is cut off.
const PAGE: &str = "
import socket, ssl, sys
at, port, identity = sys.argv[1:]
context = ssl.create_default_context(cafile=identity)
context.load_cert_chain(identity)
link = context.wrap_socket(socket.create_connection((at, int(port))), server_hostname=at)
body = bytes(5)
head = 'POST /trocar.v1.GcmService/Watch HTTP/1.1\\r\\nHost: %s:%s\\r\\nContent-Type: application/grpc-web+proto\\r\\n' % (at, port)
link.sendall((head + 'Content-Length: %d\\r\\n\\r\\n' % len(body)).encode() + body + b'G')
print(link.recv(4096).split(b'\\r\\n')[0].decode(), flush=True)
try:
    while link.recv(4096): pass
except OSError: pass
print('cut off', flush=True)
";

#[test]
fn a_page_whose_certificate_is_taken_back_follows_nothing_any_more() {
    let lab = Lab::new();
    let address = lab.address();
    let (at, port) = address.rsplit_once(':').unwrap_or_default();
    let identity = lab.identity("vera");
    let mut page = Command::new("python3");
    page.args(["-c", PAGE, at, port]).arg(identity).stdin(Stdio::null()).stdout(Stdio::piped());
    let mut page = page.spawn().unwrap_or_else(|e| panic!("python3: {e}"));
    let told = page.stdout.take().map(BufReader::new).into_iter().flat_map(BufRead::lines);
    let mut told = told.map(|line| line.unwrap_or_else(|e| panic!("{e}")));
    assert_eq!(told.next().as_deref(), Some("HTTP/1.1 200 OK"));
    Trocar::new(&lab.world).run(&["ca", "revoke", "vera"]).ends_with(0);
    assert_eq!(told.next().as_deref(), Some("cut off"));
    page.wait().unwrap_or_else(|e| panic!("{e}"));
}

#[test]
fn a_manager_whose_certificate_is_taken_back_is_left_by_its_hosts() {
    let lab = Lab::new();
    let trocar = Trocar::new(&lab.world);
    let list = trocar.run(&["ca", "revoked"]).ends_with(0).stdout.trim().to_owned();
    let gcm = format!("https://{}", lab.address());
    let identity = lab.identity("cart").display().to_string();
    let args = ["--gcm", &gcm, "--identity", &identity, "--revoked", &list];
    let host = HostProcess::start_with(&lab.world, "cart", &args);
    eventually("it is attached", || lab.is("cart", "PROCESS_STATE_ATTACHED"));
    trocar.run(&["ca", "revoke", "or1"]).ends_with(0);
    eventually("it is lost", || lab.is("cart", "PROCESS_STATE_LOST"));
    eventually("it says why", || {
        let printed = host.printed();
        if printed.contains("is lost") { Ok(()) } else { Err(printed) }
    });
}

/// A request to connect this client with the server in `cart` as between machines.
fn connect(client: &str) -> Value {
    let client = format!("{client}/Required");
    json!({ "client": client, "server": "cart/server/Provided", "options": { "carrier": "net" } })
}

/// A server in one process and its client in another, connected as between machines.
fn connected(lab: &Lab) -> (HostProcess, HostProcess) {
    let hosts = (lab.host("cart", "cart"), lab.host("cart-2", "cart"));
    let chief = lab.grpc("chief");
    for (process, class) in [("cart", "Server"), ("cart-2", "Client")] {
        chief.await_class(process, class);
    }
    chief.create("cart/server", "Server", json!({}));
    chief.create("cart-2/client", "Client", json!({}));
    chief.ok("GcmService/Connect", connect("cart-2/client"));
    chief.start("cart/server");
    chief.start("cart-2/client");
    hosts
}

/// Commands and events that have passed the only connection, once there are more than so many.
fn passed(lab: &Lab, before: u64) -> u64 {
    let mut now = 0;
    eventually("the connection carries", || {
        let connection = connection(lab);
        now = number(&connection["passed"]);
        let is_net = connection["carrier"] == "net" && number(&connection["roundTripNs"]) > 0;
        if now > before && is_net { Ok(()) } else { Err(connection) }
    });
    now
}

#[test]
fn components_are_connected_over_an_encrypted_line_and_again_when_a_process_died() {
    let lab = Lab::new();
    let (mut server, _client) = connected(&lab);
    let before = passed(&lab, 0);
    server.kill();
    eventually("the process is lost", || lab.is("cart", "PROCESS_STATE_LOST"));
    let _again = lab.host("cart", "cart");
    eventually("the server is there again", || {
        let state = lab.grpc("vera").state("cart/server");
        if state == "ACTIVE" { Ok(()) } else { Err(state) }
    });
    passed(&lab, before);
}

/// The only connection, as it is listed.
fn connection(lab: &Lab) -> Value {
    lab.grpc("vera").ok("GcmService/List", json!({}))["connections"][0].clone()
}

fn send(process: &HostProcess, signal: Signal) {
    let pid = i32::try_from(process.pid()).ok().and_then(Pid::from_raw);
    let sent = pid.map(|pid| kill_process(pid, signal));
    assert!(matches!(sent, Some(Ok(()))), "{} gets no signal: {sent:?}", process.name());
}

/// A number of 64 bits, as JSON has it.
fn number(of: &Value) -> u64 {
    of.as_str().and_then(|text| text.parse().ok()).unwrap_or(0)
}

/// Cuts the line under a stream again and again, by a reader's process that stands still: each sample that
/// was written is passed, skipped or dropped.
fn cut_under_a_stream(port: &str, config: &Value) {
    let lab = Lab::new();
    let (_cart, sink) = (lab.host("cart", "cart"), lab.host("cart-2", "cart"));
    let chief = lab.grpc("chief");
    for (process, class) in [("cart", "sender"), ("cart-2", "sink")] {
        chief.await_class(process, class);
    }
    chief.create("cart/sender", "sender", config.clone());
    chief.create("cart-2/sink", "sink", json!({}));
    let options = json!({ "carrier": "net", "queue": { "fifo": 4000, "dropOldest": true } });
    let (client, server) = (format!("cart-2/sink/{port}"), format!("cart/sender/{port}"));
    chief.ok("GcmService/Connect", json!({ "client": client, "server": server, "options": options }));
    chief.start("cart-2/sink");
    chief.start("cart/sender");
    for _ in 0..3 {
        let before = passed(&lab, 0);
        passed(&lab, before);
        send(&sink, Signal::STOP);
        eventually("the line is lost", || {
            let proxies = connection(&lab)["proxies"].clone();
            let halves = proxies.as_array().map(Vec::as_slice).unwrap_or_default();
            if halves.iter().all(|half| half["linked"] == true) { Err(proxies.clone()) } else { Ok(()) }
        });
        send(&sink, Signal::CONT);
        let before = passed(&lab, 0);
        passed(&lab, before + 100);
    }
    chief.ok("GcmService/Stop", json!({ "path": "cart/sender" }));
    let stats =
        chief.ok("GcmService/GetState", json!({ "path": "cart/sender" }))["component"]["stats"].clone();
    // One in each step.
    let sent = number(&stats["executed"]);
    lab.types("describe cart/sender --identity vera.pem").ends_with(0).says("line: there and back");
    let listed = lab.types("ls --json --identity vera.pem").ends_with(0).stdout;
    let listed: Value = serde_json::from_str(&listed).unwrap_or_default();
    assert!(listed["connections"][0]["line"]["clock_bound_ns"].as_u64() > Some(0), "{listed}");
    eventually("nothing is on its way", || {
        let now = connection(&lab);
        // The sink takes the newest alone of those that wait.
        let counted: u64 = ["passed", "skipped", "dropped"].iter().map(|figure| number(&now[figure])).sum();
        if counted == sent { Ok(()) } else { Err(format!("{sent} were sent, {now}")) }
    });
}

#[test]
fn each_small_sample_is_seen_or_counted_when_a_line_is_cut() {
    cut_under_a_stream("small", &json!({}));
}

#[test]
fn each_long_sample_is_seen_or_counted_when_a_line_is_cut_and_some_wait() {
    cut_under_a_stream("large", &json!({ "large": true }));
}

#[test]
fn a_host_whose_certificate_is_taken_back_is_connected_with_no_more() {
    let lab = Lab::new();
    let trocar = Trocar::new(&lab.world);
    let list = trocar.run(&["ca", "revoked"]).ends_with(0).stdout.trim().to_owned();
    trocar.run(&["ca", "issue", "left", "--role", "host", "--process", "left"]).ends_with(0);
    let gcm = format!("https://{}", lab.address());
    let start = |name: &str, identity: &str| {
        let identity = lab.identity(identity).display().to_string();
        let args = ["--gcm", &gcm, "--identity", &identity, "--revoked", &list];
        HostProcess::start_with(&lab.world, name, &args)
    };
    let (_cart, left) = (start("cart", "cart"), start("left", "left"));
    let chief = lab.grpc("chief");
    for (process, class) in [("cart", "Server"), ("left", "Client")] {
        chief.await_class(process, class);
    }
    chief.create("cart/server", "Server", json!({}));
    chief.create("left/client", "Client", json!({}));
    chief.ok("GcmService/Connect", connect("left/client"));
    trocar.run(&["ca", "revoke", "cart"]).ends_with(0);
    eventually("the line has ended", || {
        let printed = left.printed();
        if printed.contains("its certificate was revoked") { Ok(()) } else { Err(printed) }
    });
}

#[test]
fn a_process_without_an_identity_is_connected_with_no_other_machine() {
    let lab = Lab::new();
    let cart = lab.host("cart", "cart");
    let here = HostProcess::start_with(&lab.world, "here", &["--gcm", lab.gcm.address()]);
    let chief = lab.grpc("chief");
    for (process, class) in [("cart", "Server"), ("here", "Client")] {
        chief.await_class(process, class);
    }
    chief.create("cart/server", "Server", json!({}));
    chief.create("here/client", "Client", json!({}));
    let refusal = chief.refused("GcmService/Connect", connect("here/client"));
    assert!(refusal.reason == "UNREACHABLE" && refusal.message.contains("identity"), "{refusal:?}");
    drop((cart, here));
}

#[test]
fn no_file_keeps_a_stop_from_this_machine() {
    let lab = Lab::new();
    let stopped = Trocar::at(&lab.world, lab.gcm.address()).run(&["stop", "**", "--identity", "nowhere.pem"]);
    stopped.ends_with(0);
}

#[test]
fn an_address_beyond_the_loopback_takes_an_identity_that_may_listen() {
    let world = World::new();
    let trocar = Trocar::new(&world);
    let run = |line: &str| trocar.run(&line.split(' ').collect::<Vec<_>>());
    run("gcm --listen 0.0.0.0:0 --state s").says("nobody knows who calls").says("--listen-tls");
    run("gcm --listen 127.0.0.1:0 --listen-tls 0.0.0.0:0 --state s")
        .says("no identity")
        .says("trocar ca issue");
    run("gcm --listen 127.0.0.1:0 --revoked nowhere.crl --state s").says("and no identity");
    run("ca issue x --role gcm").ends_with(1).says("trocar ca init");
    run("ca init").ends_with(0);
    run("ca issue anna --role operator").ends_with(0);
    run("gcm --listen 127.0.0.1:0 --listen-tls 127.0.0.1:0 --identity anna.pem --state s").says("--role gcm");
    run("gcm --listen 127.0.0.1:0 --listen-tls 127.0.0.1:0 --identity nowhere.pem --state s")
        .says("No such file");
    world.write("junk.pem", "junk");
    run("ls --gcm https://127.0.0.1:1 --identity junk.pem").says("chmod 600");
    run("ca issue or1 --role gcm").ends_with(0);
    run("gcm --listen 127.0.0.1:0 --listen-tls 127.0.0.1:0 --identity or1.pem --revoked or1.pem --state s")
        .says("no list of revoked");
}
