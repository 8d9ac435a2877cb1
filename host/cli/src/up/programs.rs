//! Programs that `up` runs under a supervisor: the processes of a system file, and their GCM.
//!
//! Invariant: every path is absolute, so a child finds what the file means wherever it is started.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use trocar_model::{ComponentId, Name};

use super::fleet::{Hosted, absolute as all_absolute};
use crate::hosting::{self, PortArgs};
use crate::session;
use trocar::control::ToKeep;
use trocar::processes::{Limits, Policy, Program};
use trocar::system_file::{Place, ProcessSpec, SystemFile, TrustSpec};

/// Supervisor's name of the GCM; no process can have it.
pub(super) const GCM: &str = ":gcm";

/// Limits of the GCM: no process stands still for want of one, so it is never given up, and is soon back.
const GCM_LIMITS: Limits =
    Limits { max: u32::MAX, most_backoff: Duration::from_millis(200), ..Limits::DEFAULT };

/// Processes kept for isolated components, by name.
pub(super) type Roster = BTreeMap<String, Hosted>;

/// A process as people call it.
pub(super) fn called(name: &str) -> &str {
    if name == GCM { "the GCM" } else { name }
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

/// The way by which other machines reach the GCM of a system.
#[derive(Clone, Debug)]
pub(crate) struct Reached {
    /// Address and port for them.
    pub(crate) listen: String,
    /// Certificates that are believed no more.
    pub(crate) revoked: Option<PathBuf>,
}

pub(crate) fn gcm(listen: &str, state: &Path, port: PortArgs, reached: Option<&Reached>) -> Program {
    let mut args: Vec<OsString> =
        ["gcm".into(), "--state".into(), absolute(&state.join("gcm")).into()].into();
    args.extend(port.flags().map(Into::into));
    if let Some(Reached { listen, revoked }) = reached {
        args.extend(["--listen-tls".into(), listen.into()]);
        let files = [("--identity", session::identity()), ("--revoked", revoked.clone())];
        for (option, file) in files {
            args.extend(file.into_iter().flat_map(|file| [option.into(), file.into()]));
        }
    }
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

    pub(super) fn hosts(&self) -> Vec<Hosted> {
        self.processes.iter().map(|process| self.host(process)).collect()
    }

    /// Returns the program for an isolated component, made like `home`; `None`: `home` is no
    /// process of the file.
    pub(super) fn isolated(&self, process: &Name, home: &Name) -> Option<Hosted> {
        let home = self.processes.iter().find(|p| p.name == *home)?;
        let component = process.as_str().strip_prefix(home.name.as_str())?.strip_prefix('.')?;
        let lives = ComponentId::new(process.clone(), Name::parse(component).ok()?);
        Some(self.host(&home.isolated(&lives)))
    }

    fn host(&self, process: &ProcessSpec) -> Hosted {
        let rules = self.port.rules();
        let hashes = match &process.trust {
            TrustSpec::Dev => None,
            TrustSpec::AllowList(list) => Some(self.base.join(list)),
        };
        match &process.machine {
            None => {
                let name = process.name.as_str();
                let state = match &process.state {
                    Some(dir) => self.base.join(dir),
                    None => absolute(&self.state.join("processes").join(name)),
                };
                let place = Place {
                    plugins: all_absolute(hosting::plugins_of(process, &self.base, self.plugins.clone())),
                    hashes,
                    state,
                    // Paths in configurations are relative to the file, too.
                    folder: self.base.clone(),
                    output: output(&self.state, Some(name)),
                    rules,
                };
                Hosted::Here(Box::new(process.program(place)))
            }
            Some(machine) => {
                let own: Vec<PathBuf> = process.plugins.iter().map(|dir| self.base.join(dir)).collect();
                let plugins = if self.plugins.is_empty() { own } else { self.plugins.clone() };
                let (spec, plugins) = (process.clone(), all_absolute(plugins));
                // Its GCM is named when there is one.
                let process = Box::new(ToKeep { spec, plugins, hashes, gcm: String::new(), rules });
                Hosted::There { machine: machine.to_string(), process }
            }
        }
    }
}
