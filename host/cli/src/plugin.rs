//! `trocar plugin ls|reload|inspect|check|new`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};
use serde_json::json;

use super::failure::{Done, Exit};
use super::session::Session;
use super::table::Table;
use super::view::PluginView;
use super::{out, plugin_check, plugin_inspect, plugin_new, style};

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
        What::Inspect { file } => plugin_inspect::run(&file, session),
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
                "{} by {}: {} [{}]",
                style::paint("refused", style::BAD, colour),
                out::harmless(&p.process),
                out::harmless(&p.refused),
                p.refused_reason
            ));
        }
    }
}
