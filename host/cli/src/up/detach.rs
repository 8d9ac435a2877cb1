//! `trocar up --detach`: the same program, left running.
//!
//! Invariant: the command answers what the program left running would have, when that is up or has given up.
//! Until then both end together, and afterwards nothing of the terminal stays with that program.

use std::ffi::OsString;
use std::fs::{DirBuilder, File};
use std::io::ErrorKind;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use serde_json::Value;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::process::{Child, Command};

use super::UpArgs;
use crate::failure::{Done, Exit, Failure};
use crate::out;
use crate::session::Session;
use trocar::host::StopRequest;

/// Size of the log, bytes, above which the text of earlier programs is forgotten.
const OLD: u64 = 1 << 20;

/// Returns the log file of the program that is left running.
pub(super) fn log(place: &Path) -> PathBuf {
    place.join("up.log")
}

pub(super) async fn run(args: &UpArgs, place: &Path, name: &str, session: &Session) -> Done {
    let mut stop = StopRequest::listen();
    let log = log(place);
    let (mut child, shown) = (spawn(args, place, &log, session)?, log.display().to_string());
    let mut line = String::new();
    if let Some(stdout) = child.stdout.take() {
        let mut stdout = BufReader::new(stdout);
        tokio::select! {
            // A child that ends prints its answer before.
            _ = stdout.read_line(&mut line) => {}
            () = stop.asked() => {
                // The child is tied to this program, and ends in order.
                drop(child.stdin.take());
                ended(&mut child).await;
                return Ok(Exit::Interrupted);
            }
        }
    }
    let said: Value = serde_json::from_str(&line).unwrap_or_default();
    if said.get("listening").is_none() {
        return Err(refused(&said, &shown, ended(&mut child).await));
    }
    if let Some(mut tie) = child.stdin.take() {
        // From here on the child is on its own.
        let _ = tie.write_all(b"ok\n").await;
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

fn spawn(args: &UpArgs, place: &Path, log: &Path, session: &Session) -> Result<Child, Failure> {
    let io = |what: &str, e: std::io::Error| {
        Failure::local("IO", format!("{what}: {e}"), "look at the directory and its permissions")
    };
    let made = DirBuilder::new().recursive(true).mode(0o700).create(place);
    made.map_err(|e| io(&place.display().to_string(), e))?;
    let is_long = std::fs::metadata(log).is_ok_and(|m| m.len() > OLD);
    if is_long {
        let old = log.with_extension("old.log");
        let moved = std::fs::rename(log, old).or_else(|e| match e.kind() {
            ErrorKind::NotFound => Ok(()),
            _ => Err(e),
        });
        moved.map_err(|e| io(&log.display().to_string(), e))?;
    }
    let errors = File::options().create(true).append(true).open(log);
    let errors = errors.map_err(|e| io(&log.display().to_string(), e))?;
    let program = std::env::current_exe().map_err(|e| io("cannot find this program", e))?;
    Command::new(program)
        .args(again(args, session.explicit_gcm()))
        .process_group(0)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(errors)
        .spawn()
        .map_err(|e| io("cannot start what is to be left running", e))
}

/// Returns the arguments of this call, for the program that is left running.
fn again(args: &UpArgs, gcm: Option<&str>) -> Vec<OsString> {
    let mut all: Vec<OsString> = ["up", "--json", "--detached"].map(Into::into).into();
    // Joined, so that no value is taken for a flag.
    let mut give = |flag: &str, value: OsString| {
        let mut text = OsString::from(format!("--{flag}="));
        text.push(value);
        all.push(text);
    };
    give("listen", args.listen.clone().into());
    args.named.system.sets.iter().for_each(|set| give("set", set.into()));
    args.named.plugins.iter().for_each(|dir| give("plugins", dir.into()));
    args.name.iter().for_each(|name| give("name", name.as_str().into()));
    let machines = &args.machines;
    machines.listen_tls.iter().for_each(|addr| give("listen-tls", addr.into()));
    machines.revoked.iter().for_each(|file| give("revoked", file.into()));
    crate::session::identity().into_iter().for_each(|file| give("identity", file.into()));
    gcm.into_iter().for_each(|addr| give("gcm", addr.into()));
    all.extend(args.port.flags().map(Into::into));
    all.push("--".into());
    all.push(args.named.system.file.clone().into());
    all
}

/// Waits for the end of the child; returns its exit as that of this program.
async fn ended(child: &mut Child) -> Exit {
    let code = child.wait().await.ok().and_then(|status| status.code());
    let known = [Exit::Usage, Exit::NoGcm, Exit::TimedOut, Exit::Partial, Exit::Interrupted];
    known.into_iter().find(|exit| Some(*exit as i32) == code).unwrap_or(Exit::Refused)
}

fn refused(said: &Value, log: &str, exit: Exit) -> Failure {
    let text = |key: &str| said[key].as_str().unwrap_or_default().to_owned();
    if text("reason").is_empty() {
        let help = format!("its last words are in {log}");
        return Failure::local("PROCESS_NOT_UP", "it ended before anything was up", help);
    }
    let metadata = said["metadata"].as_object().into_iter().flatten();
    let metadata = metadata.map(|(k, v)| (k.clone(), v.as_str().unwrap_or_default().to_owned())).collect();
    let failure = Failure::answered(&text("code"), &text("reason"), text("message"), text("help"), metadata);
    Failure { exit, ..failure }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use clap::{CommandFactory, FromArgMatches, Parser};

    use super::*;

    #[derive(Parser)]
    struct Typed {
        #[command(flatten)]
        up: UpArgs,
    }

    #[test]
    fn what_was_asked_is_said_anew_whatever_it_looks_like() {
        let line = ["up", "--detach", "--set=a/x.k=--json", "--plugins=-p", "--name", "n", "--", "--detach"];
        let typed = Typed::try_parse_from(line).unwrap().up;
        let again = again(&typed, None);
        let read = Typed::command().arg(clap::Arg::new("json").long("json").num_args(0));
        let read = read.try_get_matches_from(&again).unwrap();
        let read = Typed::from_arg_matches(&read).unwrap().up;
        assert!(read.detached && !read.detach, "{again:?}");
        assert_eq!(
            (read.named.system.file, read.named.system.sets, read.named.plugins),
            (typed.named.system.file, typed.named.system.sets, typed.named.plugins)
        );
        assert_eq!((read.name, read.listen), (typed.name, typed.listen));
        let gcm = super::again(&Typed::try_parse_from(line).unwrap().up, Some("h:1"));
        assert!(gcm.contains(&"--gcm=h:1".into()), "{gcm:?}");
    }
}
