//! What `up` runs: the processes of a system file, and their GCM, as programs of a supervisor.
//!
//! Invariant: every path is absolute, so a child finds what the file means wherever it is started.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::cli::hosting;
use crate::processes::{Limits, Policy, Program};
use crate::system_file::{ProcessSpec, SystemFile, TrustSpec};

/// What the supervisor calls the GCM: no process can be called that.
pub(super) const GCM: &str = ":gcm";

/// Nobody stands still for want of a GCM, so it is never given up, and is soon back.
const GCM_LIMITS: Limits =
    Limits { max: u32::MAX, most_backoff: Duration::from_millis(200), ..Limits::DEFAULT };

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// What a process printed; `None`: the GCM, which no process can be called.
fn output(state: &Path, process: Option<&str>) -> PathBuf {
    absolute(&match process {
        Some(name) => state.join(format!("{name}.output.log")),
        None => state.join("output.log"),
    })
}

pub(in crate::cli) fn gcm(listen: &str, state: &Path) -> Program {
    Program {
        name: GCM.to_owned(),
        args: ["gcm".into(), "--state".into(), absolute(&state.join("gcm")).into()].into(),
        listen: listen.to_owned(),
        stays: true,
        env: Vec::new(),
        output: output(state, None),
        policy: Policy::OnFailure(GCM_LIMITS),
    }
}

/// The processes of a file that lies at `at`; its paths are relative to that.
pub(in crate::cli) fn hosts(file: &SystemFile, at: &Path, plugins: &[PathBuf], state: &Path) -> Vec<Program> {
    let base = absolute(at.parent().unwrap_or(Path::new("")));
    file.processes.iter().map(|process| host(process, &base, plugins, state)).collect()
}

fn host(process: &ProcessSpec, base: &Path, plugins: &[PathBuf], state: &Path) -> Program {
    let name = process.name.as_str();
    let output = output(state, Some(name));
    let state = match &process.state {
        Some(dir) => base.join(dir),
        None => absolute(&state.join("processes").join(name)),
    };
    let mut args: Vec<OsString> = ["host", "--name", name, "--state"].map(OsString::from).into();
    args.push(state.into());
    let dirs: Vec<PathBuf> = match (plugins.is_empty(), process.plugins.is_empty()) {
        (false, _) => plugins.iter().map(|dir| absolute(dir)).collect(),
        (true, false) => process.plugins.iter().map(|dir| base.join(dir)).collect(),
        (true, true) => hosting::plugin_dirs(Vec::new()).iter().map(|dir| absolute(dir)).collect(),
    };
    for dir in dirs {
        args.extend(["--plugins".into(), dir.into()]);
    }
    if let TrustSpec::AllowList(list) = &process.trust {
        let mut trust = OsString::from("allowlist:");
        trust.push(base.join(list));
        args.extend(["--trust".into(), trust]);
    }
    let bounds = [("--memory-warn", process.memory.warn_mib), ("--memory-limit", process.memory.limit_mib)];
    for (option, mib) in bounds {
        args.extend(mib.into_iter().flat_map(|mib| [option.into(), mib.to_string().into()]));
    }
    Program {
        name: name.to_owned(),
        args,
        listen: process.listen.clone().unwrap_or_else(|| "127.0.0.1:0".to_owned()),
        stays: false,
        env: process.env.clone(),
        output,
        policy: process.restart,
    }
}
