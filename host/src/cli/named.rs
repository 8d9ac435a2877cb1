//! The system file of `run` and `up`: which one, with what settings and plugins instead of its own.
//!
//! Invariant: both take the same flags and read the file in the same way, so what runs in one process comes up in several.

use std::path::PathBuf;

use clap::Args;

use super::failure::Failure;
use crate::system_file::{BadSet, SystemFile};

#[derive(Args, Debug)]
pub(super) struct FileArgs {
    /// The system file (`trocar schema system` describes it).
    pub(super) file: PathBuf,
    /// Another value for one setting, JSON or plain text: process/component.key=value; may be given several times.
    #[arg(long = "set", value_name = "ASSIGNMENT")]
    pub(super) sets: Vec<String>,
    /// Plugin directory instead of the file's; may be given several times [where neither: ./plugins, else where this program
    /// lies].
    #[arg(long, value_name = "DIR")]
    pub(super) plugins: Vec<PathBuf>,
}

impl FileArgs {
    /// The file with its settings.
    pub(super) fn read(&self) -> Result<SystemFile, Failure> {
        let mut file = SystemFile::read(&self.file)?;
        for assignment in &self.sets {
            file.set(assignment)?;
        }
        Ok(file)
    }
}

impl From<BadSet> for Failure {
    fn from(bad: BadSet) -> Self {
        Failure::usage(bad.to_string(), bad.help)
    }
}
