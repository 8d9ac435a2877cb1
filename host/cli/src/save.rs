//! `trocar save`: the running system as a system file.
//!
//! Invariant: a file that is there is replaced only where that is said, and is never half written.

use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::failure::{Done, Exit, Failure};
use super::session::Session;
use super::{out, units};
use trocar::system_file::SystemFile;

const EXAMPLES: &str = "\
Example:
  trocar save -o system.json
`trocar run`, `up`, `apply` and `diff` take it.";

/// Saves the running system as a system file, as if written by hand.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(super) struct SaveArgs {
    /// The file to write; without it the text goes to standard output.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Replaces the file where there is one; comments in it are lost.
    #[arg(long, requires = "output")]
    force: bool,
}

pub(super) async fn run(args: SaveArgs, session: &Session) -> Done {
    let output = args.output.as_deref();
    if let Some(file) = output.filter(|file| !args.force && file.exists()) {
        return Err(there_already(file));
    }
    let folder = folder_of(output)?;
    let saved = session.save(&folder).await?;
    let (text, notes) = (&saved.text, &saved.notes);
    if let Some(file) = output {
        write(file, text, args.force)?;
    }
    if session.json() {
        let file = output.map(|file| file.display().to_string());
        return session.print_json(&json!({
            "revision": saved.revision, "file": file, "text": text, "notes": notes,
        }));
    }
    match output {
        None => out::text(text),
        Some(file) => out::say(&format!("{}: {}", file.display(), counted(text)?)),
    }
    notes.iter().for_each(|note| out::complain("note", note));
    Ok(Exit::Ok)
}

/// The parts of the text, counted by its own reader.
fn counted(text: &str) -> Result<String, Failure> {
    let file = SystemFile::parse("the saved system", text.to_owned())?;
    let count = |n: usize, noun: &str| units::count(n as u64, noun);
    Ok(format!(
        "{}, {}, {}",
        count(file.processes.len(), "process"),
        count(file.components.len(), "component"),
        count(file.connections.len(), "connection")
    ))
}

/// The directory in which the file lies, as the GCM would call it.
fn folder_of(output: Option<&Path>) -> Result<PathBuf, Failure> {
    let parent = output.and_then(Path::parent).filter(|dir| !dir.as_os_str().is_empty());
    let dir = parent.unwrap_or(Path::new("."));
    // Paths are not resolved: hosts call their directories as they were given.
    std::fs::metadata(dir).and_then(|_| std::path::absolute(dir)).map_err(|e| {
        let what = format!("the directory {} cannot be used: {e}", dir.display());
        Failure::local("IO", what, "make it first, or name another file")
    })
}

fn there_already(file: &Path) -> Failure {
    let what = format!("{} is there already", file.display());
    Failure::local("FILE_EXISTS", what, "give another name, or replace it: --force (comments in it are lost)")
}

fn write(file: &Path, text: &str, force: bool) -> Result<(), Failure> {
    let put = if force { replace(file, text) } else { make(file, text) };
    put.map_err(|e| match e.kind() {
        ErrorKind::AlreadyExists => there_already(file),
        _ => {
            let what = format!("{} cannot be written: {e}", file.display());
            Failure::local("IO", what, "check the directory and its permissions, or name another file")
        }
    })
}

/// Makes the file; refuses where another program has made it meanwhile.
fn make(file: &Path, text: &str) -> std::io::Result<()> {
    let put = File::create_new(file)?.write_all(text.as_bytes());
    put.inspect_err(|_| {
        // Half a file is no system; the first error is reported.
        let _ = std::fs::remove_file(file);
    })
}

fn replace(file: &Path, text: &str) -> std::io::Result<()> {
    let mut name = file.as_os_str().to_owned();
    name.push(format!(".{}.new", std::process::id()));
    let new = PathBuf::from(name);
    let put = std::fs::write(&new, text).and_then(|()| std::fs::rename(&new, file));
    put.inspect_err(|_| {
        // The file may not exist; the first error is reported.
        let _ = std::fs::remove_file(&new);
    })
}
