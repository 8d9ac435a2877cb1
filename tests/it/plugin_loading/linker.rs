//! Refusals of the dynamic linker for want of room or of a library, and their help, followed.
//!
//! Invariant: flags, variables and directories are taken from the sentence itself; `/etc` is changed in a
//! mount namespace of the host alone.

use std::fs::{self, File};
use std::os::unix::fs::{PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::process::Command;

use rustix::fs::{StatVfsMountFlags, statvfs};
use serde_json::json;
use trocar_tests::{Built, Failure, Grpcurl, HostProcess, World, eventually, repository, skip};

use super::bad_files::compile;
use super::{file_name, plugin, refused_file};

const FILE: &str = "libtrocar_room.so";
/// Thread-locals for which a process has no room beside those it begins with, bytes.
const TOO_MUCH: u32 = 8192;
/// Thread-locals for which it has room once or a few times, bytes.
const SOME: u32 = 700;
/// `nobody`, on every Linux.
const NOBODY: u32 = 65534;

fn has_compiler() -> bool {
    let has = Command::new("cc").arg("--version").output().is_ok();
    if !has {
        skip("a plugin with thread-locals is made with a C compiler");
    }
    has
}

/// Compiles the plugin; answers its bytes.
fn made(world: &World, thread_locals: u32, more: &[&str]) -> Vec<u8> {
    let header = format!("-I{}", repository().join("sdk/c").display());
    let room = format!("-DROOM={thread_locals}");
    let out = world.path("made.so").display().to_string();
    let args = ["-O1", "-fPIC", "-shared", "-fvisibility=hidden", &header, &room, "-o", &out];
    compile(world, include_str!("room.c"), &[&args[..], more].concat());
    fs::read(out).unwrap()
}

/// Puts the file among the plugins, whole, and waits until this version of it is listed.
fn put(world: &World, grpc: &Grpcurl, bytes: &[u8]) {
    let before = plugin(grpc, FILE).map(|listed| listed["hash"].clone());
    let (new, path) = (world.path("new.so"), world.plugins().join(FILE));
    fs::write(&new, bytes).unwrap();
    fs::set_permissions(&new, fs::Permissions::from_mode(0o755)).unwrap();
    fs::rename(new, path).unwrap();
    eventually("this version is listed", || match plugin(grpc, FILE) {
        Some(listed) if Some(&listed["hash"]) != before.as_ref() => Ok(()),
        other => Err(format!("{other:?}")),
    });
}

/// Makes a component of the version that is listed now.
fn create(grpc: &Grpcurl) -> Result<(), Failure> {
    let made = grpc.call("GcmService/Create", json!({ "path": "host/r", "class": "room" }));
    made.map(|_| drop(grpc.ok("GcmService/Remove", json!({ "path": "host/r" }))))
}

/// The sentence of the dynamic linker's refusal.
#[track_caller]
fn refused(answer: Result<(), Failure>) -> String {
    let refused = answer.expect_err("there is no room for it");
    assert_eq!(refused.reason, "PLUGIN_BAD_FILE", "{refused}");
    assert!(refused.message.contains("cannot allocate memory in static TLS block"), "{refused}");
    refused.message
}

/// The word of a sentence that begins so.
#[track_caller]
fn word<'a>(sentence: &'a str, begin: &str) -> &'a str {
    let found = sentence.split([' ', ',']).find(|word| word.starts_with(begin));
    found.unwrap_or_else(|| panic!("no {begin}… in: {sentence}")).trim_end_matches('.')
}

#[test]
fn a_plugin_with_too_many_thread_locals_is_built_or_its_host_started_as_its_refusal_says() {
    if !has_compiler() {
        return;
    }
    let world = World::new();
    let fixed = made(&world, TOO_MUCH, &["-ftls-model=initial-exec"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    put(&world, &grpc, &fixed);
    let sentence = refused(create(&grpc));
    // Built otherwise, the same host takes it.
    let built = made(&world, TOO_MUCH, &[word(&sentence, "-ftls-model=")]);
    put(&world, &grpc, &built);
    create(&grpc).unwrap_or_else(|refused| panic!("after this was followed: {sentence}\n{refused}"));
    drop(host);

    let (name, value) = word(&sentence, "GLIBC_TUNABLES=").split_once('=').unwrap();
    let roomy = World::new();
    let host = HostProcess::start_prepared(&roomy, "host", &[], |command| {
        command.env(name, value);
    });
    let grpc = host.grpcurl();
    put(&roomy, &grpc, &fixed);
    create(&grpc).unwrap_or_else(|refused| panic!("after this was followed: {sentence}\n{refused}"));
}

#[test]
fn versions_that_have_used_up_the_room_for_thread_locals_are_gone_after_a_restart_as_the_refusal_says() {
    if !has_compiler() {
        return;
    }
    let world = World::new();
    let mut bytes = made(&world, SOME, &["-ftls-model=initial-exec"]);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    let mut loaded = 0;
    let sentence = loop {
        put(&world, &grpc, &bytes);
        match create(&grpc) {
            Ok(()) => loaded += 1,
            refused_one => break refused(refused_one),
        }
        assert!(loaded < 100, "versions that stay take no room");
        // The same code with a byte behind it: another version.
        bytes.push(0);
    };
    assert!(loaded > 0, "one alone has room: {sentence}");
    assert!(sentence.contains("Restart the host"), "{sentence}");
    drop(host);
    let host = HostProcess::start(&world);
    let grpc = host.grpcurl();
    grpc.await_class("host", "room");
    create(&grpc).unwrap_or_else(|refused| panic!("after this was followed: {sentence}\n{refused}"));
}

/// A copy of `trocar` with a capability of its file, for a user who is not root, and a private `/etc`.
struct Secured {
    program: PathBuf,
    etc: PathBuf,
}

impl Secured {
    /// `None` where this machine cannot do it; the test is then skipped by name.
    fn of(world: &World) -> Option<Self> {
        if !rustix::process::geteuid().is_root() {
            skip("only root can give a program capabilities and become another user");
            return None;
        }
        if statvfs(world.path("")).is_ok_and(|fs| fs.f_flag.contains(StatVfsMountFlags::NOSUID)) {
            skip("the temporary directory is mounted nosuid, so that capabilities of files do not count");
            return None;
        }
        let secured = Self { program: world.path("trocar"), etc: world.path("etc") };
        // By another process, as in `cli/plugins.rs`: a file that is open for writing cannot be run.
        let copied = Command::new("cp").args([&*Built::trocar(), &*secured.program]).status().unwrap();
        assert!(copied.success(), "{copied}");
        let open = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
        open(&secured.program, 0o755);
        open(&world.path(""), 0o711);
        let works = |program: &str, args: &[&str]| {
            let done = Command::new(program).args(args).output();
            done.is_ok_and(|done| done.status.success())
        };
        let (program, etc) = (secured.program.display().to_string(), secured.etc.display().to_string());
        assert!(works("cp", &["-a", "/etc", &etc]), "/etc cannot be copied");
        let mount = format!(
            "mount --bind {etc} /etc && for tool in bash ldconfig nsenter setpriv; do command -v $tool || exit; done"
        );
        if !works("setcap", &["cap_sys_nice+ep", &program])
            || !works("unshare", &["--mount", "sh", "-c", &mount])
        {
            skip("it takes setcap(8), setpriv(1), unshare(1), and the right to mount");
            return None;
        }
        fs::create_dir(world.state().join("host")).unwrap();
        chown(world.state().join("host"), Some(NOBODY), Some(NOBODY)).unwrap();
        Some(secured)
    }

    /// A host of that program with this LD_LIBRARY_PATH.
    fn host(&self, world: &World, libraries: &Path) -> HostProcess {
        HostProcess::start_prepared(world, "host", &[], |command| {
            let args: Vec<_> = command.get_args().map(ToOwned::to_owned).collect();
            let file = |name: &str| File::create(world.path(name)).unwrap();
            let script = "mount --bind \"$0\" /etc && \
                exec setpriv --reuid \"$1\" --regid \"$1\" --clear-groups -- \"${@:2}\"";
            *command = Command::new("unshare");
            command.args(["--mount", "bash", "-c", script]).arg(&self.etc).arg(NOBODY.to_string());
            command.arg(&self.program).args(args).current_dir("/").env_remove("TROCAR_GCM");
            command
                .env("LD_LIBRARY_PATH", libraries)
                .env("HOME", "/nonexistent")
                .env_remove("XDG_STATE_HOME");
            command.stdout(file("host.out")).stderr(file("host.err"));
        })
    }
}

#[test]
fn a_library_is_found_by_a_program_with_capabilities_once_its_directory_is_named_as_the_refusal_says() {
    let world = World::new();
    if !has_compiler() {
        return;
    }
    let Some(secured) = Secured::of(&world) else { return };
    let libraries = world.path("libraries");
    fs::create_dir(&libraries).unwrap();
    let library = libraries.join("libfrom_elsewhere.so.3").display().to_string();
    let named = ["-shared", "-fPIC", "-Wl,-soname,libfrom_elsewhere.so.3", "-o", &library];
    compile(&world, "void from_elsewhere(void) {}", &named);
    let bytes = made(&world, 8, &["-DNEEDS", &library]);

    let host = secured.host(&world, &libraries);
    let grpc = host.grpcurl();
    put(&world, &grpc, &bytes);
    let (sentence, _) = eventually("it is refused", || refused_file(&grpc, FILE));
    assert!(
        sentence.contains("needs the library `libfrom_elsewhere.so.3`, which is not found"),
        "{sentence}"
    );
    assert!(sentence.contains("LD_LIBRARY_PATH does not count"), "{sentence}");

    let conf = format!("{}/from_elsewhere.conf", word(&sentence, "/etc/"));
    let then = word(&sentence, "ldconfig");
    let named = Command::new("nsenter")
        .args(["--target", &host.pid().to_string(), "--mount", "sh", "-c"])
        .arg(format!("echo {} > {conf} && {then}", libraries.display()))
        .output()
        .unwrap();
    assert!(named.status.success(), "{named:?}");
    assert!(!Path::new(&conf).exists(), "the machine's own directory is untouched");
    eventually("it is taken", || match grpc.plugins().iter().find(|p| file_name(p) == FILE) {
        Some(listed) if listed["refused"] == "" => Ok(()),
        other => Err(format!("{other:?}")),
    });
    create(&grpc).unwrap_or_else(|refused| panic!("after this was followed: {sentence}\n{refused}"));
}
