//! A host that cannot start: its directories and its address.
//!
//! Promise: what is wrong is named with the way out, and nothing is half made.

use std::fs;
use std::process::Command;

use trocar_tests::{Built, HostProcess, Trocar, World, skip};

use super::REFUSED;

#[test]
fn what_keeps_a_host_from_starting_is_named_with_the_way_out() {
    let world = World::new();
    let host = HostProcess::start(&world);
    // A path below a plain file: refused for root too, whom permissions do not stop.
    let file = world.write("file", "not a directory");
    let path = |path: &str| world.path(path).display().to_string();
    let (here, plugins) = ("127.0.0.1:0", path("plugins"));
    let (in_use, pid) = (path("state/host"), host.pid().to_string());
    let cases = [
        ("0.0.0.0:0", plugins.clone(), path("new-state"), "LISTEN", vec!["127.0.0.1", "SSH tunnel"]),
        ("nonsense", plugins.clone(), path("new-state"), "LISTEN", vec!["nonsense", "HOST:PORT"]),
        (here, path("nowhere"), path("new-state"), "PLUGIN_DIR", vec!["nowhere", "mkdir -p"]),
        (here, path("file"), path("new-state"), "PLUGIN_DIR", vec!["file", "director"]),
        (here, plugins.clone(), path("file/state"), "STATE_UNWRITABLE", vec!["file/state", "--state DIR"]),
        (here, plugins, in_use, "STATE_IN_USE", vec![&pid, "--state DIR --listen 127.0.0.1:0"]),
    ];
    for (listen, plugins, state, reason, words) in cases {
        let args = ["host", "--listen", listen, "--plugins", &plugins, "--state", &state, "--json"];
        let refused = Trocar::new(&world).run(&args).ends_with(REFUSED).json();
        assert_eq!(refused["reason"], reason, "{args:?}: {refused}");
        for word in words {
            assert!(refused.to_string().contains(word), "{args:?} does not say {word:?}: {refused}");
        }
        for made in ["nowhere", "new-state"] {
            assert!(!world.path(made).exists(), "{args:?} has made {made}");
        }
    }
    assert!(file.is_file() && world.state().join("host").is_dir(), "what was there is as it was");
}

/// The cache of plugin files lies in the state directory: there a noexec mount is met.
#[test]
fn a_state_directory_mounted_noexec_is_named_as_the_reason() {
    let world = World::with_plugins(&["sine"]);
    let mount = world.path("noexec");
    fs::create_dir(&mount).unwrap();
    // A mount namespace of its own, so that nothing is left on the machine.
    let mounted = format!("mount -t tmpfs -o noexec,size=64m tmpfs '{}'", mount.display());
    let probe = Command::new("unshare").args(["--mount", "sh", "-c", &mounted]).output();
    if !probe.as_ref().is_ok_and(|o| o.status.success()) {
        skip("a noexec mount needs unshare(1) and the right to mount");
        return;
    }
    let script = format!(
        "{mounted} && exec timeout 30 '{}' host --listen 127.0.0.1:0 --plugins '{}' --state '{}'",
        Built::trocar().display(),
        world.plugins().display(),
        mount.join("state").display(),
    );
    let output = Command::new("unshare")
        .args(["--mount", "sh", "-c", &script])
        .env_remove("TROCAR_GCM")
        .output()
        .unwrap();
    let text =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(REFUSED), "{text}");
    assert!(text.contains("noexec") && text.contains("--state"), "the reason and the way out: {text}");
}
