//! `trocar up --detach`: what the asker learns, and that nothing is left when it gives up.

use std::process::{Command, Stdio};

use trocar_tests::{Built, Trocar, World, eventually};

use super::TWO;
use super::system::{kill, running_in};

fn world() -> (World, String) {
    let world = World::with_plugins(&["sine", "fixture_chaos"]);
    let file = world.write("system.json", TWO).to_str().unwrap().to_owned();
    (world, file)
}

#[test]
fn it_answers_with_the_exit_code_of_the_one_it_starts() {
    let (world, file) = world();
    let detach = |more: &[&str]| Trocar::new(&world).run(&[&["up", "--detach", "--json"], more].concat());
    let no_gcm = detach(&["--gcm", "127.0.0.1:1", &file]).ends_with(3).json();
    assert_eq!(no_gcm["reason"], "NO_GCM", "{no_gcm}");
    let empty = world.write("empty.json", r#"{ "version": 1 }"#);
    let usage = detach(&[empty.to_str().unwrap()]).ends_with(2).json();
    assert_eq!(usage["reason"], "USAGE", "{usage}");
    let set = detach(&["--set", "right/none.k=1", &file]).json();
    assert_ne!(set["reason"], "PROCESS_NOT_UP", "its own words are passed on: {set}");
    assert!(running_in(&world.path("")).is_empty());
}

#[test]
fn a_file_behind_two_dashes_is_a_file() {
    let (world, file) = world();
    let args = ["up", "--listen", "127.0.0.1:0", "--detach", "--json", "--", &file];
    Trocar::new(&world).run(&args).ends_with(0);
    let again = Trocar::new(&world).run(&args).ends_with(1).json();
    let help = again["help"].as_str().unwrap_or_default();
    assert!(help.contains("trocar down system") && !help.contains("--state"), "{again}");
    Trocar::new(&world).run(&["down", "system"]).ends_with(0);
}

#[test]
fn whoever_gives_up_waiting_leaves_nothing_behind() {
    let (world, _) = world();
    let slow = "{ \"class\": \"chaos\", \"config\": { \"slow_start_ms\": 20000 } }";
    let file = world.write("system.json", TWO.replacen("{ \"class\": \"chaos\" }", slow, 1));
    for signal in ["-INT", "-KILL"] {
        let mut asker = Command::new(Built::trocar())
            .args(["up", file.to_str().unwrap(), "--detach", "--listen", "127.0.0.1:0"])
            .env("XDG_STATE_HOME", world.path("xdg-state"))
            .env_remove("TROCAR_GCM")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let home = world.path("xdg-state");
        eventually("the GCM and both hosts run", || match running_in(&home).len() {
            3 => Ok(()),
            n => Err(n),
        });
        kill(signal, asker.id().into());
        let status = asker.wait().unwrap();
        if signal == "-INT" {
            assert_eq!(status.code(), Some(130));
        }
        eventually(&format!("{signal}: all have ended"), || match running_in(&world.path("")) {
            left if left.is_empty() => Ok(()),
            left => Err(format!("{left:?}")),
        });
    }
}

#[test]
fn its_directory_is_its_users_alone() {
    use std::os::unix::fs::PermissionsExt;
    let (world, file) = world();
    // As on many desktops.
    let umask =
        format!("umask 002 && exec {} up {file} --detach --listen 127.0.0.1:0", Built::trocar().display());
    let status = Command::new("sh")
        .args(["-c", &umask])
        .env("XDG_STATE_HOME", world.path("xdg-state"))
        .env_remove("TROCAR_GCM")
        .stdout(Stdio::null())
        .status();
    assert!(status.unwrap().success());
    let mode = std::fs::metadata(world.path("xdg-state/trocar/up/system")).unwrap().permissions().mode();
    Trocar::new(&world).run(&["down", "system"]).ends_with(0);
    assert_eq!(mode & 0o777, 0o700);
}
