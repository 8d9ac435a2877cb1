//! `trocar configure host/robot '{"seed": 8}'`.
//!
//! Invariant: the JSON is a merge patch (RFC 7396), sent as it was typed.

use clap::Args;
use serde_json::Value;

use super::create::json_object;
use super::failure::Done;
use super::mutation::{MutationArgs, show};
use super::session::Session;

/// Changes a component's configuration: `trocar configure host/robot '{"seed": 8}'`.
#[derive(Args, Debug)]
pub(super) struct ConfigureArgs {
    /// The component: process/component.
    pub(super) path: String,
    /// What changes, a JSON object; null removes a value.
    #[arg(value_name = "JSON", value_parser = json_object)]
    pub(super) config: Value,
    #[command(flatten)]
    pub(super) mutation: MutationArgs,
}

pub(super) async fn run(args: ConfigureArgs, session: &Session) -> Done {
    let outcome = session.configure(&args).await?;
    show(session, &outcome, args.mutation.dry_run, &format!("configured {}", args.path))
}
