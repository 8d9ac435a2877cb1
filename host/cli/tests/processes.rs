//! The built binary as a process: where it listens, how it refuses, how it ends, what it leaves behind.
//!
//! Invariant: each test has its own directories and ports; children are ended by their handle.
#![allow(clippy::unwrap_used)]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;

/// An address nobody listens on: port 1 is reserved.
const NOBODY: &str = "127.0.0.1:1";

fn trocar(home: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trocar"));
    command.args(args).env("XDG_STATE_HOME", home).env_remove("TROCAR_GCM").env("TROCAR_LOG", "warn");
    command
}

fn finish(home: &Path, args: &[&str]) -> (i32, Value, String) {
    let Output { status, stdout, stderr } = trocar(home, args).output().unwrap();
    let json = serde_json::from_slice(&stdout).unwrap_or(Value::Null);
    (status.code().unwrap_or(-1), json, String::from_utf8_lossy(&stderr).into_owned())
}

/// A running process, ended with its handle.
struct Running {
    child: Child,
    addr: String,
}

impl Running {
    fn start(home: &Path, args: &[&str]) -> Running {
        let mut child = trocar(home, args).arg("--json").stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let said: Value = serde_json::from_str(&line).unwrap_or_else(|e| panic!("first line {line:?}: {e}"));
        let addr = said["listening"].as_str().unwrap_or_else(|| panic!("no address in {line}")).to_owned();
        Running { child, addr }
    }

    /// Ctrl-C; the exit code.
    fn interrupt(mut self) -> i32 {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        self.child.wait().unwrap().code().unwrap_or(-1)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn host(home: &Path) -> Running {
    let plugins = home.join("plugins");
    std::fs::create_dir_all(&plugins).unwrap();
    Running::start(home, &["host", "--listen", "127.0.0.1:0", "--plugins", plugins.to_str().unwrap()])
}

#[test]
fn an_empty_host_is_listed_and_ends_with_code_0_on_ctrl_c() {
    let home = tempfile::tempdir().unwrap();
    let host = host(home.path());
    let (code, system, stderr) = finish(home.path(), &["ls", "--json", "--gcm", &host.addr]);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(system["processes"][0]["name"], "host", "{system}");
    assert_eq!(system["components"], serde_json::json!([]), "{system}");
    assert_eq!(host.interrupt(), 0, "Ctrl-C is how a host is ended");
}

#[test]
fn a_refusal_keeps_its_reason_and_answers_code_1() {
    let home = tempfile::tempdir().unwrap();
    let host = host(home.path());
    let args = ["create", "host/x", "nothing", "--json", "--gcm", &host.addr];
    let (code, refusal, _) = finish(home.path(), &args);
    assert_eq!((code, &refusal["reason"]), (1, &Value::from("CLASS_NOT_FOUND")), "{refusal}");
    let (_, _, stderr) = finish(home.path(), &["describe", "host/x/y/z/w", "--gcm", &host.addr]);
    assert!(stderr.starts_with("error: ") && stderr.contains("\n help: "), "{stderr}");
}

#[test]
fn without_a_gcm_the_code_is_3_and_a_wrong_flag_is_2() {
    let home = tempfile::tempdir().unwrap();
    let (code, answer, _) = finish(home.path(), &["ls", "--json", "--gcm", NOBODY]);
    assert_eq!((code, &answer["reason"]), (3, &Value::from("NO_GCM")), "{answer}");
    let (code, answer, _) = finish(home.path(), &["ls", "--json", "--bogus"]);
    assert_eq!((code, &answer["reason"]), (2, &Value::from("USAGE")), "{answer}");
}

#[test]
fn stop_all_reaches_every_process_without_a_gcm() {
    let home = tempfile::tempdir().unwrap();
    let host = host(home.path());
    let (code, answer, stderr) = finish(home.path(), &["stop", "--all", "--json", "--gcm", NOBODY]);
    assert_eq!(code, 0, "{answer} {stderr}");
    assert_eq!(answer["processes"][0]["pid"], host.child.id(), "{answer}");
    assert_eq!(answer["processes"][0]["stopped"], true, "{answer}");
}

#[test]
fn a_second_process_in_the_same_state_directory_is_refused() {
    let home = tempfile::tempdir().unwrap();
    let first = host(home.path());
    let plugins = home.path().join("plugins");
    let args = ["host", "--json", "--listen", "127.0.0.1:0", "--plugins", plugins.to_str().unwrap()];
    let (code, refusal, _) = finish(home.path(), &args);
    assert_eq!((code, &refusal["reason"]), (1, &Value::from("STATE_IN_USE")), "{refusal}");
    let message = refusal["message"].as_str().unwrap_or_default();
    assert!(message.contains(&format!("process {}", first.child.id())), "{message}");
}

#[test]
fn a_taken_port_is_refused_with_the_remedy_and_leaves_nothing_behind() {
    let home = tempfile::tempdir().unwrap();
    let first = host(home.path());
    let state = home.path().join("second");
    let args = ["gcm", "--json", "--listen", &first.addr, "--state", state.to_str().unwrap()];
    let (code, refusal, _) = finish(home.path(), &args);
    assert_eq!((code, &refusal["reason"]), (1, &Value::from("LISTEN")), "{refusal}");
    assert!(refusal["help"].as_str().unwrap_or_default().contains("--gcm"), "{refusal}");
    assert!(!state.exists(), "half a state directory was left behind");
}

#[test]
fn a_missing_plugin_directory_is_refused_and_leaves_nothing_behind() {
    let home = tempfile::tempdir().unwrap();
    let state = home.path().join("state");
    let args = ["host", "--json", "--listen", "127.0.0.1:0", "--plugins", "/nowhere", "--state"];
    let (code, refusal, _) = finish(home.path(), &[&args[..], &[state.to_str().unwrap()]].concat());
    assert_eq!((code, &refusal["reason"]), (1, &Value::from("PLUGIN_DIR")), "{refusal}");
    assert!(!state.exists(), "half a state directory was left behind");
}

#[test]
fn a_system_file_is_refused_with_its_place() {
    let home = tempfile::tempdir().unwrap();
    let file = home.path().join("system.json");
    std::fs::write(&file, "{\n \"version\": 1,\n \"component\": {}\n}").unwrap();
    let args = ["run", "--json", "--listen", "127.0.0.1:0", file.to_str().unwrap()];
    let (code, refusal, _) = finish(home.path(), &args);
    assert_eq!((code, &refusal["reason"]), (1, &Value::from("SYSTEM_FILE")), "{refusal}");
    assert_eq!((&refusal["metadata"]["line"], &refusal["metadata"]["column"]), (&"3".into(), &"2".into()));
}

#[test]
fn run_is_ephemeral() {
    let home = tempfile::tempdir().unwrap();
    let (file, temp) = (home.path().join("system.json"), home.path().join("tmp"));
    std::fs::create_dir_all(&temp).unwrap();
    std::fs::write(&file, r#"{"version": 1, "processes": {"solo": {"plugins": ["."]}}}"#).unwrap();
    let mut command = trocar(home.path(), &["run", "--json", "--listen", "127.0.0.1:0", "--seconds", "1"]);
    let Output { status, stderr, .. } = command.arg(&file).env("TMPDIR", &temp).output().unwrap();
    assert!(status.success(), "{}", String::from_utf8_lossy(&stderr));
    assert_eq!(
        std::fs::read_dir(&temp).unwrap().count(),
        0,
        "the state of an ephemeral process is still there"
    );
}
