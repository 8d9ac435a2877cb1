//! `trocar __vet FILE`: the child process that opens an unknown plugin so that the host does not have to.
//!
//! Invariant: no runtime, thread or logger of ours exists in this process before the plugin is opened.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

/// Opens a plugin file and checks it; used by the host itself.
#[derive(Args, Debug)]
pub(super) struct VetArgs {
    /// The file.
    file: PathBuf,
}

pub(super) fn run(args: &VetArgs) -> ExitCode {
    trocar_loader::vet_main(&args.file)
}
