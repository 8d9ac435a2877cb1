//! `trocar plugin inspect FILE`: what a plugin file offers.
//!
//! Invariant: no byte of the file runs.

use std::path::Path;

use serde_json::json;
use trocar_loader::{self as loader, Inspection, PluginError};
use trocar_plugin_api::manifest::{Class, Manifest};

use super::failure::{Done, Exit, Failure};
use super::out;
use super::session::Session;

pub(super) fn run(file: &Path, session: &Session) -> Done {
    let seen = looked_at(file)?;
    if session.json() {
        return session.print_json(&json!({
            "file": seen.file,
            "bytes": seen.size,
            "hash": seen.hash.to_string(),
            "owner": seen.owner,
            "mode": format!("{:04o}", seen.mode),
            "machine": seen.machine,
            "needed": seen.needed,
            "brings": seen.brought.iter().map(|(name, hash)| json!({ "name": name, "hash": hash.to_string() })).collect::<Vec<_>>(),
            "warnings": seen.warnings,
            "manifest": seen.manifest,
        }));
    }
    out::line(&format!(
        "{}  {} KiB  {}  owner {}, mode {:04o}",
        out::harmless(&seen.file.display().to_string()),
        seen.size.div_ceil(1024),
        seen.machine,
        seen.owner,
        seen.mode
    ));
    out::line(&format!("sha256 {}", seen.hash));
    out::text(&describe(&seen.manifest));
    if !seen.needed.is_empty() {
        out::say(&format!("needs {}", seen.needed.join(", ")));
    }
    for (name, hash) in &seen.brought {
        out::line(&format!("brings {}  sha256 {hash}", out::harmless(name)));
    }
    for warning in &seen.warnings {
        out::say(&format!("warning: {warning}"));
    }
    Ok(Exit::Ok)
}

/// Reads what a file offers; no code of the file runs.
pub(super) fn looked_at(file: &Path) -> Result<Inspection, Failure> {
    if !file.exists() {
        let text = format!("there is no file {}", file.display());
        return Err(Failure::refused(
            "IO",
            text,
            "name a built plugin, e.g. target/release/libtrocar_NAME.so",
        ));
    }
    loader::inspect_file(file).map_err(|e| refused(&e))
}

pub(super) fn refused(error: &PluginError) -> Failure {
    // The loader's sentences end with the remedy behind the last colon.
    let text = error.to_string();
    let (what, remedy) = text.rsplit_once(": ").unwrap_or((&text, ""));
    Failure::local(error.reason(), what, remedy)
}

fn describe(m: &Manifest) -> String {
    let [major, minor] = m.abi;
    let said = out::one_line;
    let (name, version, built_with) = (said(&m.name), said(&m.version), said(&m.built_with));
    let mut text = format!("plugin {name} {version}  ABI {major}.{minor}  {built_with}\n");
    if !m.doc.is_empty() {
        text.push_str(&format!("{}\n", said(&m.doc)));
    }
    for class in &m.classes {
        text.push_str(&describe_class(&m.name, class));
    }
    text
}

fn describe_class(plugin: &str, c: &Class) -> String {
    let head =
        format!("class {}/{}  {}", out::one_line(plugin), out::one_line(&c.name), out::one_line(&c.doc));
    let mut text = format!("{}\n", head.trim_end());
    let mut line = |kind: &str, name: &str, doc: &str| {
        let (name, doc) = (out::one_line(name), out::one_line(doc));
        text.push_str(format!("  {kind} {name}  {doc}").trim_end());
        text.push('\n');
    };
    for p in &c.inputs {
        line("input", &p.name, &p.doc);
    }
    for p in &c.outputs {
        line("output", &p.name, &p.doc);
    }
    for r in &c.required {
        line("required interface", &r.name, &r.doc);
    }
    for p in &c.provided {
        line("provided interface", &p.name, &p.doc);
        for command in &p.commands {
            line(&format!("  {}", command.kind), &command.name, &command.doc);
        }
        for event in &p.events {
            line("  event", &event.name, &event.doc);
        }
    }
    text
}
