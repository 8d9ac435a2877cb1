//! `trocar create host/sine sine`.
//!
//! Invariant: a setting that is not typed is not sent, so the class's default applies.

use clap::{Args, ValueEnum};
use serde_json::Value;

use super::execution::ExecutionArgs;
use super::failure::Done;
use super::mutation::{MutationArgs, show};
use super::session::Session;
use super::typed::json_object;

/// Creates a component: `trocar create host/sine sine`.
#[derive(Args, Debug)]
pub(super) struct CreateArgs {
    /// Where: process/component.
    pub(super) path: String,
    /// Of what class: plugin/class, or the class alone where it is unique (`trocar ls` lists them).
    pub(super) class: String,
    /// Configuration, a JSON object; what is left out takes the class's default.
    #[arg(long, value_name = "JSON", value_parser = json_object)]
    pub(super) config: Option<Value>,
    /// A process of its own: it is then PROCESS.COMPONENT/COMPONENT. Whoever keeps its process makes it
    /// (`trocar up`).
    #[arg(long, value_enum, value_name = "KIND")]
    pub(super) isolation: Option<Isolation>,
    #[command(flatten)]
    pub(super) execution: ExecutionArgs,
    #[command(flatten)]
    pub(super) mutation: MutationArgs,
}

/// Kinds of isolation of a component.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Isolation {
    Process,
}

pub(super) async fn run(args: CreateArgs, session: &Session) -> Done {
    let outcome = session.create(&args).await?;
    let done = format!("created {}", args.path);
    show(session, &outcome, args.mutation.dry_run, &done)
}
