//! Why a host does not start.
//!
//! Invariant: each sentence names what was asked for, and each help says what to do; nothing is
//! left half made.

use std::fmt;
use std::path::PathBuf;

use trocar_loader::StoreError;
use trocar_model::Refusal;

use crate::control::{ServeError, UplinkError};
use crate::gcm::{self, Unusable};

/// Why a host does not start, or has to end.
#[derive(Clone, Debug, PartialEq)]
pub enum HostError {
    StateInUse {
        dir: PathBuf,
        pid: String,
    },
    /// The directory's files were removed, and the process that uses it runs on.
    StateHeld {
        dir: PathBuf,
    },
    StateUnwritable {
        dir: PathBuf,
        because: String,
    },
    /// The process that uses the directory goes on; `help` says what to do.
    NotTakenOver {
        dir: PathBuf,
        pid: String,
        because: String,
        help: String,
    },
    Threads {
        because: String,
    },
    /// The limit of its memory cannot be set.
    Memory {
        mib: u32,
        because: String,
    },
    /// The host was not started inside a tokio runtime that can serve it.
    NoRuntime {
        lacks: &'static str,
    },
    /// The name given for the process is not a valid name.
    BadName {
        name: String,
        because: String,
    },
    Store(StoreError),
    /// The journal of the GCM cannot be gone on with.
    Journal(gcm::StoreError),
    /// A plugin linked into the program cannot be used.
    Linked {
        because: String,
    },
    /// Plugin files are to be taken, and no program is there to try them out.
    NoVetting {
        tried: Vec<PathBuf>,
    },
    /// The address cannot be listened on; `help` says what to do.
    Listen {
        because: String,
        help: String,
    },
    /// It cannot show other machines who it is.
    Identity {
        because: String,
    },
    /// No GCM answers where `--gcm` points.
    NoGcm {
        addr: String,
        because: String,
    },
    /// The GCM does not take this process, or a process of its name runs at its address.
    Refused(Refusal),
}

impl HostError {
    /// Reason code for scripts.
    pub fn reason(&self) -> &'static str {
        match self {
            HostError::StateInUse { .. } | HostError::StateHeld { .. } => "STATE_IN_USE",
            HostError::StateUnwritable { .. } => "STATE_UNWRITABLE",
            HostError::NotTakenOver { .. } => "NOT_TAKEN_OVER",
            HostError::Threads { .. } | HostError::Memory { .. } => "NO_RESOURCES",
            HostError::NoRuntime { .. } => "NO_RUNTIME",
            HostError::BadName { .. } => "BAD_NAME",
            HostError::Store(e) => e.reason(),
            HostError::Journal(e) => match e.unusable {
                Unusable::Newer => "JOURNAL_NEWER",
                Unusable::InUse => "STATE_IN_USE",
                Unusable::NotLeading => "NOT_LEADER",
                Unusable::Damaged | Unusable::Now | Unusable::NotSynced => "JOURNAL_DAMAGED",
            },
            HostError::Linked { .. } => "PLUGIN_LINKED",
            HostError::NoVetting { .. } => "NO_VETTING",
            HostError::Listen { .. } => "LISTEN",
            HostError::Identity { .. } => "IDENTITY",
            HostError::NoGcm { .. } => "NO_GCM",
            HostError::Refused(refusal) => refusal.reason(),
        }
    }

    /// Returns the advice: what to do.
    pub fn help(&self) -> String {
        match self {
            HostError::StateInUse { .. } | HostError::StateHeld { .. } => {
                "stop that process, or run this one beside it: --state DIR --listen 127.0.0.1:0".into()
            }
            HostError::StateUnwritable { .. } => {
                "choose a directory you may write to: --state DIR (or set XDG_STATE_HOME)".into()
            }
            HostError::Journal(e) => match e.unusable {
                Unusable::Newer => {
                    "use that release; or choose another directory with --state, or begin anew with --fresh, which keeps the old journal beside the new one".into()
                }
                Unusable::InUse => "end that process first, or choose another directory with --state".into(),
                Unusable::NotLeading => "start it again: it follows the GCM that leads now".into(),
                _ if e.is_remote() => {
                    "name another prefix with --store, or give etcd back what it had (`etcdctl snapshot restore`)"
                        .into()
                }
                Unusable::Damaged | Unusable::Now | Unusable::NotSynced => format!(
                    "`trocar journal verify --state {}` says what can be read; --fresh begins anew and keeps the old journal beside the new one",
                    e.file.parent().unwrap_or(&e.file).display()
                ),
            },
            HostError::Threads { .. } => {
                "raise the limit on processes (ulimit -u), or end other programs".into()
            }
            HostError::Memory { .. } => "give a limit the system allows (ulimit -Hd tells it), or none".into(),
            HostError::NoRuntime { .. } => {
                "start it inside tokio::runtime::Builder::new_multi_thread().enable_all(), or under #[tokio::main]".into()
            }
            HostError::BadName { .. } => {
                "give the process a name such as `lab`: a letter or _, then letters, digits, _ . - (63 at most)".into()
            }
            HostError::Store(e) => split(e).1,
            HostError::Linked { .. } => {
                "build the plugin with the trocar-sdk of this program's own version, and name it once".into()
            }
            HostError::NoVetting { .. } => {
                "name the trocar program with HostBuilder::vet_with, or put it beside this one or in PATH"
                    .into()
            }
            HostError::Listen { help, .. } | HostError::NotTakenOver { help, .. } => help.clone(),
            HostError::Identity { .. } => {
                "`trocar ca issue NAME --role host --process NAME` makes one (--role gcm for a GCM): give it with --identity FILE"
                    .into()
            }
            HostError::NoGcm { addr, .. } if addr.contains("https://") => {
                "see that the GCM runs with --listen-tls at that address, and that both certificates are of one authority and \
                 valid: `trocar ca ls`"
                    .into()
            }
            HostError::NoGcm { addr, .. } => {
                format!("start it first: `trocar gcm --listen {addr}`, or leave --gcm out: this host embeds one")
            }
            HostError::Refused(refusal) => refusal.help(),
        }
    }
}

impl fmt::Display for HostError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            HostError::StateInUse { dir, pid } => {
                write!(f, "the state directory {} is in use by process {pid}", dir.display())
            }
            HostError::StateHeld { dir } => {
                write!(
                    f,
                    "the state directory {} is in use by a process that runs on although its files were removed",
                    dir.display()
                )
            }
            HostError::StateUnwritable { dir, because } => {
                write!(f, "the state directory {} cannot be used: {because}", dir.display())
            }
            HostError::NotTakenOver { dir, pid, because, .. } => write!(
                f,
                "process {pid} in the state directory {} is not taken over from: {because}",
                dir.display()
            ),
            HostError::Journal(e) => e.fmt(f),
            HostError::Threads { because } => write!(f, "the system gives no more threads: {because}"),
            HostError::Memory { mib, because } => {
                write!(f, "the memory of the process cannot be limited to {mib} MiB: {because}")
            }
            HostError::NoRuntime { lacks } => {
                write!(f, "a host lives in a tokio runtime with clock and network, and {lacks}")
            }
            HostError::BadName { name, because } => {
                write!(f, "`{name}` is no name for a process: {because}")
            }
            HostError::Store(e) => f.write_str(&split(e).0),
            HostError::Linked { because } => f.write_str(because),
            HostError::NoVetting { tried } => {
                let tried: Vec<String> = tried.iter().map(|p| p.display().to_string()).collect();
                write!(
                    f,
                    "plugin files are tried out by the program trocar, which is none of {}",
                    tried.join(", ")
                )
            }
            HostError::Listen { because, .. } | HostError::Identity { because } => f.write_str(because),
            HostError::NoGcm { addr, because } => write!(f, "no GCM answers at {addr}: {because}"),
            HostError::Refused(refusal) => write!(f, "{refusal}"),
        }
    }
}

/// A store's sentence ends with its remedy behind the last colon.
fn split(e: &StoreError) -> (String, String) {
    let text = e.to_string();
    match text.rsplit_once(": ") {
        Some((what, remedy)) => (what.to_owned(), remedy.to_owned()),
        None => (text, String::new()),
    }
}

impl std::error::Error for HostError {}

impl From<StoreError> for HostError {
    fn from(e: StoreError) -> Self {
        HostError::Store(e)
    }
}

impl From<ServeError> for HostError {
    fn from(e: ServeError) -> Self {
        match e {
            ServeError::Unusable { because, help } => HostError::Listen { because, help },
            ServeError::Exists(refusal) => HostError::Refused(refusal),
        }
    }
}

impl From<UplinkError> for HostError {
    fn from(e: UplinkError) -> Self {
        match e {
            UplinkError::NoGcm { addr, because } => HostError::NoGcm { addr, because },
            UplinkError::Refused(refusal) => HostError::Refused(refusal),
        }
    }
}

impl From<Refusal> for HostError {
    fn from(refusal: Refusal) -> Self {
        HostError::Refused(refusal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stores_sentence_is_split_into_what_and_what_to_do() {
        let e = HostError::from(StoreError::DirMissing { dir: "plugins".into() });
        assert_eq!(e.to_string(), "plugin directory plugins does not exist");
        assert_eq!(e.help(), "create it with mkdir -p, or name another");
    }
}
