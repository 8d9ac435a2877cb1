//! What the suite's components are written in, and how they reach the host.
//!
//! Invariant: the three offer the same classes under different plugin names, so that one's client takes
//! another's server.

use std::env;

use trocar::host::HostBuilder;
use trocar_conform_classes::{Arm, Client, Probe, Server, Shelf, Through};
use trocar_sdk::{StaticPlugin, static_plugin};

use super::super::{Built, World};

/// The Rust classes linked into the test itself.
static LINKED: StaticPlugin =
    static_plugin!(name = "conform-linked", Server, Client, Through, Arm, Shelf, Probe);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Language {
    /// Rust, from a plugin file.
    Rust,
    /// C++, from a plugin file.
    Cpp,
    /// Rust, linked into the host.
    Linked,
}

impl Language {
    /// The plugin that has its classes.
    #[must_use]
    pub fn plugin(self) -> &'static str {
        match self {
            Language::Rust => "fixture-conform",
            Language::Cpp => "conform_cpp",
            Language::Linked => "conform-linked",
        }
    }

    /// Why the classes cannot be had here; a machine may have no C++ compiler.
    #[must_use]
    pub fn missing(self) -> Option<String> {
        if self == Language::Cpp { env::var("TROCAR_NO_CPP").ok() } else { None }
    }

    fn offer(self, host: HostBuilder, world: &World) -> HostBuilder {
        if self == Language::Linked {
            return host.plugin(LINKED);
        }
        self.drop_in(world);
        host
    }

    /// Puts its plugin file, if it has one, into the plugin directory.
    fn drop_in(self, world: &World) {
        match self {
            Language::Linked => {}
            Language::Rust => _ = world.drop_in(&Built::plugin("fixture_conform")),
            Language::Cpp => _ = world.drop_in(&Built::cpp_plugin("conform_cpp")),
        }
    }
}

/// What clients and servers are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Languages {
    pub client: Language,
    pub server: Language,
}

impl From<Language> for Languages {
    fn from(both: Language) -> Languages {
        Languages { client: both, server: both }
    }
}

impl Languages {
    /// The plugin whose class of this name a lab makes. Filters belong to the clients: they take what servers
    /// give.
    #[must_use]
    pub fn plugin(self, class: &str) -> &'static str {
        if Languages::is_of_servers(class) { self.server.plugin() } else { self.client.plugin() }
    }

    /// A class that serves others.
    #[must_use]
    pub fn is_of_servers(class: &str) -> bool {
        !["Client", "Probe", "Arm", "Through"].contains(&class)
    }

    /// Why the classes cannot be had here.
    #[must_use]
    pub fn missing(self) -> Option<String> {
        self.client.missing().or_else(|| self.server.missing())
    }

    /// Puts the plugin files into the plugin directory, for processes of the built program.
    pub fn drop_in(self, world: &World) {
        self.client.drop_in(world);
        self.server.drop_in(world);
    }

    /// Gives the classes to a host that is to be started; `world` holds the plugin directory.
    #[must_use]
    pub fn offer(self, host: HostBuilder, world: &World) -> HostBuilder {
        let mut host = self.server.offer(host, world);
        if self.client != self.server {
            host = self.client.offer(host, world);
        }
        let linked = [self.client, self.server].iter().all(|l| *l == Language::Linked);
        if linked { host } else { host.plugins(world.plugins()).vet_with(Built::trocar()) }
    }
}
