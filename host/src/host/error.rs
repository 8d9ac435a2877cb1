//! Why a host does not start.
//!
//! Invariant: each sentence names what was asked for and each help says what to do; nothing is left half made.

use std::fmt;
use std::path::PathBuf;

use trocar_model::Refusal;

use crate::control::{ServeError, UplinkError};
use crate::loader::StoreError;

/// Why a host does not start, or has to end.
#[derive(Clone, Debug, PartialEq)]
pub enum HostError {
    StateInUse {
        dir: PathBuf,
        pid: String,
    },
    StateUnwritable {
        dir: PathBuf,
        because: String,
    },
    Threads {
        because: String,
    },
    Store(StoreError),
    /// The address cannot be listened on; `help` says what to do.
    Listen {
        because: String,
        help: String,
    },
    /// Nobody answers where `--gcm` points.
    NoGcm {
        addr: String,
        because: String,
    },
    /// The GCM does not take this process.
    Refused(Refusal),
}

impl HostError {
    /// Reason code for scripts.
    pub fn reason(&self) -> &'static str {
        match self {
            HostError::StateInUse { .. } => "STATE_IN_USE",
            HostError::StateUnwritable { .. } => "STATE_UNWRITABLE",
            HostError::Threads { .. } => "NO_RESOURCES",
            HostError::Store(e) => match e {
                StoreError::StateUnwritable { .. } => "STATE_UNWRITABLE",
                StoreError::StateForeign { .. } => "STATE_FOREIGN",
                StoreError::StateNoExec { .. } => "STATE_NOEXEC",
                StoreError::DirMissing { .. }
                | StoreError::DirNotADirectory { .. }
                | StoreError::DirUnreadable { .. } => "PLUGIN_DIR",
                StoreError::TrustUnknown { .. } | StoreError::TrustSigned | StoreError::AllowList { .. } => {
                    "TRUST"
                }
            },
            HostError::Listen { .. } => "LISTEN",
            HostError::NoGcm { .. } => "NO_GCM",
            HostError::Refused(refusal) => refusal.reason(),
        }
    }

    /// What to do.
    pub fn help(&self) -> String {
        match self {
            HostError::StateInUse { .. } => {
                "stop that process, or give this one its own directory: --state DIR".into()
            }
            HostError::StateUnwritable { .. } => {
                "choose a directory you may write to: --state DIR (or set XDG_STATE_HOME)".into()
            }
            HostError::Threads { .. } => {
                "raise the limit on processes (ulimit -u), or end other programs".into()
            }
            HostError::Store(e) => split(e).1,
            HostError::Listen { help, .. } => help.clone(),
            HostError::NoGcm { .. } => {
                "start it first: `trocar gcm`, or leave --gcm out: this host embeds one".into()
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
            HostError::StateUnwritable { dir, because } => {
                write!(f, "the state directory {} cannot be used: {because}", dir.display())
            }
            HostError::Threads { because } => write!(f, "the system gives no more threads: {because}"),
            HostError::Store(e) => f.write_str(&split(e).0),
            HostError::Listen { because, .. } => f.write_str(because),
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
        HostError::Listen { because: e.because, help: e.help }
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
