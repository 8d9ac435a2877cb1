//! Programs of another user of the machine at the port: they read, and change nothing, until they are given a
//! token.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::{Value, json};
use trocar_tests::{Built, HostProcess, Trocar, World, skip};

/// `nobody`, on every Linux.
const NOBODY: u32 = 65534;

/// Programs that another user may run.
struct OtherUser {
    dir: PathBuf,
}

/// The end of a program of that user.
struct Ended {
    ok: bool,
    said: String,
}

impl OtherUser {
    /// `None` where tests may not become another user; the test is then skipped by name.
    fn of(world: &World) -> Option<OtherUser> {
        if !rustix::process::geteuid().is_root() {
            skip("only root can start a program as another user");
            return None;
        }
        let dir = world.path("theirs");
        fs::create_dir(&dir).unwrap();
        let open = |path: &Path| fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
        open(&dir);
        fs::set_permissions(world.path(""), fs::Permissions::from_mode(0o711)).unwrap();
        for (program, from) in [("trocar", Built::trocar()), ("grpcurl", Built::grpcurl())] {
            fs::copy(from, dir.join(program)).unwrap();
            open(&dir.join(program));
        }
        Some(OtherUser { dir })
    }

    fn run(&self, program: &str, args: &[&str], env: &[(&str, &str)]) -> Ended {
        let mut command = Command::new(self.dir.join(program));
        command.args(args).current_dir("/").stdin(Stdio::null()).uid(NOBODY).gid(NOBODY);
        command.env_clear().envs([("PATH", "/usr/bin:/bin"), ("HOME", "/nonexistent"), ("NO_COLOR", "1")]);
        command.envs(env.iter().copied());
        let output = command.output().unwrap();
        let said = [output.stdout, output.stderr].concat();
        Ended { ok: output.status.success(), said: String::from_utf8_lossy(&said).into_owned() }
    }

    fn grpcurl(&self, host: &HostProcess, more: &[&str], method: &str, body: &Value) -> Ended {
        let (body, method) = (body.to_string(), format!("trocar.v1.{method}"));
        let mut args = vec!["-plaintext"];
        args.extend(more);
        args.extend(["-d", &body, host.address(), &method]);
        self.run("grpcurl", &args, &[])
    }

    /// A page's head as this user's browser gets it.
    fn page(&self, host: &HostProcess) -> String {
        let (name, port) = host.address().split_once(':').unwrap();
        let script =
            "exec 3<>/dev/tcp/$0/$1; printf 'GET / HTTP/1.0\\r\\nHost: '$0:$1'\\r\\n\\r\\n' >&3; cat <&3";
        let mut command = Command::new("bash");
        command.args(["-c", script, name, port]).uid(NOBODY).gid(NOBODY).current_dir("/");
        String::from_utf8_lossy(&command.output().unwrap().stdout).into_owned()
    }
}

fn served(more: &[&str]) -> (World, HostProcess) {
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start_with(&world, "host", more);
    let grpc = host.grpcurl();
    grpc.await_class("host", "Server");
    grpc.create("host/server", "Server", json!({}));
    grpc.start("host/server");
    (world, host)
}

/// A request for each way to change something.
fn changes() -> Vec<(&'static str, Value)> {
    vec![
        ("GcmService/Create", json!({ "path": "host/theirs", "class": "Server" })),
        ("GcmService/Stop", json!({ "path": "host/server" })),
        ("GcmService/Start", json!({ "path": "host/server" })),
        ("GcmService/Remove", json!({ "path": "host/server" })),
        ("GcmService/Configure", json!({ "path": "host/server", "config": {} })),
        ("GcmService/Apply", json!({})),
        ("InteractService/Invoke", json!({ "path": "host/server/Provided/Write", "json": 30 })),
        ("PluginService/Load", json!({})),
        ("GuestService/Require", json!({})),
        ("AttachService/Tell", json!({})),
        ("AttachService/Supervise", json!({})),
        ("AttachService/Attach", json!({ "hello": { "process": "host" } })),
    ]
}

#[test]
fn another_users_programs_read_and_whatever_changes_something_is_refused_with_who_may() {
    let (world, host) = served(&[]);
    let Some(other) = OtherUser::of(&world) else { return };
    for (method, body) in [
        ("GcmService/List", json!({})),
        ("GcmService/GetState", json!({ "path": "host/server" })),
        ("GcmService/Describe", json!({ "path": "host/server" })),
        ("InteractService/Read", json!({ "path": "host/server" })),
        ("InteractService/Invoke", json!({ "path": "host/server/Provided/Read" })),
        ("PluginService/ListPlugins", json!({})),
    ] {
        let told = other.grpcurl(&host, &[], method, &body);
        assert!(told.ok, "{method} reads: {}", told.said);
    }
    for (method, body) in changes() {
        let told = other.grpcurl(&host, &[], method, &body);
        let names = |what: &str| told.said.contains(what);
        assert!(!told.ok && names("PermissionDenied") && names("user 65534"), "{method}: {}", told.said);
        assert!(names("trocar token"), "{method} does not say what to do: {}", told.said);
    }
    let list = host.grpcurl().ok("GcmService/List", json!({}));
    assert_eq!(list["components"].as_array().map(Vec::len), Some(1), "{list}");
    assert_eq!(host.grpcurl().state("host/server"), "ACTIVE", "{list}");
}

#[test]
fn the_command_line_of_another_user_is_told_the_same_and_with_a_token_does_it() {
    let (world, host) = served(&[]);
    let Some(other) = OtherUser::of(&world) else { return };
    let gcm = ("TROCAR_GCM", host.address());
    let told = other.run("trocar", &["stop", "host/server"], &[gcm]);
    assert!(
        !told.ok && told.said.contains("is refused to user 65534") && told.said.contains("TROCAR_TOKEN"),
        "{}",
        told.said
    );
    let wrong = other.run("trocar", &["stop", "host/server"], &[gcm, ("TROCAR_TOKEN", "wrong")]);
    assert!(!wrong.ok && wrong.said.contains("a token that is not this host's"), "{}", wrong.said);
    let token = Trocar::new(&world).run(&["token"]).ends_with(0).stdout;
    let right = other.run("trocar", &["stop", "host/server"], &[gcm, ("TROCAR_TOKEN", token.trim())]);
    assert!(right.ok, "{}", right.said);
    let header = format!("authorization: Bearer {}", token.trim());
    let started =
        other.grpcurl(&host, &["-H", &header], "GcmService/Start", &json!({ "path": "host/server" }));
    assert!(started.ok, "{}", started.said);
    fs::remove_file(world.path("xdg-state/trocar/run/token")).unwrap();
    let withdrawn =
        other.grpcurl(&host, &["-H", &header], "GcmService/Stop", &json!({ "path": "host/server" }));
    assert!(!withdrawn.ok, "the token was withdrawn: {}", withdrawn.said);
}

#[test]
fn another_users_host_joins_no_gcm_without_a_token() {
    let (world, host) = served(&[]);
    let Some(other) = OtherUser::of(&world) else { return };
    let state = other.dir.join("state");
    fs::create_dir(&state).unwrap();
    std::os::unix::fs::chown(&state, Some(NOBODY), Some(NOBODY)).unwrap();
    let state = state.display().to_string();
    let args =
        ["host", "--name", "theirs", "--listen", "127.0.0.1:0", "--gcm", host.address(), "--state", &state];
    let told = other.run("trocar", &args, &[]);
    assert!(!told.ok && told.said.contains("user 65534"), "{}", told.said);
    assert_eq!(
        host.grpcurl().ok("GcmService/List", json!({}))["processes"].as_array().map(Vec::len),
        Some(1)
    );
}

#[test]
fn the_page_of_another_user_reads_and_ones_own_does_everything() {
    let (world, host) = served(&[]);
    let Some(other) = OtherUser::of(&world) else { return };
    assert!(other.page(&host).contains(r#"<meta name="viewer" content="read-only""#), "their page");
    let mut own = TcpStream::connect(host.address()).unwrap();
    write!(own, "GET / HTTP/1.0\r\nHost: {}\r\n\r\n", host.address()).unwrap();
    let mut page = String::new();
    own.read_to_string(&mut page).unwrap();
    assert!(page.contains(r#"<meta name="viewer" content="full""#), "{page}");
}

#[test]
fn an_open_loopback_lets_everybody_do_everything() {
    let (world, host) = served(&["--open-loopback"]);
    let Some(other) = OtherUser::of(&world) else { return };
    let told = other.grpcurl(&host, &[], "GcmService/Stop", &json!({ "path": "host/server" }));
    assert!(told.ok, "{}", told.said);
}

#[test]
fn the_sockets_beside_a_port_and_the_token_are_for_their_user_alone_and_go_with_the_host() {
    let (world, mut host) = served(&[]);
    Trocar::new(&world).run(&["token"]).ends_with(0);
    let run = world.path("xdg-state/trocar/run");
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(&run), 0o700);
    let found = || fs::read_dir(&run).unwrap().map(|entry| entry.unwrap().path()).collect::<Vec<_>>();
    let beside = |path: &PathBuf| path.to_string_lossy().contains(host.address());
    let all: Vec<PathBuf> = found().into_iter().filter(beside).collect();
    let is_socket = |path: &&PathBuf| !fs::symlink_metadata(path).unwrap().is_symlink();
    let doors: Vec<&PathBuf> = all.iter().filter(is_socket).collect();
    assert_eq!(
        (doors.len(), all.len()),
        (2, 4),
        "one for calls, one for Stop, and what leads there: {all:?}"
    );
    assert!(doors.iter().all(|door| mode(door) == 0o600), "{doors:?}");
    assert_eq!(all.iter().filter(|path| path.exists()).count(), 4, "each leads to one: {all:?}");
    assert_eq!(mode(&run.join("token")), 0o600);
    host.interrupt();
    let left: Vec<PathBuf> = found().into_iter().filter(|path| all.contains(path)).collect();
    assert!(left.is_empty(), "{left:?}");
}
