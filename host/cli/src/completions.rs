//! `trocar completions SHELL`.
//!
//! Invariant: made from the same tree the parser uses.

use clap::{Args, Command};
use clap_complete::Shell;

use super::failure::Exit;
use super::out;

/// Prints completions for a shell: `source <(trocar completions bash)`.
#[derive(Args, Debug)]
pub(super) struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

pub(super) fn run(args: &CompletionsArgs) -> Exit {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut offered(super::command()), "trocar", &mut script);
    out::text(&String::from_utf8_lossy(&script));
    Exit::Ok
}

/// Returns the tree without hidden commands: clap leaves them out of help, but not out of completions.
fn offered(tree: Command) -> Command {
    let subcommands = tree.get_subcommands().filter(|sub| !sub.is_hide_set());
    let shown = Command::new("trocar").args(tree.get_arguments()).subcommands(subcommands.cloned());
    shown.disable_help_subcommand(true).version(env!("CARGO_PKG_VERSION"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_hidden_is_not_offered_and_everything_else_is() {
        let (all, shown) = (super::super::command(), offered(super::super::command()));
        let names = |c: &Command| c.get_subcommands().map(|s| s.get_name().to_owned()).collect::<Vec<_>>();
        let wanted: Vec<String> = names(&all).into_iter().filter(|n| n != "__vet").collect();
        assert_eq!(names(&shown), wanted);
        let mut script = Vec::new();
        clap_complete::generate(Shell::Bash, &mut offered(super::super::command()), "trocar", &mut script);
        let script = String::from_utf8_lossy(&script);
        assert!(!script.contains("__vet") && script.contains("--gcm") && script.contains("wait"));
    }
}
