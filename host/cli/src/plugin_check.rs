//! `trocar plugin check FILE`: would a host load it? And `--as arm`: does a class offer what a standard
//! device interface asks for?
//!
//! Invariant: contracts are judged from the manifest, by the same tables that docs/INTERFACES.md is written
//! from, and no code of the file runs. Without a contract the file runs in a child process only, as it does
//! before a host loads it.

use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::PossibleValuesParser;
use serde_json::json;
use trocar_loader as loader;
use trocar_plugin_api::contracts::{self, CONTRACTS, Contract, Violation};
use trocar_plugin_api::manifest::Manifest;

use super::failure::{Done, Exit, Failure};
use super::plugin_inspect::{looked_at, refused};
use super::session::Session;
use super::{out, style};

/// Checks whether a host would load the file, tried in a child process; with --as, a class against the
/// contract of a standard device interface (docs/INTERFACES.md).
#[derive(Args, Debug)]
pub(super) struct CheckArgs {
    /// The .so file.
    file: PathBuf,
    /// The contract; without it the file's tables, entry and init are tried.
    #[arg(long = "as", value_name = "CONTRACT", value_parser = PossibleValuesParser::new(CONTRACTS.map(|c| c.name)))]
    contract: Option<String>,
    /// What the class calls the contract's interface, where it has several devices: arm_left.
    #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true, requires = "contract")]
    interface: String,
    /// The class, when the file has several.
    #[arg(long, value_name = "NAME", requires = "contract")]
    class: Option<String>,
}

/// One class, and its differences from the contract.
struct Judged {
    class: String,
    violations: Vec<Violation>,
}

pub(super) fn run(args: &CheckArgs, session: &Session) -> Done {
    let Some(contract) = &args.contract else { return tried(&args.file, session) };
    let contract = contracts::contract(contract)
        .map_err(|why| Failure::usage(why, "see `trocar plugin check --help`"))?;
    let manifest = looked_at(&args.file)?.manifest;
    let judged = judge(&manifest, args.class.as_deref(), contract, &args.interface)?;
    let fulfils = judged.iter().any(|j| j.violations.is_empty());
    let exit = if fulfils { Exit::Ok } else { Exit::Refused };
    if session.json() {
        let mut answer = json!({
            "file": args.file,
            "contract": contract.name,
            "fulfilled": fulfils,
            "classes": judged.iter().map(|j| json!({
                "class": j.class,
                "violations": j.violations.iter().map(|v| json!({ "at": v.at, "text": v.to_string() })).collect::<Vec<_>>(),
            })).collect::<Vec<_>>(),
        });
        if !fulfils {
            answer["reason"] = json!("CONTRACT_NOT_FULFILLED");
        }
        session.print_json(&answer)?;
        return Ok(exit);
    }
    out::text(&people(&judged, contract, &args.file, style::stdout()));
    Ok(exit)
}

/// Tries the file out as a host does before it loads it.
fn tried(file: &Path, session: &Session) -> Done {
    let seen = looked_at(file)?;
    let exe = std::env::current_exe()
        .map_err(|e| Failure::local("IO", format!("this program cannot be found: {e}"), ""))?;
    loader::try_file(file, &exe).map_err(|e| refused(&e))?;
    let classes: Vec<_> =
        seen.manifest.classes.iter().map(|c| format!("{}/{}", seen.manifest.name, c.name)).collect();
    if session.json() {
        let answer = json!({ "file": file, "loads": true, "classes": classes, "warnings": seen.warnings });
        session.print_json(&answer)?;
        return Ok(Exit::Ok);
    }
    let word = style::paint("loads", style::GOOD, style::stdout());
    out::say(&format!("{} {word}: {}", seen.manifest.name, classes.join(", ")));
    for warning in &seen.warnings {
        out::say(&format!("warning: {warning}"));
    }
    Ok(Exit::Ok)
}

/// The named class, or all; those that differ least first.
fn judge(
    manifest: &Manifest,
    class: Option<&str>,
    contract: &Contract,
    interface: &str,
) -> Result<Vec<Judged>, Failure> {
    let there: Vec<String> = manifest.classes.iter().map(|c| c.name.clone()).collect();
    let bare = class.map(|c| c.strip_prefix(&format!("{}/", manifest.name)).unwrap_or(c));
    if let Some(missing) = bare.filter(|c| !there.iter().any(|t| t == c)) {
        let text = format!("plugin {} has no class {missing:?}", manifest.name);
        return Err(Failure::refused("CLASS_NOT_FOUND", text, format!("it has {}", there.join(", "))));
    }
    let wanted = there.iter().filter(|t| bare.is_none_or(|c| c == **t));
    let of = |name: &String| Judged {
        class: format!("{}/{name}", manifest.name),
        violations: contracts::check_as(manifest, name, contract, interface),
    };
    let mut judged: Vec<Judged> = wanted.map(of).collect();
    judged.sort_by_key(|j| j.violations.len());
    Ok(judged)
}

/// Classes that fulfil it; when there are none, the violations of the one that differs least.
fn people(judged: &[Judged], contract: &Contract, file: &Path, colour: bool) -> String {
    let name = contract.name;
    let mut text = String::new();
    for j in judged.iter().filter(|j| j.violations.is_empty()) {
        let word = style::paint("fulfils", style::GOOD, colour);
        text.push_str(&format!("class {} {word} the contract {name}: {}\n", j.class, contract.doc));
    }
    if !text.is_empty() {
        return text;
    }
    let Some(least) = judged.first() else {
        return format!("{} has no classes\n", out::harmless(&file.display().to_string()));
    };
    let word = style::paint("does not fulfil", style::BAD, colour);
    text.push_str(&format!("class {} {word} the contract {name}:\n", least.class));
    for violation in &least.violations {
        text.push_str(&format!("  {violation}\n"));
    }
    for other in &judged[1..] {
        text.push_str(&format!("class {} differs in {} things\n", other.class, other.violations.len()));
    }
    text.push_str(&format!("docs/INTERFACES.md has the contract {name} with types and units\n"));
    text
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn two_classes() -> Manifest {
        let class = |name: &str| json!({ "name": name, "doc": "", "safety": "none" });
        let manifest = json!({ "trocar": 1, "abi": [1, 0], "name": "toy", "version": "1.0.0", "built_with": "", "doc": "",
            "classes": [class("one"), class("two")], "types": [] });
        serde_json::from_value(manifest).unwrap()
    }

    #[test]
    fn a_class_that_differs_is_told_in_what() {
        let judged = judge(&two_classes(), Some("toy/two"), &contracts::CAMERA, "").unwrap();
        let text = people(&judged, &contracts::CAMERA, Path::new("toy.so"), false);
        assert!(text.contains("class toy/two does not fulfil the contract camera"), "{text}");
        assert!(text.contains("is missing") && !text.contains("toy/one"), "{text}");
    }

    #[test]
    fn a_class_that_is_not_there_is_refused_with_those_that_are() {
        let refused = judge(&two_classes(), Some("three"), &contracts::ARM, "").err().unwrap();
        assert!(refused.message.contains("three") && refused.help.contains("one, two"), "{refused:?}");
    }
}
