//! A process of a system as the program that its keeper spawns, on this machine or on another.
//!
//! Invariant: every path is absolute, so a child finds what is meant wherever it is started.

use std::ffi::OsString;
use std::path::PathBuf;

use super::ProcessSpec;
use crate::host::{PortRules, Viewer};
use crate::processes::Program;

/// The place of a process on its machine. All paths are absolute.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Directories of its plugin files.
    pub plugins: Vec<PathBuf>,
    /// List of the hashes of the plugin files that it takes; `None`: files of its user and root.
    pub hashes: Option<PathBuf>,
    /// Directory of its state.
    pub state: PathBuf,
    /// Its working directory: relative paths of configurations begin there.
    pub folder: PathBuf,
    /// File for everything it prints.
    pub output: PathBuf,
    /// Rights of callers at its port.
    pub rules: PortRules,
}

impl ProcessSpec {
    /// Returns the program of this process at its place; no GCM is named yet.
    pub fn program(&self, place: Place) -> Program {
        let Place { plugins, hashes, state, folder, output, rules } = place;
        let mut args: Vec<OsString> =
            ["host", "--name", self.name.as_str(), "--state"].map(Into::into).into();
        args.push(state.into());
        for dir in plugins {
            args.extend(["--plugins".into(), dir.into()]);
        }
        if let Some(hashes) = hashes {
            let mut trust = OsString::from("allowlist:");
            trust.push(hashes);
            args.extend(["--trust".into(), trust]);
        }
        args.extend(self.allow_exec.then(|| "--allow-exec".into()));
        let bounds = [("--memory-warn", self.memory.warn_mib), ("--memory-limit", self.memory.limit_mib)];
        for (option, mib) in bounds {
            args.extend(mib.into_iter().flat_map(|mib| [option.into(), mib.to_string().into()]));
        }
        args.extend(flags(rules).map(Into::into));
        Program {
            name: self.name.to_string(),
            args,
            listen: self.listen.clone().unwrap_or_else(|| "127.0.0.1:0".to_owned()),
            stays: false,
            env: self.env.clone(),
            folder: Some(folder),
            output,
            policy: self.restart,
        }
    }
}

/// The rights of callers at a port as the flags of the program that opens it.
pub fn flags(rules: PortRules) -> impl Iterator<Item = &'static str> {
    let flags =
        [(rules.viewer == Viewer::ReadOnly, "--viewer-read-only"), (rules.open_loopback, "--open-loopback")];
    flags.into_iter().filter_map(|(is_set, flag)| is_set.then_some(flag))
}
