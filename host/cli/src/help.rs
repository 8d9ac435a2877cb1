//! `trocar help`: the subcommands by what one wants to do.
//!
//! Invariant: every subcommand that is offered stands under one task, once.

use std::fmt::Write as _;

use clap::Args;

use super::failure::{Done, Exit, Failure};
use super::out;
use trocar_model::nearest;

/// Shows the subcommands by task, or the help of one: `trocar help create`.
#[derive(Args, Debug)]
pub(super) struct HelpArgs {
    /// A subcommand, and one of its own where it has such: `trocar help plugin new`.
    #[arg(value_name = "SUBCOMMAND")]
    of: Vec<String>,
}

const TASKS: &[(&str, &[&str])] = &[
    ("Begin", &["demo", "doctor", "help", "completions"]),
    ("Run a system", &["run", "up", "down", "host", "gcm", "agent", "restart", "forget"]),
    ("System files", &["check", "save", "apply", "diff", "schema"]),
    (
        "See what there is and how it goes",
        &["ls", "describe", "graph", "top", "watch", "logs", "journal", "wait"],
    ),
    ("Build a graph", &["create", "configure", "connect", "disconnect", "rm"]),
    ("Start and stop", &["start", "stop", "resume", "reset"]),
    ("Commands and data", &["call", "echo", "hz"]),
    ("Recordings", &["record", "info", "export"]),
    ("Plugins and access", &["plugin", "token", "ca"]),
];

/// Columns of the names, and of a line.
const NAMES: usize = 14;
const WIDTH: usize = 100;

/// The whole help of the program, but for its options.
pub(super) const TEMPLATE: &str =
    "{about-with-newline}\n{usage-heading} {usage}\n\n{after-help}\n\nOptions:\n{options}";

/// The tasks, and what each subcommand of them does.
pub(super) fn by_task(program: &clap::Command) -> String {
    let mut text = String::new();
    for (task, names) in TASKS {
        let _ = writeln!(text, "{task}:");
        for name in *names {
            let about = program.find_subcommand(name).and_then(clap::Command::get_about);
            let about = about.map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(text, "  {name:<width$}{}", wrapped(&about), width = NAMES - 2);
        }
        text.push('\n');
    }
    text.push_str("Each says more: `trocar help create`, `trocar create --help`.");
    text
}

/// Wraps a text to the width, the second and later lines below the first.
fn wrapped(text: &str) -> String {
    let mut out = String::new();
    let mut column = NAMES;
    for word in text.split_whitespace() {
        let long = word.chars().count();
        if column > NAMES && column + 1 + long > WIDTH {
            let _ = write!(out, "\n{:NAMES$}", "");
            column = NAMES;
        } else if column > NAMES {
            out.push(' ');
            column += 1;
        }
        out.push_str(word);
        column += long;
    }
    out
}

pub(super) fn run(args: &HelpArgs, mut program: clap::Command) -> Done {
    program.build();
    let mut at = &mut program;
    for name in &args.of {
        let known: Vec<String> = offered(at).map(str::to_owned).collect();
        at = match at.find_subcommand_mut(name) {
            Some(sub) => sub,
            None => {
                let near = nearest(name, known.iter().map(String::as_str));
                let near = near.map(|n| format!("did you mean `{n}`? ")).unwrap_or_default();
                let help = format!("{near}there are {}", known.join(", "));
                return Err(Failure::usage(format!("no subcommand is called {name}"), help));
            }
        };
    }
    out::text(&at.render_long_help().to_string());
    Ok(Exit::Ok)
}

/// Names of the subcommands that are not hidden.
fn offered(command: &clap::Command) -> impl Iterator<Item = &str> {
    command.get_subcommands().filter(|sub| !sub.is_hide_set()).map(clap::Command::get_name)
}

#[cfg(test)]
mod tests {
    use super::super::command;
    use super::*;

    #[test]
    fn every_subcommand_stands_under_one_task_and_nothing_else_does() {
        let program = command();
        let mut listed: Vec<&str> = TASKS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        let mut offered: Vec<&str> = offered(&program).collect();
        listed.sort_unstable();
        offered.sort_unstable();
        assert_eq!(listed, offered);
    }

    #[test]
    fn help_fits_the_width_and_names_each_subcommand_with_its_sentence() {
        let text = command().render_long_help().to_string();
        let wide: Vec<&str> = text.lines().filter(|line| line.chars().count() > 110).collect();
        assert!(wide.is_empty(), "{wide:#?}");
        for words in ["Run a system:", "  create      Creates a component", "Recordings:", "--json"] {
            assert!(text.contains(words), "{words} is missing:\n{text}");
        }
    }

    #[test]
    fn a_subcommand_that_is_none_is_refused_with_the_nearest() {
        let refused = run(&HelpArgs { of: vec!["creat".into()] }, command()).unwrap_err();
        assert!(refused.help.contains("did you mean `create`?"), "{}", refused.help);
    }
}
