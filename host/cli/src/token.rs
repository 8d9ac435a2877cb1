//! `trocar token`: the secret that lets another user's program change things at this user's hosts.
//!
//! Invariant: asks no GCM; prints the token and nothing else, so that a shell can put it where it is needed.

use clap::Args;
use serde_json::json;

use super::failure::{Done, Exit, Failure};
use super::out;
use super::session::Session;
use trocar::runtime_dir::RuntimeDir;

const EXAMPLES: &str = "\
Examples:
  grpcurl -plaintext -H \"authorization: Bearer $(trocar token)\" 127.0.0.1:50551 trocar.v1.GcmService/List
      Asks with your right from a program that the host takes for another user's, such as one in a container.
  TROCAR_TOKEN=TOKEN trocar stop host/**
      The same for `trocar`, a host with --gcm, and Python, as another user to whom you gave it.";

/// Prints your token: who sends it may change things at your hosts.
///
/// Your own programs, and root's, need none: the kernel tells a host whose they are. Another user reads
/// without it. It lies in the user's state directory, for your eyes only; removing the file withdraws it, and
/// the next call makes another.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct TokenArgs {}

pub(super) fn run(_args: &TokenArgs, session: &Session) -> Done {
    let dir = RuntimeDir::of_user();
    let token = dir.token().map_err(|e| {
        let help = "remove the file `token` there, or set XDG_STATE_HOME to a directory you may write to";
        Failure::local("STATE_UNWRITABLE", format!("no token in {}: {e}", dir.path().display()), help)
    })?;
    if session.json() {
        return session.print_json(&json!({ "token": token }));
    }
    out::line(&token);
    Ok(Exit::Ok)
}
