//! `trocar plugin ls|reload|inspect|check|new`.
//!
//! Invariant: `inspect` runs no byte of the file it looks at.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, Subcommand};
use serde_json::json;
use trocar_loader::{self as loader, Inspection, PluginError};
use trocar_plugin_api::manifest::{Class, Manifest};

use super::failure::{Done, Exit, Failure};
use super::session::Session;
use super::table::Table;
use super::view::PluginView;
use super::{out, plugin_check, plugin_new, style};

/// Lists, inspects, checks and begins plugins.
#[derive(Args, Debug)]
pub(super) struct PluginArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand, Debug)]
enum What {
    /// Lists the files of the plugin directories, refused ones with the reason.
    Ls {
        /// Only this process.
        #[arg(default_value = "", hide_default_value = true)]
        process: String,
    },
    /// Has hosts look at plugin files again, now, also at those that crashed, hung or were refused when they
    /// were tried: what was found out about them is forgotten. What is loaded stays.
    Reload {
        /// The plugin, or its file; all files when left out. One that is named is tried although it was not
        /// yet.
        #[arg(value_name = "PLUGIN|FILE", default_value = "", hide_default_value = true)]
        name: String,
        /// Only this process.
        #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true)]
        process: String,
    },
    /// Shows what a plugin file offers, without running a byte of it.
    Inspect {
        /// The .so file.
        file: PathBuf,
    },
    Check(plugin_check::CheckArgs),
    New(plugin_new::NewArgs),
}

pub(super) async fn run(args: PluginArgs, session: &Session) -> Done {
    match args.what {
        What::Ls { process } => ls(&process, session).await,
        What::Reload { name, process } => reload(&name, &process, session).await,
        What::Inspect { file } => inspect(&file, session),
        What::Check(args) => plugin_check::run(&args, session),
        What::New(args) => plugin_new::run(&args, session),
    }
}

async fn ls(process: &str, session: &Session) -> Done {
    let plugins = session.plugins(process).await?;
    if session.json() {
        return session.print_json(&plugins);
    }
    show(&plugins);
    Ok(Exit::Ok)
}

/// Each file may be tried for seconds.
const RELOAD: Duration = Duration::from_secs(60);

async fn reload(name: &str, process: &str, session: &Session) -> Done {
    // A host knows its files by their own paths.
    let name = name.rsplit('/').next().unwrap_or(name);
    let (plugins, warnings) = session.recheck(name, process, RELOAD).await?;
    let refused = !name.is_empty() && plugins.iter().any(|plugin| !plugin.refused.is_empty());
    let exit = if refused { Exit::Refused } else { Exit::Ok };
    if session.json() {
        session.print_json(&json!({ "plugins": plugins, "warnings": warnings }))?;
        return Ok(exit);
    }
    show(&plugins);
    for warning in &warnings {
        out::say(&format!("warning: {}", out::harmless(warning)));
    }
    Ok(exit)
}

fn show(plugins: &[PluginView]) {
    let colour = style::stdout();
    let mut table = Table::new(&["PROCESS", "PLUGIN", "VERSION", "ABI", "LOADED", "CLASSES", "FILE"]);
    for p in plugins.iter().filter(|p| p.refused.is_empty()) {
        let loaded = if p.loaded { "yes" } else { "no" }.to_owned();
        let cells = [&p.process, &p.name, &p.version, &p.abi, &loaded, &p.classes.join(" "), &p.file];
        table.row(cells.map(Clone::clone));
    }
    let none = "no plugin is listed; a file is looked at a moment after it was copied in\n";
    out::text(&if table.is_empty() { none.to_owned() } else { table.render(0, colour) });
    for p in plugins {
        for warning in &p.warnings {
            out::line(&format!(
                "{}: {}: {}",
                style::paint("warning", style::WARN, colour),
                out::harmless(if p.name.is_empty() { &p.file } else { &p.name }),
                out::harmless(warning)
            ));
        }
        if !p.refused.is_empty() {
            out::line(&format!(
                "{}: {} [{}]",
                style::paint("refused", style::BAD, colour),
                out::harmless(&p.refused),
                p.refused_reason
            ));
        }
    }
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

fn inspect(file: &Path, session: &Session) -> Done {
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
