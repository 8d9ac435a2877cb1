//! The processes of a lab, and which component is in which.
//!
//! Invariant: a component stays in the process it was made in; its path is found by its name alone.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::{Arc, MutexGuard, OnceLock, PoisonError};

use serde_json::json;
use tempfile::TempDir;
use trocar::Host;
use trocar::gcm::Registration;
use trocar::host::{Machines, PortRules, StateChoice};
use trocar::lcm::Lcm;
use trocar::model::{ComponentId, ConnectOptions, Execution, Name, PortId, Request, Target};
use trocar_net::Authority;

use super::world::runtime;
use super::{Lab, Languages};
use crate::{HostProcess, World, eventually, issue_host};

/// The process of clients.
const HOST: &str = "host";
/// The process of servers, where there are two.
const OTHER: &str = "other";

/// The way by which other machines reach a process of a lab whose connections have this carrier.
pub(super) fn machines(carrier: &str) -> Machines {
    if carrier != "net" {
        return Machines::default();
    }
    // One identity for all labs of this process.
    static IDENTITY: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let (_, identity) = IDENTITY.get_or_init(|| {
        let dir = TempDir::new().unwrap_or_else(|e| panic!("no directory: {e}"));
        let identity = dir.path().join("lab.pem");
        let authority = Authority::init(&dir.path().join("authority"));
        let mut authority = authority.unwrap_or_else(|e| panic!("no authority: {e}"));
        issue_host(&mut authority, "lab", &[HOST, OTHER], &identity);
        (dir, identity)
    });
    Machines { identity: Some(identity.clone()), lines: Some("127.0.0.1:0".into()), ..Machines::default() }
}

fn name(process: &str) -> Name {
    process.parse().unwrap_or_else(|e| panic!("{process}: {e}"))
}

impl Lab {
    /// The other process, where servers are then made.
    pub(super) fn part(mut self) -> Lab {
        let builder = Host::builder().name(OTHER).machines(machines(self.carrier));
        let builder = self.languages.offer(builder, &self.world);
        let other = runtime().block_on(builder.start()).unwrap_or_else(|e| panic!("no other host: {e}"));
        let lcm = other.lcm().cloned().unwrap_or_else(|| panic!("the other host has no LCM"));
        let attached = runtime().block_on(async {
            let inventory = lcm.inventory().await?;
            self.gcm.register(Registration::new(name(OTHER), String::new()), lcm, inventory).await
        });
        attached.unwrap_or_else(|refusal| panic!("the other host is not attached: {refusal}"));
        self.other = Some(other);
        self
    }

    /// Two processes of the built program, attached to a GCM here.
    pub(super) fn spawned(languages: Languages) -> Lab {
        let world = World::new();
        languages.drop_in(&world);
        let state = StateChoice::Durable(world.state().join("gcm"));
        let host = runtime().block_on(Host::start_gcm(
            "127.0.0.1:0",
            &state,
            false,
            (PortRules::default(), &Machines::default()),
        ));
        let mut lab = Lab::around(host.unwrap_or_else(|e| panic!("no GCM: {e}")), languages, world);
        let gcm = lab.address();
        for process in [HOST, OTHER] {
            let spawned = HostProcess::start_with(&lab.world, process, &["--gcm", &gcm]);
            lab.spawned.insert(process, spawned);
        }
        let classes = ["Client", "Server"].map(|class| format!("{}/{class}", languages.plugin(class)));
        for process in [HOST, OTHER].map(name) {
            eventually(&format!("{process} is attached with its classes"), || {
                let graph = lab.graph();
                let known = graph.processes.get(&process).ok_or("not attached")?;
                let has = |class: &String| known.classes.iter().any(|c| c.full_name() == *class);
                if classes.iter().all(has) { Ok(()) } else { Err("not all of them are there") }
            });
        }
        lab
    }

    /// Servers are in another process than clients.
    pub(super) fn is_parted(&self) -> bool {
        self.other.is_some() || !self.spawned.is_empty()
    }

    fn servers(&self) -> MutexGuard<'_, BTreeSet<String>> {
        self.servers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is between clients and servers carries this connection.
    pub(super) fn carried(&self, client: &str, server: &str, mut options: ConnectOptions) -> ConnectOptions {
        let component = |path: &str| path.split('/').next().unwrap_or_default().to_owned();
        let sides = [client, server].map(|path| self.servers().contains(&component(path)));
        if options.carrier.is_empty() && sides == [false, true] {
            options.carrier = self.carrier.to_owned();
        }
        options
    }

    /// Frames pass between clients and servers in memory that is mapped twice.
    pub(super) fn maps(&self) -> bool {
        self.is_parted() || self.carrier == "memfd"
    }

    /// Frames are copied from one machine to the other.
    pub(super) fn copies(&self) -> bool {
        self.carrier == "net"
    }

    fn places(&self) -> MutexGuard<'_, BTreeMap<String, &'static str>> {
        self.places.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The path of a component, or of something of it.
    #[must_use]
    pub fn path(&self, name: &str) -> String {
        let component = name.split('/').next().unwrap_or_default();
        format!("{}/{name}", self.places().get(component).unwrap_or(&HOST))
    }

    /// Of a component, or of one that has something of this name.
    pub(super) fn id(&self, name: &str) -> ComponentId {
        let path = self.path(name.split('/').next().unwrap_or_default());
        ComponentId::parse(&path).unwrap_or_else(|e| panic!("{path}: {e}"))
    }

    pub(super) fn port(&self, path: &str) -> PortId {
        let path = self.path(path);
        PortId::parse(&path).unwrap_or_else(|e| panic!("{path}: {e}"))
    }

    pub(super) fn targets(&self, name: &str) -> Vec<Target> {
        vec![Target::One(self.id(name))]
    }

    /// The LCMs of all processes.
    pub(super) fn lcms(&self) -> Vec<Arc<dyn Lcm>> {
        let names = [HOST].into_iter().chain(self.is_parted().then_some(OTHER));
        names.map(|process| self.lcm(process)).collect()
    }

    fn lcm(&self, process: &str) -> Arc<dyn Lcm> {
        self.gcm.lcm_of(&name(process)).unwrap_or_else(|refusal| panic!("{process}: {refusal}"))
    }

    /// The LCM of a component's process.
    pub(super) fn lcm_of(&self, component: &str) -> Arc<dyn Lcm> {
        self.lcm(self.places().get(component).unwrap_or(&HOST))
    }

    /// The number of a component's process.
    #[must_use]
    pub fn pid_of(&self, component: &str) -> u32 {
        let process = self.places().get(component).copied().unwrap_or(HOST);
        self.spawned.get(process).map_or_else(std::process::id, HostProcess::pid)
    }

    /// Puts a component into its process: servers into the other one, if there is one; what shares a thread
    /// to that thread.
    pub(super) fn place(&self, name: &str, class: &str, execution: Execution) -> Execution {
        // It stays where it is, so that a second one of its name is refused.
        let before = self.places().get(name).copied();
        let stays = before.filter(|_| self.stands(name).is_some());
        let leader = |path: &str| path.trim_start_matches("host/").to_owned();
        let with = execution.stream_of.as_deref().or(execution.inside.as_deref()).map(leader);
        let process = match &with {
            _ if stays.is_some() => stays.unwrap_or(HOST),
            Some(leader) => self.places().get(leader).copied().unwrap_or(HOST),
            None if self.is_parted() && Languages::is_of_servers(class) => OTHER,
            None => HOST,
        };
        self.places().insert(name.to_owned(), process);
        let serves = match &with {
            Some(leader) => self.servers().contains(leader),
            None => Languages::is_of_servers(class),
        };
        if serves {
            self.servers().insert(name.to_owned());
        }
        let moved = |path: Option<String>| path.map(|path| format!("{process}/{}", leader(&path)));
        Execution { stream_of: moved(execution.stream_of), inside: moved(execution.inside), ..execution }
    }

    /// Makes one in the process where another one is.
    #[track_caller]
    pub fn create_beside(&self, other: &str, name: &str, class: &str, execution: Execution) {
        let there = self.places().get(other).copied().unwrap_or(HOST);
        self.places().insert(name.to_owned(), there);
        let class = format!("{}/{class}", self.languages.plugin(class));
        self.done(Request::Create { id: self.id(name), class, config: Some(json!({})), execution });
    }
}
