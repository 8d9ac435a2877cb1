//! The commands that texts of the program tell a person to type, against the command line there is.
//!
//! Invariant: every command and option in backticks in the sources is one that clap takes; words in capitals
//! and holes of a format stand for a value.

use std::path::{Path, PathBuf};

use clap::error::{ContextKind, ContextValue, ErrorKind};

/// Places of texts for people.
const SOURCES: [&str; 7] =
    ["src", "../src", "../model/src", "../links/src", "../loader/src", "../lcm/src", "../rt/src"];

#[test]
fn every_command_a_text_names_is_taken_by_the_command_line() {
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for (file, command) in spoken("`trocar ") {
        seen += 1;
        let words = words(&command);
        if let Err(e) = trocar_cli::command().try_get_matches_from(&words)
            && !is_a_mention(&e)
        {
            wrong.push(format!("{}: `{command}`, as {words:?}: {}", file.display(), e.to_string().trim()));
        }
    }
    assert!(seen > 60, "only {seen} commands were found in the sources");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_option_a_text_names_alone_is_one_of_some_subcommand() {
    let mut all = Vec::new();
    options(&trocar_cli::command(), &mut all);
    let named: Vec<_> = spoken("`--").collect();
    let (mut wrong, mut seen) = (Vec::new(), 0);
    for (file, text) in named {
        seen += 1;
        let option = text.trim_start_matches('-').split([' ', '=']).next().unwrap_or_default();
        if !all.iter().any(|known| known == option) {
            wrong.push(format!("{}: `{text}`", file.display()));
        }
    }
    assert!(seen > 5, "only {seen} options were found in the sources");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// It names a verb or an option without saying everything that belongs to it.
fn is_a_mention(error: &clap::Error) -> bool {
    use ErrorKind::*;
    let no_value = error.get(ContextKind::InvalidValue) == Some(&ContextValue::String(String::new()));
    match error.kind() {
        DisplayHelp | DisplayHelpOnMissingArgumentOrSubcommand | DisplayVersion => true,
        MissingRequiredArgument | MissingSubcommand => true,
        InvalidValue => no_value,
        _ => false,
    }
}

/// Every text between backticks that begins so, the opening backtick left out, with its file.
fn spoken(begin: &str) -> impl Iterator<Item = (PathBuf, String)> {
    let begin = begin.to_owned();
    sources().into_iter().flat_map(move |file| {
        let text = for_people(&std::fs::read_to_string(&file).unwrap());
        let begins = text.match_indices(&begin).map(|(at, _)| &text[at + 1..]);
        let whole = begins.filter_map(|rest| rest.split_once('`').map(|(inside, _)| one_line(inside)));
        whole.map(|inside| (file.clone(), inside)).collect::<Vec<_>>()
    })
}

/// A source without the comments for its maintainers, which abbreviate; those of arguments are help.
fn for_people(source: &str) -> String {
    let is_ours = |line: &str| line.starts_with("//") && !line.starts_with("///");
    source.lines().filter(|line| !is_ours(line.trim_start())).collect::<Vec<_>>().join("\n")
}

fn sources() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut open, mut files) = (SOURCES.map(|dir| root.join(dir)).to_vec(), Vec::new());
    while let Some(dir) = open.pop() {
        for path in std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                files.push(path);
            }
        }
    }
    files
}

/// Lines of a string or of a comment, joined.
fn one_line(text: &str) -> String {
    let lines = text.lines().map(|line| {
        let line = line.trim().trim_end_matches('\\').trim_end();
        line.trim_start_matches('/').trim_start_matches('!').trim_start()
    });
    lines.collect::<Vec<_>>().join(" ").replace("\\\"", "\"")
}

/// The words as a shell parts them, with values for what stands for one; what follows another command is left
/// out.
fn words(command: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quoted = false;
    for c in command.chars() {
        match c {
            '\'' => quoted = !quoted,
            ' ' if !quoted => words.push(String::new()),
            c => words.last_mut().unwrap().push(c),
        }
    }
    let more = |word: &String| !["|", "&&", ">", "&"].contains(&word.as_str());
    words.iter().take_while(|word| more(word)).map(|word| value(word)).collect()
}

fn value(word: &str) -> String {
    let mut out = String::new();
    let mut rest = word;
    while let Some((before, after)) = rest.split_once('{') {
        let Some((hole, behind)) = after.split_once('}') else { break };
        let is_hole = hole.chars().all(|c| c.is_alphanumeric() || "_:?".contains(c));
        out += before;
        out += &if is_hole { "robot".to_owned() } else { format!("{{{hole}}}") };
        rest = behind;
    }
    out += rest;
    match out.as_str() {
        "STATE" => "ACTIVE".into(),
        "TIME" => "1s".into(),
        "N" | "HZ" => "1".into(),
        "…" => "robot".into(),
        _ => out,
    }
}

fn options(command: &clap::Command, all: &mut Vec<String>) {
    all.extend(command.get_arguments().filter_map(|arg| arg.get_long().map(str::to_owned)));
    all.extend(["help".to_owned(), "version".to_owned()]);
    for sub in command.get_subcommands() {
        options(sub, all);
    }
}
