//! `trocar down FILE|NAME`: takes a system down that `trocar up` keeps.
//!
//! Invariant: it answers when everything is down, devices safe first. Processes that did not end in order
//! are named, and their devices may not be safe. A system without a supervisor is told apart from one that
//! does not answer.

use std::path::Path;

use clap::Args;
use serde_json::json;

use super::failure::{Done, Exit, Failure};
use super::session::Session;
use super::{out, up};
use trocar::processes::{Answer, Door};

/// Takes a system down that `trocar up` keeps, devices safe first.
#[derive(Args, Debug)]
pub(super) struct DownArgs {
    /// Its system file, or its name.
    #[arg(value_name = "FILE|NAME")]
    system: String,
}

pub(super) async fn run(args: DownArgs, session: &Session) -> Done {
    let is_file = args.system.contains('/') || args.system.ends_with(".json");
    let name = if is_file { up::name_of(None, Path::new(&args.system))? } else { args.system };
    match Door::ask(&up::directory(&name)).await {
        Answer::Down(failed) => {
            if session.json() {
                session.print_json(&json!({ "name": name, "down": true, "not_in_order": failed }))?;
            } else {
                out::say(&format!("{name} is down"));
                for failed in &failed {
                    out::complain("warning", failed);
                }
            }
            Ok(if failed.is_empty() { Exit::Ok } else { Exit::Partial })
        }
        Answer::Nobody => Err(Failure::refused("NOT_UP", format!("no system {name} is up"), known().await)),
        Answer::Unknown(why) => Err(Failure::local(
            "UNKNOWN",
            format!("nobody knows whether {name} is down: {why}"),
            "`trocar ls` tells; its processes end by themselves when `trocar up` has ended",
        )),
    }
}

/// Names the systems that are up.
async fn known() -> String {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(up::directories()).into_iter().flatten().flatten() {
        if Door::is_open(&entry.path()).await {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    if names.is_empty() {
        "none is up: `trocar up FILE`".to_owned()
    } else {
        format!("up are: {}", names.join(", "))
    }
}
