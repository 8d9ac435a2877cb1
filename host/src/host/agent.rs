//! The process of an agent: `trocar agent`.
//!
//! Invariant: it ends what it keeps before its port closes, so that whoever wanted it kept sees it end.

use std::net::SocketAddr;
use std::path::PathBuf;

use super::machines::Ways;
use super::{HostError, Machines, PortRules, StateChoice, StateDir};
use crate::agent::{Agent, AgentSettings};
use crate::control::Server;
use crate::processes::Exit;
use crate::runtime_dir::RuntimeDir;

/// A running agent.
pub struct AgentHost {
    state: StateDir,
    agent: Agent,
    server: Server,
}

impl AgentHost {
    /// Starts an agent. `plugins`: directories for processes that bring no plugin files; `allow_exec`: their
    /// components may start programs, where a system says so.
    ///
    /// # Errors
    /// Its state directory, its identity or its port cannot be used.
    pub async fn start(
        listen: &str,
        state: &StateChoice,
        (plugins, allow_exec): (Vec<PathBuf>, bool),
        (rules, machines): (PortRules, &Machines),
    ) -> Result<AgentHost, HostError> {
        let Ways { secured, .. } = machines.open(None)?;
        let state = StateDir::open(state, false)?;
        let absolute = |path: PathBuf| std::path::absolute(&path).unwrap_or(path);
        let settings = AgentSettings {
            plugins: plugins.into_iter().map(absolute).collect(),
            identity: machines.identity.clone().map(absolute),
            revoked: machines.revoked.clone().map(absolute),
            allow_exec,
        };
        let folder = absolute(state.path().to_owned());
        let agent = Agent::open(&folder, settings)
            .map_err(|e| HostError::StateUnwritable { dir: folder, because: e.to_string() })?;
        let runtime = Some(RuntimeDir::of_user());
        let server = Server::start_agent(listen, rules, secured, runtime, agent.clone()).await?;
        Ok(AgentHost { state, agent, server })
    }

    /// Returns the address that it listens on.
    pub fn addr(&self) -> SocketAddr {
        self.server.addr()
    }

    /// Returns the address at which other machines reach it, if there is one.
    pub fn secured(&self) -> Option<SocketAddr> {
        self.server.secured()
    }

    /// Returns its state directory.
    pub fn state_dir(&self) -> &StateDir {
        &self.state
    }

    /// Ends everything, devices safe first. Returns the processes that did not end in order.
    pub async fn shutdown(self) -> Vec<(String, Exit)> {
        let failed = self.agent.end().await;
        self.server.shutdown().await;
        failed
    }
}
