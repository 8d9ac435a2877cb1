//! The command line's surface (names, flags, defaults, help) against `cli-surface.txt`.
//!
//! Invariant: a change of the surface is a change of that file: `TROCAR_BLESS=1 cargo test -p trocar-cli
//! --test cli_surface`.
#![allow(clippy::unwrap_used)]

#[path = "cli_surface/advice.rs"]
mod advice;

use std::fmt::Write as _;
use std::path::Path;

use clap::{ArgAction, Command};

#[test]
fn the_command_line_is_what_its_golden_file_says() {
    let mut command = trocar_cli::command();
    command.build();
    let mut surface = String::new();
    walk(&command, "", &mut surface);
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli-surface.txt");
    if std::env::var_os("TROCAR_BLESS").is_some() {
        std::fs::write(&golden, &surface).unwrap();
    }
    let expected = std::fs::read_to_string(&golden).unwrap_or_default();
    let differs = surface.lines().zip(expected.lines()).position(|(now, then)| now != then);
    let at = differs.unwrap_or(surface.lines().count().min(expected.lines().count()));
    assert!(
        surface == expected,
        "the command line differs from tests/cli-surface.txt at line {}: now {:?}, there {:?}; if that is meant: \
         TROCAR_BLESS=1 cargo test -p trocar-cli --test cli_surface",
        at + 1,
        surface.lines().nth(at),
        expected.lines().nth(at)
    );
}

#[test]
fn every_subcommand_and_every_argument_has_help() {
    let mut command = trocar_cli::command();
    command.build();
    let mut silent = Vec::new();
    find_silent(&command, &mut silent);
    assert!(silent.is_empty(), "without help: {silent:?}");
}

fn walk(command: &Command, path: &str, text: &mut String) {
    let path = format!("{path} {}", command.get_name()).trim_start().to_owned();
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    let hidden = if command.is_hide_set() { "  (hidden)" } else { "" };
    writeln!(text, "{path}{hidden}  {about}").unwrap();
    for arg in command.get_arguments().filter(|a| !a.is_global_set() || path == "trocar") {
        if matches!(arg.get_action(), ArgAction::Help | ArgAction::Version) {
            continue;
        }
        let mut line = String::new();
        match (arg.get_short(), arg.get_long()) {
            (Some(short), Some(long)) => write!(line, "-{short} --{long}").unwrap(),
            (None, Some(long)) => write!(line, "--{long}").unwrap(),
            (Some(short), None) => write!(line, "-{short}").unwrap(),
            (None, None) => write!(line, "{}", arg.get_id().as_str().to_uppercase()).unwrap(),
        }
        if arg.get_action().takes_values() {
            let names = arg.get_value_names().unwrap_or_default();
            write!(line, " <{}>", names.iter().map(|n| n.as_str()).collect::<Vec<_>>().join(" ")).unwrap();
        }
        let defaults: Vec<_> = arg.get_default_values().iter().map(|v| v.to_string_lossy()).collect();
        if !defaults.is_empty() {
            write!(line, " = {}", defaults.join(",")).unwrap();
        }
        let choices: Vec<_> = arg.get_possible_values().iter().map(|v| v.get_name().to_owned()).collect();
        if arg.get_action().takes_values() && !choices.is_empty() {
            write!(line, " [{}]", choices.join("|")).unwrap();
        }
        let required = if arg.is_required_set() { " (required)" } else { "" };
        let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
        writeln!(text, "    {line}{required}  {help}").unwrap();
    }
    for sub in command.get_subcommands() {
        walk(sub, &path, text);
    }
}

fn find_silent(command: &Command, silent: &mut Vec<String>) {
    if command.get_about().is_none() {
        silent.push(command.get_name().to_owned());
    }
    let args = command.get_arguments().filter(|a| a.get_help().is_none());
    silent.extend(args.map(|a| format!("{} {}", command.get_name(), a.get_id())));
    for sub in command.get_subcommands() {
        find_silent(sub, silent);
    }
}
