//! Builds a host inside a program, step by step.
//!
//! Invariant: a builder ends in [`HostConfig::start`], as the command line does.

use std::path::PathBuf;

use trocar_loader::Trust;
use trocar_model::{Name, Refusal};
use trocar_plugin_api::abi::StaticPlugin;

use super::{Host, HostConfig, HostError, Machines, MemoryBounds, StateChoice};
use crate::control::Viewer;

/// Fills in a [`HostConfig`] step by step; made by [`Host::builder`].
#[derive(Clone, Debug)]
pub struct HostBuilder {
    /// A name that is none is said at the end, so that one computed at run time needs no handling of its own.
    config: Result<HostConfig, HostError>,
}

impl Host {
    /// Builds a host inside a program. Unless the builder is told otherwise, it is named `host` and has no
    /// plugins, no port, an ephemeral state directory and a GCM of its own.
    ///
    /// ```
    /// # tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap().block_on(async {
    /// let host = trocar::Host::builder().name("lab").start().await?;
    /// let refused = host.create("lab/source", "sine", serde_json::json!({})).await.unwrap_err();
    /// assert_eq!(refused.reason(), "CLASS_NOT_FOUND");
    /// host.shutdown().await;
    /// # Ok::<(), trocar::host::HostError>(())
    /// # }).unwrap();
    /// ```
    pub fn builder() -> HostBuilder {
        HostBuilder { config: named("host").map(HostConfig::new) }
    }
}

impl HostBuilder {
    /// Name of the process, the first part of its components' paths.
    #[must_use]
    pub fn name(mut self, name: &str) -> Self {
        self.config = self.config.and_then(|config| Ok(HostConfig { name: named(name)?, ..config }));
        self
    }

    /// A directory of plugin files, watched; may be given several times.
    #[must_use]
    pub fn plugins(self, dir: impl Into<PathBuf>) -> Self {
        self.with(|c| c.plugins.push(dir.into()))
    }

    /// A plugin linked into this program; may be given several times.
    #[must_use]
    pub fn plugin(self, plugin: StaticPlugin) -> Self {
        self.with(|c| c.linked.push(plugin))
    }

    /// Serves gRPC at this address; port 0 takes a free one.
    #[must_use]
    pub fn listen(self, addr: impl Into<String>) -> Self {
        self.with(|c| c.listen = Some(addr.into()))
    }

    /// Sets what the viewer's page at that address may do.
    #[must_use]
    pub fn viewer(self, viewer: Viewer) -> Self {
        self.with(|c| c.rules.viewer = viewer)
    }

    /// Lets every caller that reaches that address do everything, other users of the machine, too. Without it
    /// they only read.
    #[must_use]
    pub fn open_loopback(self, open: bool) -> Self {
        self.with(|c| c.rules.open_loopback = open)
    }

    /// Sets where the host keeps its state.
    #[must_use]
    pub fn state(self, state: StateChoice) -> Self {
        self.with(|c| c.state = state)
    }

    /// Forgets what an earlier run left in the state directory.
    #[must_use]
    pub fn fresh(self, fresh: bool) -> Self {
        self.with(|c| c.fresh = fresh)
    }

    /// Attaches to the GCM at this address instead of having its own.
    #[must_use]
    pub fn gcm(self, addr: impl Into<String>) -> Self {
        self.with(|c| c.gcm = Some(addr.into()))
    }

    /// Lets processes of other machines know and reach this one.
    #[must_use]
    pub fn machines(self, machines: Machines) -> Self {
        self.with(|c| c.machines = machines)
    }

    /// Sets which plugin files are taken.
    #[must_use]
    pub fn trust(self, trust: Trust) -> Self {
        self.with(|c| c.trust = trust)
    }

    /// Sets the `trocar` program in whose child process plugin files are tried out before this program maps
    /// them. Unset: this program if it is `trocar` itself, else `trocar` beside it, else in `PATH`.
    #[must_use]
    pub fn vet_with(self, program: impl Into<PathBuf>) -> Self {
        self.with(|c| c.vet_with = Some(program.into()))
    }

    /// Keeps all memory of the process resident. A refusal of the machine is written to the log, and
    /// the host starts.
    #[must_use]
    pub fn lock_memory(self, lock: bool) -> Self {
        self.with(|c| c.lock_memory = lock)
    }

    /// Lets components start programs, as this process's user; classes that do are refused otherwise.
    #[must_use]
    pub fn allow_exec(self, allow: bool) -> Self {
        self.with(|c| c.allow_exec = allow)
    }

    /// Sets from where on the process is warned of the memory it uses, and how much it gets at most: a limit
    /// of the whole program.
    #[must_use]
    pub fn memory(self, bounds: MemoryBounds) -> Self {
        self.with(|c| c.memory = bounds)
    }

    /// Starts the host. Call it inside a tokio runtime with clock and network (`enable_all`). When the
    /// runtime ends before the host, the components run on until the host is dropped, but nothing can be
    /// asked of it any more.
    ///
    /// # Errors
    /// As [`HostConfig::start`]; an invalid name; no such runtime.
    pub async fn start(self) -> Result<Host, HostError> {
        self.config?.start().await
    }

    fn with(mut self, set: impl FnOnce(&mut HostConfig)) -> Self {
        if let Ok(config) = &mut self.config {
            set(config);
        }
        self
    }
}

fn named(name: &str) -> Result<Name, HostError> {
    Name::parse(name).map_err(|refusal| {
        let because = match refusal {
            _ if name.is_empty() => "it is empty".to_owned(),
            Refusal::BadPath { why, .. } => why,
            other => other.to_string(),
        };
        HostError::BadName { name: name.to_owned(), because }
    })
}
