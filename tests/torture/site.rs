//! A GCM and hosts side by side, each a program of its own that a row kills and starts again by itself.
//!
//! Invariant: each start has a name of its own, so what was printed before a kill is kept.

use std::collections::BTreeMap;

use rustix::process::Signal;
use serde_json::json;
use trocar_proto::v1::ProcessState;

use crate::book::Book;
use crate::clock::{eventually, now_ns};
use crate::invariants::nothing_is_left;
use crate::journal::Journal;
use crate::program::{Program, host_args, signal_to};
use crate::rpc::Rpc;
use crate::world::World;

/// Name of the GCM among those of hosts.
pub(crate) const GCM: &str = ":gcm";

pub(crate) struct Site {
    // Before the world, whose directory they use.
    pub(crate) gcm: Program,
    pub(crate) hosts: BTreeMap<String, Program>,
    pub(crate) rpc: Rpc,
    pub(crate) world: World,
    starts: usize,
}

impl Site {
    /// All of it, attached, with their classes.
    pub(crate) fn new(plugins: &[&str], names: &[&str]) -> Result<Site, String> {
        let world = World::new(plugins)?;
        let gcm = started(&world, "gcm-0", gcm_args(&world, "127.0.0.1:0"))?;
        let (hosts, rpc) = (BTreeMap::new(), Rpc::at(&gcm.address));
        let mut site = Site { gcm, hosts, rpc, world, starts: 0 };
        for name in names {
            site.host_again(name)?;
        }
        site.await_all()?;
        for name in names {
            let class = "fixture-torture/sink";
            eventually(&format!("{name} offers {class}"), || {
                let (path, nothing) = (format!("{name}/first"), json!({}));
                site.rpc.create(&path, class, nothing)?;
                Ok(site.rpc.remove(&path, true)?)
            })?;
        }
        Ok(site)
    }

    /// Starts a GCM at the same address, on the same journal.
    pub(crate) fn gcm_again(&mut self) -> Result<(), String> {
        self.starts += 1;
        let args = gcm_args(&self.world, &self.gcm.address);
        self.gcm = started(&self.world, &format!("gcm-{}", self.starts), args)?;
        Ok(())
    }

    /// Starts a host of that name, in the state directory it had.
    pub(crate) fn host_again(&mut self, name: &str) -> Result<(), String> {
        self.starts += 1;
        let args = host_args(&self.world, name, name, Some(&self.gcm.address));
        let host = started(&self.world, &format!("{name}-{}", self.starts), args)?;
        self.hosts.insert(name.to_owned(), host);
        Ok(())
    }

    pub(crate) fn host(&mut self, name: &str) -> Result<&mut Program, String> {
        self.hosts.get_mut(name).ok_or_else(|| format!("there is no host {name}"))
    }

    /// Kills everything, in that order; the GCM is `:gcm`.
    pub(crate) fn kill_all(&mut self, order: &[&str]) -> Result<(), String> {
        for name in order {
            let pid = if *name == GCM { self.gcm.pid() } else { self.host(name)?.pid() };
            signal_to(pid, Signal::KILL)?;
        }
        // Waited for when all are dead.
        self.gcm.kill();
        self.hosts.values_mut().for_each(Program::kill);
        Ok(())
    }

    /// Starts everything in that order, one right after the other, and waits for their addresses.
    pub(crate) fn start_all(&mut self, order: &[&str]) -> Result<(), String> {
        let address = self.gcm.address.clone();
        for name in order {
            self.starts += 1;
            let mut args = match *name {
                GCM => gcm_args(&self.world, &address),
                host => host_args(&self.world, host, host, Some(&address)),
            };
            // A host that is tied waits for its GCM.
            let is_tied = *name != GCM;
            args.extend(is_tied.then(|| "--tied".to_owned()));
            let name_of = format!("{}-{}", name.trim_start_matches(':'), self.starts);
            let program = Program::begin(&self.world, &name_of, &args, is_tied)?;
            if *name == GCM { self.gcm = program } else { *self.host(name)? = program }
        }
        self.gcm.await_address()?;
        self.hosts.values_mut().try_for_each(Program::await_address)
    }

    /// Waits until each host that runs is attached, and answers when.
    pub(crate) fn await_all(&self) -> Result<u64, String> {
        let pids: BTreeMap<&String, u32> = self.hosts.iter().map(|(name, host)| (name, host.pid())).collect();
        eventually("everybody is attached", || {
            let listed = self.rpc.brief()?.processes;
            let is_there = |(name, pid): (&&String, &u32)| {
                listed
                    .iter()
                    .any(|p| p.name == **name && p.pid == *pid && p.state() == ProcessState::Attached)
            };
            if pids.iter().all(is_there) { Ok(now_ns()) } else { Err(standing(&listed)) }
        })
    }

    pub(crate) fn journal(&self) -> Result<Journal, String> {
        Journal::read(&self.world, &self.world.path("state/gcm"))
    }

    /// Ends it all in order; nothing is left, nobody has panicked.
    pub(crate) fn down(mut self, book: &mut Book) -> Result<(), String> {
        for host in self.hosts.values_mut() {
            host.terminate()?;
        }
        self.gcm.terminate()?;
        nothing_is_left(book, &self.world);
        Ok(())
    }
}

/// The observed system while processes come, without what changes by itself.
fn standing(processes: &[trocar_proto::v1::Process]) -> String {
    let of = |p: &trocar_proto::v1::Process| format!("{} {:?} {}", p.name, p.state(), p.pid);
    processes.iter().map(of).collect::<Vec<_>>().join(", ")
}

fn gcm_args(world: &World, address: &str) -> Vec<String> {
    let state = world.text("state/gcm");
    ["gcm", "--listen", address, "--state", &state].map(str::to_owned).to_vec()
}

fn started(world: &World, name: &str, args: Vec<String>) -> Result<Program, String> {
    let mut program = Program::begin(world, name, &args, false)?;
    program.await_address()?;
    Ok(program)
}
