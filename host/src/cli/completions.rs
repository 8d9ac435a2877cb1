//! `trocar completions SHELL`.
//!
//! Invariant: made from the same tree the parser uses.

use clap::Args;
use clap_complete::Shell;

use super::failure::Exit;

/// Prints completions for a shell: `source <(trocar completions bash)`.
#[derive(Args, Debug)]
pub(super) struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

pub(super) fn run(args: &CompletionsArgs) -> Exit {
    clap_complete::generate(args.shell, &mut super::command(), "trocar", &mut std::io::stdout());
    Exit::Ok
}
