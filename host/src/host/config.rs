//! Configuration of a host, as plain data.

use std::path::PathBuf;

use trocar_loader::Trust;
use trocar_model::Name;
use trocar_plugin_api::abi::StaticPlugin;

use super::machines::Machines;
use super::{MemoryBounds, StateChoice};
use crate::control::PortRules;

/// Configuration of a host.
#[derive(Clone, Debug)]
pub struct HostConfig {
    pub name: Name,
    /// Watched plugin directories; empty: none.
    pub plugins: Vec<PathBuf>,
    /// Plugins linked into this program.
    pub linked: Vec<StaticPlugin>,
    /// Address to listen on; port 0 takes a free one. `None`: no port at all.
    pub listen: Option<String>,
    pub state: StateChoice,
    /// Forget what an earlier process left in the state directory.
    pub fresh: bool,
    /// Rights of callers at that address.
    pub rules: PortRules,
    /// The way by which other machines know it, and reach it.
    pub machines: Machines,
    /// The GCM to attach to; `None`: this host embeds one.
    pub gcm: Option<String>,
    /// Wait for that GCM when it does not answer yet, or still takes an earlier incarnation of this
    /// process for alive.
    pub await_gcm: bool,
    pub trust: Trust,
    /// The `trocar` program that tries plugin files out in a child process; `None`: it is looked for, see
    /// [`HostBuilder::vet_with`](super::HostBuilder::vet_with).
    pub vet_with: Option<PathBuf>,
    /// Keep all memory of the process resident, so that no cycle waits for a page.
    pub lock_memory: bool,
    /// Components may start programs, as this process's user.
    pub allow_exec: bool,
    /// Bounds of the memory that the process may use.
    pub memory: MemoryBounds,
}

impl HostConfig {
    /// Makes a configuration without plugins and port, with an ephemeral state directory and a
    /// GCM of its own.
    pub fn new(name: Name) -> HostConfig {
        HostConfig {
            name,
            plugins: Vec::new(),
            linked: Vec::new(),
            listen: None,
            rules: PortRules::default(),
            machines: Machines::default(),
            state: StateChoice::Ephemeral,
            fresh: false,
            gcm: None,
            await_gcm: false,
            trust: Trust::Dev,
            vet_with: None,
            lock_memory: false,
            allow_exec: false,
            memory: MemoryBounds::default(),
        }
    }
}
