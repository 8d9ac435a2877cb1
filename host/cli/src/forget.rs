//! `trocar forget`: processes that have ended, off the list.

use clap::Args;

use super::failure::Done;
use super::mutation::{MutationArgs, show};
use super::session::Session;

/// Takes processes that have ended off the list, with their components. One that comes back is listed again.
#[derive(Args, Debug)]
pub(super) struct ForgetArgs {
    /// Names of processes that are LOST or FAILED.
    #[arg(value_name = "PROCESS", required = true)]
    processes: Vec<String>,
    #[command(flatten)]
    mutation: MutationArgs,
}

pub(super) async fn run(args: ForgetArgs, session: &Session) -> Done {
    forget(&args.processes, &args.mutation, session).await
}

/// Forgets all of them, or none.
pub(super) async fn forget(processes: &[String], mutation: &MutationArgs, session: &Session) -> Done {
    let outcome = session.forget(processes, mutation).await?;
    show(session, &outcome, mutation.dry_run, &format!("forgotten: {}", processes.join(", ")))
}
