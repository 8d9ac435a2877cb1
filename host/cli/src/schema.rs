//! `trocar schema system`: the JSON Schema of the system file.
//!
//! Invariant: it prints what the reader of the file accepts, nothing else.

use clap::{Args, ValueEnum};

use super::failure::Exit;
use super::out;
use trocar::system_file::system_schema;

/// Prints the JSON Schema of a file format, for editors.
#[derive(Args, Debug)]
pub(super) struct SchemaArgs {
    /// The format.
    format: Format,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    /// The system file that `trocar run` takes.
    System,
}

pub(super) fn run(args: &SchemaArgs) -> Exit {
    match args.format {
        Format::System => out::line(&format!("{:#}", system_schema())),
    }
    Exit::Ok
}
