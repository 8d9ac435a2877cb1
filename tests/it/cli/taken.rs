//! An address somebody listens on already: who it is, and the way out.
//!
//! Promise: the sentence fits whoever is there, the newcomer leaves nothing behind, and whoever is there goes
//! on.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::fd::IntoRawFd;
use std::thread;

use serde_json::{Value, json};
use trocar_tests::{HostProcess, Trocar, World, eventually};

use super::REFUSED;

/// `trocar host` under a name, at an address, with a state directory of its own.
fn host_at(world: &World, name: &str, address: &str, more: &[&str]) -> Value {
    let (state, plugins) = (world.path("other-state"), world.plugins());
    let (state_text, plugins) = (state.display().to_string(), plugins.display().to_string());
    let mut args = vec!["host", "--name", name, "--listen", address, "--plugins", &plugins];
    args.extend(["--state", &state_text, "--json"]);
    args.extend(more);
    let refused = Trocar::new(world).run(&args).ends_with(REFUSED).json();
    assert!(!state.exists(), "nothing is half made: {refused}");
    refused
}

#[track_caller]
fn says(refused: &Value, reason: &str, words: &[&str]) {
    assert_eq!(refused["reason"], reason, "{refused}");
    let text = refused.to_string();
    for word in words {
        assert!(text.contains(word), "it does not say {word:?}: {refused}");
    }
}

#[test]
fn a_host_of_the_same_name_is_named_with_its_pid() {
    let world = World::new();
    let mut host = HostProcess::start_with(&world, "lab", &[]);
    let pid = host.pid().to_string();
    let refused = host_at(&world, "lab", host.address(), &[]);
    says(&refused, "PROCESS_EXISTS", &["`lab` is taken", &pid, host.address(), "kill", "--listen"]);
    let known = &refused["metadata"];
    assert_eq!((&known["pid"], &known["process"]), (&json!(pid), &json!("lab")), "{refused}");
    assert!(host.is_alive());
}

#[test]
fn a_host_of_another_name_is_named_with_the_way_to_its_gcm() {
    let world = World::new();
    let mut host = HostProcess::start_with(&world, "lab", &[]);
    let pid = host.pid().to_string();
    let refused = host_at(&world, "other", host.address(), &[]);
    let join = format!("--gcm {} --listen 127.0.0.1:0", host.address());
    says(&refused, "LISTEN", &["the host `lab`", &pid, "a GCM of its own", &join]);
    assert!(host.is_alive());
}

#[test]
fn a_gcm_is_told_from_a_host() {
    let world = World::new();
    let mut gcm = HostProcess::start_gcm(&world);
    let _attached = HostProcess::start_with(&world, "lab", &["--gcm", gcm.address()]);
    let join = format!("trocar host --gcm {} --listen 127.0.0.1:0", gcm.address());
    says(&host_at(&world, "lab", gcm.address(), &[]), "LISTEN", &["taken by a GCM", &join]);
    let state = world.path("second-gcm").display().to_string();
    let second = ["gcm", "--listen", gcm.address(), "--state", &state];
    Trocar::new(&world).run(&second).ends_with(REFUSED).says("taken by a GCM").says("--listen");
    assert!(gcm.is_alive());
}

#[test]
fn a_host_of_another_gcm_is_known_by_asking_that_gcm() {
    let world = World::new();
    let gcm = HostProcess::start_gcm(&world);
    let attached = HostProcess::start_with(&world, "lab", &["--gcm", gcm.address()]);
    let pid = attached.pid().to_string();
    let refused = host_at(&world, "other", attached.address(), &[]);
    says(&refused, "LISTEN", &["the host `lab`", &pid, &format!("the GCM at {} manages", gcm.address())]);
    let again = host_at(&world, "lab", attached.address(), &["--gcm", gcm.address()]);
    says(&again, "PROCESS_EXISTS", &["`lab` is taken", &pid, attached.address()]);
}

#[test]
fn a_host_whose_gcm_is_gone_is_named_as_a_host_of_that_gcm() {
    let world = World::new();
    let mut gcm = HostProcess::start_gcm(&world);
    let attached = HostProcess::start_with(&world, "lab", &["--gcm", gcm.address()]);
    gcm.kill();
    let refused = host_at(&world, "other", attached.address(), &[]);
    says(&refused, "LISTEN", &[&format!("a host of the GCM at {}", gcm.address())]);
}

#[test]
fn a_system_file_at_a_taken_address_names_who_is_there() {
    let world = World::new();
    let host = HostProcess::start(&world);
    let file =
        world.write("system.json", r#"{ "version": 1, "processes": { "host": {} }, "components": {} }"#);
    let run = ["run", &file.display().to_string(), "--listen", host.address()];
    let pid = host.pid().to_string();
    Trocar::new(&world).run(&run).ends_with(REFUSED).says(&pid).says("--listen 127.0.0.1:0");
}

/// What a program that is not trocar does with whoever calls.
type Manners = fn(TcpStream);

/// Keeps the calls it does not answer open.
fn say_nothing(stream: TcpStream) {
    // As a number nobody closes: to the end of this process.
    let _ = stream.into_raw_fd();
}

fn hang_up(stream: TcpStream) {
    drop(stream);
}

fn answer_as_a_web_server(mut stream: TcpStream) {
    let _ = stream.read(&mut [0; 1024]);
    let _ = stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n");
}

#[test]
fn whatever_is_not_trocar_is_called_a_program_and_offered_no_gcm() {
    let world = World::new();
    let strangers: [(&str, Manners); 3] =
        [("silent", say_nothing), ("curt", hang_up), ("a web server", answer_as_a_web_server)];
    for (what, manners) in strangers {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let called = thread::spawn(move || listener.incoming().flatten().take(1).for_each(manners));
        let refused = host_at(&world, "lab", &address, &[]);
        says(&refused, "LISTEN", &[&address, "does not answer as trocar does", "ss -ltnp"]);
        assert!(!refused.to_string().contains("--gcm"), "{what}: there is no GCM to join: {refused}");
        eventually("the program was asked", || if called.is_finished() { Ok(()) } else { Err(what) });
    }
}
