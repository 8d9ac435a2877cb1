//! The one binary `trocar`: everything is in the library, so that other programs can hold a host too.
//!
//! Invariant: no logic here.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    trocar_cli::main()
}
