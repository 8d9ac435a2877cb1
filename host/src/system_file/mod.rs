//! The system file: one strict JSON text that says which processes, components and connections make a system.
//!
//! Invariant: reading is pure and refuses everything it does not understand; what comes out is only `model`
//! requests, so a system file can never do what single requests cannot.

mod cursor;
mod difference;
mod draft;
mod isolation;
mod judge;
#[cfg(test)]
mod judge_tests;
mod overrides;
mod place;
mod problem;
mod program;
mod read;
mod running;
#[cfg(test)]
mod running_tests;
mod scan;
mod schema;
#[cfg(test)]
mod tests;
pub(crate) mod words;
mod write;

use std::io::Read as _;
use std::path::{Path, PathBuf};

use serde_json::Value;
use trocar_model::{ComponentId, ConnectOptions, Execution, Name, PortId, Request, Target};

use crate::host::MemoryBounds;
use crate::processes::Policy;

pub use difference::Difference;
pub use draft::Draft;
pub use judge::Judged;
pub use overrides::BadSet;
pub use problem::Problem;
pub use program::{Place, flags};
pub use running::Running;
pub use schema::system_schema;
pub use write::Picture;

use cursor::{COMMENT, Document, Found};

/// Returns the first key that is twice in one object of a JSON text, anywhere in it; texts that are not JSON
/// have none. Other readers take the last one silently, and a hidden setting is a wrong setting.
pub fn duplicate_key(what: &str, text: &str) -> Option<Problem> {
    let document = Document::parse(what, text.to_owned()).ok()?;
    let found = Found::default();
    read::no_duplicates(&document.cursor(), &found);
    found.all().into_iter().next()
}

/// Largest system file, bytes.
const MAX_BYTES: u64 = 16 << 20;

/// A whole system, as written.
#[derive(Clone, Debug)]
pub struct SystemFile {
    /// Other machines, on which agents keep processes.
    pub machines: Vec<MachineSpec>,
    pub processes: Vec<ProcessSpec>,
    /// In the order of the file.
    pub components: Vec<ComponentSpec>,
    pub connections: Vec<ConnectionSpec>,
    document: Document,
    /// True: settings of the command line make it differ from its document.
    is_changed: bool,
}

/// Another machine of a system file.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineSpec {
    pub name: Name,
    /// Address of its agent: `HOST:PORT`, or `https://HOST:PORT` where certificates are shown.
    pub agent: String,
}

/// One process of a system file.
#[derive(Clone, Debug, PartialEq)]
pub struct ProcessSpec {
    pub name: Name,
    /// The machine that it is to run on; `None`: that of the program that starts it.
    pub machine: Option<Name>,
    /// Plugin directories, as written (relative to the file's directory).
    pub plugins: Vec<PathBuf>,
    pub trust: TrustSpec,
    /// Address it listens on; `None`: a free port.
    pub listen: Option<String>,
    /// Directory of its state, as written (relative to the file's directory).
    pub state: Option<PathBuf>,
    /// Variables of its environment, beside those of the program that starts it.
    pub env: Vec<(String, String)>,
    /// Policy for its end: whether it is started again.
    pub restart: Policy,
    pub memory: MemoryBounds,
    /// True: its components may start programs.
    pub allow_exec: bool,
}

impl ProcessSpec {
    /// A process of this name with the usual settings.
    pub fn new(name: Name) -> ProcessSpec {
        ProcessSpec {
            name,
            machine: None,
            plugins: Vec::new(),
            trust: TrustSpec::default(),
            listen: None,
            state: None,
            env: Vec::new(),
            restart: Policy::default(),
            memory: MemoryBounds::default(),
            allow_exec: false,
        }
    }

    /// A process made like this one for a component alone, called as [`ComponentId::isolated`] says.
    pub fn isolated(&self, lives: &ComponentId) -> ProcessSpec {
        let state = self.state.as_ref().map(|dir| dir.join(lives.component.as_str()));
        ProcessSpec { name: lives.process.clone(), listen: None, state, ..self.clone() }
    }
}

/// Which plugin files a process takes.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum TrustSpec {
    #[default]
    Dev,
    /// A JSON file of sha256 hashes, relative to the system file's directory.
    AllowList(PathBuf),
}

/// One component of a system file.
#[derive(Clone, Debug, PartialEq)]
pub struct ComponentSpec {
    pub id: ComponentId,
    /// As the file calls it: another process when it has one of its own.
    pub written: ComponentId,
    /// True: the component goes on without being asked when its process was started again.
    pub resumes: bool,
    /// True: the component has a process of its own.
    pub isolated: bool,
    pub class: String,
    pub config: Option<Value>,
    pub execution: Execution,
    pub start: bool,
}

/// One connection of a system file.
#[derive(Clone, Debug, PartialEq)]
pub struct ConnectionSpec {
    pub client: PortId,
    pub server: PortId,
    pub options: ConnectOptions,
}

impl SystemFile {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// Unreadable, not UTF-8, not JSON, or not a system file: the first problem; [`Draft`] has them all.
    pub fn read(path: &Path) -> Result<Self, Problem> {
        Self::parse(&path.display().to_string(), text_of(path)?)
    }

    /// Checks a text; `file` is the name used in problems.
    ///
    /// # Errors
    /// As [`SystemFile::read`].
    pub fn parse(file: &str, text: String) -> Result<Self, Problem> {
        // There is a problem where anything is wrong.
        Draft::of(file, text).and_then(Draft::finished).map_err(|mut problems| problems.swap_remove(0))
    }

    /// Returns its text; where a setting was changed, one that says the same with it.
    pub fn text(&self) -> String {
        if self.is_changed { self.picture().text() } else { self.document.text.clone() }
    }

    /// Applies `process/component.key[.key]=value` to a component's configuration.
    ///
    /// # Errors
    /// Malformed, or names a component the file does not have.
    pub fn set(&mut self, assignment: &str) -> Result<(), BadSet> {
        overrides::set(&mut self.components, assignment)?;
        self.is_changed = true;
        Ok(())
    }

    /// Returns the requests that make this system: creates (a stream's or step's owner before its members),
    /// connects, then one Start of everything that is not `"start": false`.
    pub fn requests(&self) -> Vec<Request> {
        let mut requests: Vec<Request> = in_thread_order(&self.components)
            .into_iter()
            .map(|c| Request::Create {
                id: c.id.clone(),
                class: c.class.clone(),
                config: c.config.clone(),
                execution: c.execution.clone(),
            })
            .collect();
        requests.extend(self.connections.iter().map(|c| Request::Connect {
            client: c.client.clone(),
            server: c.server.clone(),
            options: c.options.clone(),
        }));
        let targets: Vec<Target> =
            self.components.iter().filter(|c| c.start).map(|c| Target::One(c.id.clone())).collect();
        if !targets.is_empty() {
            requests.push(Request::Start { targets });
        }
        requests
    }

    /// The one process of the file.
    ///
    /// # Errors
    /// None or several, or one of another machine: these are for `up`.
    pub fn single_process(&self) -> Result<&ProcessSpec, Problem> {
        match self.processes.as_slice() {
            [one] => match &one.machine {
                None => Ok(one),
                Some(machine) => {
                    let pointer = format!("/processes/{}/machine", one.name);
                    let node = self.document.root.nearest_to(&pointer);
                    Err(self.document.problem(
                        node.at,
                        &pointer,
                        format!(
                            "process {} is to run on the machine {machine}, `run` starts it on this one",
                            one.name
                        ),
                        "`trocar up` starts processes of other machines".to_owned(),
                    ))
                }
            },
            all => {
                let names: Vec<&str> = all.iter().map(|p| p.name.as_str()).collect();
                let node = self.document.root.nearest_to("/processes");
                Err(self.document.problem(
                    node.at,
                    "/processes",
                    format!("the file has {} processes ({}), `run` takes one", all.len(), names.join(", ")),
                    "a system of several processes is for `trocar up`".to_owned(),
                ))
            }
        }
    }
}

/// The text of a file.
fn text_of(path: &Path) -> Result<String, Problem> {
    let whole = |what: String, help: &str| Problem {
        file: path.display().to_string(),
        line: 0,
        column: 0,
        pointer: String::new(),
        what,
        help: help.to_owned(),
    };
    let mut bytes = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes));
    read.map_err(|e| {
        whole(format!("the system file cannot be read: {e}"), "check the path and its permissions")
    })?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(whole(
            format!("a system file has at most {} MiB", MAX_BYTES >> 20),
            "check that the path names the system file",
        ));
    }
    String::from_utf8(bytes).map_err(|e| {
        let upto = e.utf8_error().valid_up_to();
        whole(format!("not UTF-8 text: byte {upto} is not valid"), "save the file as UTF-8")
    })
}

/// Returns the components in file order, but one that runs in another's thread after that one. A cycle keeps
/// file order: the model refuses it with its own words.
fn in_thread_order(components: &[ComponentSpec]) -> Vec<&ComponentSpec> {
    let mut done: Vec<&ComponentSpec> = Vec::with_capacity(components.len());
    let mut left: Vec<&ComponentSpec> = components.iter().collect();
    while !left.is_empty() {
        let waits = |c: &&ComponentSpec| {
            [&c.execution.stream_of, &c.execution.inside]
                .into_iter()
                .flatten()
                .any(|owner| left.iter().any(|o| o.id != c.id && o.id.to_string() == *owner))
        };
        let (later, now): (Vec<_>, Vec<_>) = left.iter().copied().partition(waits);
        if now.is_empty() {
            done.extend(later);
            break;
        }
        done.extend(now);
        left = later;
    }
    done
}
