//! `trocar configure host/sine '{"amplitude": 2}'`, `trocar configure host/robot --rate-hz 500`.
//!
//! Invariant: the JSON is a merge patch (RFC 7396), sent as it was typed; settings that were not typed
//! stay as they are.

use clap::Args;
use serde_json::Value;

use super::execution::ExecutionArgs;
use super::failure::{Done, Failure};
use super::mutation::{MutationArgs, show_after};
use super::session::Session;
use super::typed::json_object;

/// Changes a component's configuration, or where its thread comes from:
/// `trocar configure host/sine '{"amplitude": 2}'`.
#[derive(Args, Debug)]
pub(super) struct ConfigureArgs {
    /// The component: process/component.
    pub(super) path: String,
    /// What changes, a JSON object; null removes a value.
    #[arg(value_name = "JSON", value_parser = json_object)]
    pub(super) config: Option<Value>,
    #[command(flatten)]
    pub(super) execution: ExecutionArgs,
    #[command(flatten)]
    pub(super) mutation: MutationArgs,
}

pub(super) async fn run(args: ConfigureArgs, session: &Session) -> Done {
    if args.config.is_none() && args.execution.is_empty() {
        return Err(Failure::usage(
            format!("nothing of {} is to be changed", args.path),
            "give settings as JSON, '{\"seed\": 8}', or execution settings, --rate-hz 500; see `trocar configure --help`",
        ));
    }
    let outcome = session.configure(&args).await?;
    let done = match outcome.plan.as_slice() {
        [] => format!("{} has these settings already", args.path),
        steps => steps.join("\n"),
    };
    show_after(session, &outcome, args.mutation.dry_run, &done)
}
