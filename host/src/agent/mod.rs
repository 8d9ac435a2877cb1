//! Processes that `trocar up` of other machines wants kept on this one, system by system.
//!
//! Invariant: a system has one caller that is heard. Its processes outlive a caller that is not heard any
//! more, since a network that is cut stops nothing that runs; they end when that caller has hung up and does
//! not come again, when another takes its place, and with the agent.

mod files;
mod system;

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parking_lot::Mutex;
use trocar_loader::Hash;
use trocar_model::{Name, Refusal};

pub use self::files::{Coming, PluginFile};
use self::files::{Files, unwritten};
pub use self::system::{Following, Seat};
use self::system::{RETURN, System};
use crate::host::PortRules;
use crate::processes::{Exit, Status};
use crate::system_file::ProcessSpec;

/// What an agent gives to every process that it keeps.
#[derive(Clone, Debug, Default)]
pub struct AgentSettings {
    /// Plugin directories of this machine, for processes without any of their own.
    pub plugins: Vec<PathBuf>,
    /// File of the identity that its processes show.
    pub identity: Option<PathBuf>,
    /// File of the certificates that are believed no more.
    pub revoked: Option<PathBuf>,
    /// Components may start programs, where a system says so.
    pub allow_exec: bool,
}

/// A process that is to be kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Wanted {
    /// Its settings; `plugins`, `trust` and `machine` of a file do not count.
    pub spec: ProcessSpec,
    /// Its plugin files; none: those of the agent's machine.
    pub plugins: Vec<PluginFile>,
    /// Text of the list of hashes of the plugin files that it takes; empty: files of its user and root.
    pub hashes: String,
    /// Address of its GCM.
    pub gcm: String,
    /// Rights of callers at its port.
    pub rules: PortRules,
}

/// A system of which an agent keeps processes.
#[derive(Clone, Debug)]
pub struct Listed {
    pub system: Name,
    /// The caller that wants them, or wanted them last.
    pub caller: String,
    pub is_heard: bool,
    pub statuses: BTreeMap<String, Status>,
}

/// Keeper of processes for systems of other machines. Clones share one.
#[derive(Clone)]
pub struct Agent {
    inner: Arc<Inner>,
}

struct Inner {
    folder: PathBuf,
    settings: AgentSettings,
    files: Files,
    /// The place of a system stays when the system has gone. Never held while anything is waited for.
    systems: Mutex<BTreeMap<Name, Slot>>,
}

/// The one system of its name, if it is there. Held while it ends.
type Slot = Arc<tokio::sync::Mutex<Option<Arc<System>>>>;

impl Agent {
    /// Opens an agent that keeps everything below `folder`.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn open(folder: &Path, settings: AgentSettings) -> io::Result<Agent> {
        let files = Files::open(folder.join("files"))?;
        let (folder, systems) = (folder.to_owned(), Mutex::default());
        Ok(Agent { inner: Arc::new(Inner { folder, settings, files, systems }) })
    }

    /// Takes a caller in that wants processes of a system kept. The same run of a system goes on where it
    /// was; of another one all processes end first.
    ///
    /// # Errors
    /// The system has a caller that is heard, and is another run.
    pub async fn take_in(&self, system: Name, run: &str, caller: String) -> Result<Seat, Refusal> {
        let slot = self.inner.systems.lock().entry(system.clone()).or_default().clone();
        let mut there = slot.lock().await;
        if let Some(kept) = &*there {
            if kept.run() == run {
                return Ok(kept.seat(self.clone(), caller));
            }
            kept.gives_way(&system)?;
            log::info!("another run of the system {system} has come: what it had here ends");
            kept.end().await;
            *there = None;
        }
        let folder = self.inner.folder.join("systems").join(system.as_str());
        files::make(&folder).map_err(|e| unwritten(&folder, &e))?;
        let kept = Arc::new(System::new(folder, run.to_owned()));
        let seat = kept.seat(self.clone(), caller);
        *there = Some(kept);
        Ok(seat)
    }

    /// Lets a system go whose caller has hung up, unless it comes again in time.
    fn hung_up(&self, kept: Arc<System>, seat: u64) {
        let inner = self.inner.clone();
        tokio::spawn(async move {
            if kept.runs() {
                log::warn!("the caller of {} has hung up", kept.folder().display());
            }
            if kept.has_processes() {
                tokio::time::sleep(RETURN).await;
            }
            let slots: Vec<Slot> = inner.systems.lock().values().cloned().collect();
            for slot in slots {
                let mut there = slot.lock().await;
                if there.as_ref().is_some_and(|now| Arc::ptr_eq(now, &kept)) && kept.is_left_by(seat) {
                    kept.end().await;
                    *there = None;
                }
            }
        });
    }

    /// Ends all processes, devices safe first. Returns those that did not end in order.
    pub async fn end(&self) -> Vec<(String, Exit)> {
        let slots: Vec<Slot> = self.inner.systems.lock().values().cloned().collect();
        let ending = slots.into_iter().map(|slot| async move {
            match slot.lock().await.take() {
                Some(kept) => kept.end().await,
                None => Vec::new(),
            }
        });
        futures_util::future::join_all(ending).await.into_iter().flatten().collect()
    }

    /// Lists the systems that it keeps processes of.
    pub async fn systems(&self) -> Vec<Listed> {
        let slots: Vec<(Name, Slot)> =
            self.inner.systems.lock().iter().map(|(name, slot)| (name.clone(), slot.clone())).collect();
        let mut listed = Vec::new();
        for (system, slot) in slots {
            // One that ends now is not waited for.
            let Ok(there) = slot.try_lock() else { continue };
            listed.extend(there.as_ref().map(|kept| kept.listed(system)));
        }
        listed
    }

    /// Returns those of these plugin files that are not here.
    pub fn missing(&self, hashes: &[Hash]) -> Vec<Hash> {
        hashes.iter().filter(|hash| !self.inner.files.has(hash)).copied().collect()
    }

    /// Begins to take a plugin file in.
    ///
    /// # Errors
    /// The disk is full, or cannot be written.
    pub fn bring(&self, hash: Hash) -> Result<Coming, Refusal> {
        self.inner.files.begin(hash)
    }
}
