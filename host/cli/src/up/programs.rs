//! Programs that `up` runs under a supervisor: the processes of a system file, and their GCM.
//!
//! Invariant: every path is absolute, so a child finds what the file means wherever it is started.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use trocar_model::{ComponentId, Name};

use crate::hosting::{self, PortArgs};
use crate::session;
use trocar::processes::{Limits, Policy, Program};
use trocar::system_file::{ProcessSpec, SystemFile, TrustSpec};

/// Supervisor's name of the GCM; no process can have it.
pub(super) const GCM: &str = ":gcm";

/// Limits of the GCM: no process stands still for want of one, so it is never given up, and is soon back.
const GCM_LIMITS: Limits =
    Limits { max: u32::MAX, most_backoff: Duration::from_millis(200), ..Limits::DEFAULT };

/// Processes kept for isolated components, by name.
pub(super) type Roster = BTreeMap<String, Program>;

/// A process as people call it.
pub(super) fn called(name: &str) -> &str {
    if name == GCM { "the GCM" } else { name }
}

/// Returns a host that attaches to the GCM at this address.
pub(super) fn under(mut host: Program, addr: &str) -> Program {
    host.args.extend(["--gcm".into(), addr.into()]);
    if let Some(identity) = session::identity() {
        host.args.extend(["--identity".into(), identity.into()]);
    }
    host
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// Returns the file for the output of a process; `None`: of the GCM, whose name no process can have.
fn output(state: &Path, process: Option<&str>) -> PathBuf {
    absolute(&match process {
        Some(name) => state.join(format!("{name}.output.log")),
        None => state.join("output.log"),
    })
}

pub(crate) fn gcm(listen: &str, state: &Path, port: PortArgs) -> Program {
    let mut args: Vec<OsString> =
        ["gcm".into(), "--state".into(), absolute(&state.join("gcm")).into()].into();
    args.extend(port.flags().map(Into::into));
    Program {
        name: GCM.to_owned(),
        args,
        listen: listen.to_owned(),
        stays: true,
        env: Vec::new(),
        folder: None,
        output: output(state, None),
        policy: Policy::OnFailure(GCM_LIMITS),
    }
}

/// Maker of programs from the processes of a file.
pub(crate) struct Launch {
    processes: Vec<ProcessSpec>,
    /// Base of the file's relative paths.
    base: PathBuf,
    plugins: Vec<PathBuf>,
    state: PathBuf,
    port: PortArgs,
}

impl Launch {
    /// Takes the processes of a file that lies at `at`; `plugins` instead of its own, when there are any.
    pub(crate) fn new(
        file: &SystemFile,
        at: &Path,
        plugins: &[PathBuf],
        state: &Path,
        port: PortArgs,
    ) -> Launch {
        let folder = at.parent().filter(|folder| !folder.as_os_str().is_empty());
        let base = absolute(folder.unwrap_or(Path::new(".")));
        let (processes, plugins, state) = (file.processes.clone(), plugins.to_vec(), state.to_owned());
        Launch { processes, base, plugins, state, port }
    }

    pub(super) fn hosts(&self) -> Vec<Program> {
        self.processes.iter().map(|process| self.host(process)).collect()
    }

    /// Returns the program for an isolated component, made like `home`; `None`: `home` is no
    /// process of the file.
    pub(super) fn isolated(&self, process: &Name, home: &Name) -> Option<Program> {
        let home = self.processes.iter().find(|p| p.name == *home)?;
        let component = process.as_str().strip_prefix(home.name.as_str())?.strip_prefix('.')?;
        let lives = ComponentId::new(process.clone(), Name::parse(component).ok()?);
        Some(self.host(&home.isolated(&lives)))
    }

    fn host(&self, process: &ProcessSpec) -> Program {
        let mut program = host(process, &self.base, &self.plugins, &self.state);
        program.args.extend(self.port.flags().map(Into::into));
        program
    }
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
    for dir in hosting::plugins_of(process, base, plugins.to_vec()) {
        args.extend(["--plugins".into(), absolute(&dir).into()]);
    }
    if let TrustSpec::AllowList(list) = &process.trust {
        let mut trust = OsString::from("allowlist:");
        trust.push(base.join(list));
        args.extend(["--trust".into(), trust]);
    }
    args.extend(process.allow_exec.then(|| "--allow-exec".into()));
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
        // Paths in configurations are relative to the file, too.
        folder: Some(base.to_owned()),
        output,
        policy: process.restart,
    }
}
