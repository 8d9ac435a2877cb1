//! `trocar up --detach`: the same program, left running.
//!
//! Invariant: it answers what the one left running would have, when that is up or has given up; nothing of the terminal
//! stays with it.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::cli::failure::{Done, Exit, Failure};
use crate::cli::out;
use crate::cli::session::Session;

pub(super) async fn run(place: &Path, name: &str, session: &Session) -> Done {
    let io = |what: &str, e: std::io::Error| {
        Failure::local("IO", format!("{what}: {e}"), "look at the directory and its permissions")
    };
    let log = place.join("up.log");
    let shown = log.display().to_string();
    std::fs::create_dir_all(place).map_err(|e| io(&place.display().to_string(), e))?;
    let errors = File::options().create(true).append(true).open(&log).map_err(|e| io(&shown, e))?;
    let program = std::env::current_exe().map_err(|e| io("cannot find this program", e))?;
    let mut child = Command::new(program)
        .args(std::env::args_os().skip(1).filter(|a| a != "--detach" && a != "--json"))
        .args(["--detached", "--json"])
        .process_group(0)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(errors)
        .spawn()
        .map_err(|e| io("cannot start what is to be left running", e))?;
    let stdout = child.stdout.take();
    let reading = tokio::task::spawn_blocking(move || {
        let mut line = String::new();
        stdout.map(|stdout| BufReader::new(stdout).read_line(&mut line));
        line
    });
    let line = reading.await.unwrap_or_default();
    let said: Value = serde_json::from_str(&line).unwrap_or_default();
    if said.get("listening").is_none() {
        return Err(refused(&said, &shown));
    }
    if session.json() {
        out::line(line.trim_end());
    } else {
        let text = |key: &str| said[key].as_str().unwrap_or_default().to_owned();
        out::say(&format!("{name} is up: GCM {}, pid {}", text("listening"), said["pid"]));
        out::line(&format!("  `trocar down {name}` takes it down; it writes to {shown}"));
    }
    let idle = said["not_active"].as_array().cloned().unwrap_or_default();
    for part in &idle {
        let text = |key: &str| part[key].as_str().unwrap_or_default().to_owned();
        out::complain("warning", &format!("{} does not run, it is {}", text("path"), text("stands")));
    }
    Ok(if idle.is_empty() { Exit::Ok } else { Exit::Partial })
}

fn refused(said: &Value, log: &str) -> Failure {
    let text = |key: &str| said[key].as_str().unwrap_or_default().to_owned();
    if text("reason").is_empty() {
        let help = format!("its last words are in {log}");
        return Failure::local("PROCESS_NOT_UP", "it ended before anything was up", help);
    }
    let metadata = said["metadata"].as_object().into_iter().flatten();
    let metadata = metadata.map(|(k, v)| (k.clone(), v.as_str().unwrap_or_default().to_owned())).collect();
    Failure::answered(&text("code"), &text("reason"), text("message"), text("help"), metadata)
}
