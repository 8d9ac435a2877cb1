//! The vetting child: `trocar __vet FILE`. Loads one file, says how far it came, and leaves without exit
//! handlers.
//!
//! Invariant: standard output carries only lines of this host; the plugin's own output goes to standard
//! error. Dies by itself when its parent is gone, and leaves no core dump behind.

use std::fs::File;
use std::io::{self, Write};
use std::os::fd::FromRawFd;
use std::path::Path;
use std::process::ExitCode;

use super::error::Stage;
use super::inspect_file;
use super::load;
use super::resident::Libraries;
use super::vet::{BEGIN_LIMIT, PREFIX, VET_LIMIT, stage_word};

/// Entry point of the hidden subcommand. Exit code 0 when nothing is wrong with the file.
pub fn vet_main(path: &Path) -> ExitCode {
    let mut report = match take_stdout() {
        Ok(report) => report,
        Err(error) => {
            eprintln!("trocar: standard output cannot be used: {error}");
            return ExitCode::FAILURE;
        }
    };
    limit_self();
    let mut say = |line: &str| drop(writeln!(report, "{PREFIX}{line}"));
    let inspection = match inspect_file(path) {
        Ok(inspection) => inspection,
        Err(error) => {
            eprintln!("trocar: {error}");
            return ExitCode::FAILURE;
        }
    };
    let libraries = Libraries { needed: inspection.needed, brought: inspection.brought };
    let stage = |stage: Stage| say(stage_word(stage));
    let verdict = load::try_out(path, &inspection.manifest, &libraries, stage);
    let code = match verdict {
        Ok(()) => {
            say("ok");
            0
        }
        Err(fault) => {
            say(&serde_json::to_string(&fault).unwrap_or_default());
            1
        }
    };
    // SAFETY: ends the process at once; exit handlers of an untried library must not run.
    unsafe { libc::_exit(code) }
}

/// Returns the host's own copy of standard output; number 1 then leads to standard error.
fn take_stdout() -> io::Result<File> {
    // SAFETY: duplicates a descriptor of this process.
    let copy = unsafe { libc::fcntl(1, libc::F_DUPFD_CLOEXEC, 3) };
    if copy < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: both numbers are this process's own.
    if unsafe { libc::dup2(2, 1) } < 0 {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the descriptor was made above and nobody else knows it.
    Ok(unsafe { File::from_raw_fd(copy) })
}

fn limit_self() {
    let no_core = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: lowers a limit of this process; the struct is read only.
    unsafe { libc::setrlimit(libc::RLIMIT_CORE, &raw const no_core) };
    // SAFETY: arms the alarm whose default action ends this process, should the parent be gone.
    unsafe { libc::alarm((BEGIN_LIMIT + VET_LIMIT).as_secs() as u32) };
}
