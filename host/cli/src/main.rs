//! The one binary `trocar`: everything is in the library beside it.
//!
//! Invariant: no logic here.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    trocar_cli::main()
}
