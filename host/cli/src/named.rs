//! The system file of a subcommand: which one, with what settings, and for `run` and `up` plugins instead of
//! its own.
//!
//! Invariant: all take the same flags and read the file in the same way, so what runs in one process comes up
//! in several, and is what `apply` and `diff` compare a system with.

use std::path::PathBuf;

use clap::Args;

use super::failure::Failure;
use trocar::system_file::{BadSet, SystemFile};

#[derive(Args, Debug)]
pub(super) struct SystemArgs {
    /// The system file (`trocar schema system` describes it).
    pub(super) file: PathBuf,
    /// Another value for one setting, JSON or plain text: process/component.key=value; may be given
    /// several times.
    #[arg(long = "set", value_name = "ASSIGNMENT")]
    pub(super) sets: Vec<String>,
}

#[derive(Args, Debug)]
pub(super) struct FileArgs {
    #[command(flatten)]
    pub(super) system: SystemArgs,
    /// Plugin directory instead of the file's; may be given several times [where neither: ./plugins, else
    /// where this program lies].
    #[arg(long, value_name = "DIR")]
    pub(super) plugins: Vec<PathBuf>,
}

impl FileArgs {
    /// The file with its settings.
    pub(super) fn read(&self) -> Result<SystemFile, Failure> {
        self.system.read()
    }
}

impl SystemArgs {
    /// The file with its settings.
    pub(super) fn read(&self) -> Result<SystemFile, Failure> {
        let mut file = SystemFile::read(&self.file)?;
        for assignment in &self.sets {
            file.set(assignment)?;
        }
        Ok(file)
    }
}

/// A refusal with the place in the file it comes from.
pub(super) fn placed(file: &SystemFile, failure: Failure) -> Failure {
    match file.locate_told(&failure.reason, &failure.message, &failure.help, &failure.metadata) {
        Some(place) => failure.at(&place),
        None => failure,
    }
}

impl From<BadSet> for Failure {
    fn from(bad: BadSet) -> Self {
        Failure::usage(bad.to_string(), bad.help)
    }
}
