//! What must be so after every row, whatever was done in it.
//!
//! Invariant: asked at rest: everybody is given the time to get there, and what is still wrong when nothing
//! changes is a finding.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use trocar_proto::v1::{Health, ListResponse, ProcessState};

use crate::book::Book;
use crate::clock::eventually;
use crate::files;
use crate::procfs::{self, Held};
use crate::rpc::{Rpc, state_name};
use crate::world::World;

/// What is to be there: component and state, and the ends of each connection.
pub(crate) struct Desired {
    components: BTreeSet<(String, String)>,
    connections: BTreeSet<(u64, String, String)>,
}

impl Desired {
    /// As it is now.
    pub(crate) fn now(rpc: &Rpc) -> Result<Desired, String> {
        Ok(Desired::of(&rpc.brief()?))
    }

    fn of(list: &ListResponse) -> Desired {
        let components = list.components.iter().map(|c| (c.path.clone(), state_name(c.state()))).collect();
        let connections =
            list.connections.iter().map(|c| (c.id, c.client.clone(), c.server.clone())).collect();
        Desired { components, connections }
    }
}

/// G3: what was asked for is what the GCM sees and what each process has; both ends of each connection carry
/// it.
pub(crate) fn agree(rpc: &Rpc, desired: &Desired) -> Result<(), String> {
    eventually("desired, observed and actual agree", || {
        let list = rpc.list()?;
        for process in &list.processes {
            if process.state() != ProcessState::Attached {
                return Err(format!("process {} is {:?}", process.name, process.state()));
            }
        }
        let seen = Desired::of(&list);
        if seen.components != desired.components {
            let missing: Vec<_> = desired.components.difference(&seen.components).collect();
            let other: Vec<_> = seen.components.difference(&desired.components).collect();
            return Err(format!("components should be {missing:?} and are {other:?}"));
        }
        if seen.connections != desired.connections {
            let missing: Vec<_> = desired.connections.difference(&seen.connections).collect();
            let more: Vec<_> = seen.connections.difference(&desired.connections).collect();
            return Err(format!("connections lack {missing:?} and have {more:?} more"));
        }
        for component in &list.components {
            if !matches!(component.health(), Health::Ok | Health::Overrun) {
                return Err(format!("{} is {:?}", component.path, component.health()));
            }
        }
        // The figures come from the client's process, which has none of a connection it does not carry.
        match list.connections.iter().find(|c| c.carrier.is_empty()) {
            Some(c) => Err(format!("{} to {} is not carried", c.client, c.server)),
            None => Ok(()),
        }
    })
}

/// What some processes hold at rest.
pub(crate) struct Holdings(Vec<(String, u32, Held)>);

impl Holdings {
    pub(crate) fn of(processes: &[(&str, u32)]) -> Holdings {
        let of = |(name, pid): &(&str, u32)| ((*name).to_owned(), *pid, procfs::held(*pid));
        Holdings(processes.iter().map(of).collect())
    }

    /// G5: none of them holds more than before.
    pub(crate) fn have_not_grown(&self) -> Result<(), String> {
        eventually("nothing more is held", || {
            let grown = self.0.iter().find_map(|(name, pid, before)| {
                let more = procfs::held(*pid).beyond(before)?;
                Some(format!("{name} holds {more}"))
            });
            grown.map_or(Ok(()), Err)
        })
    }
}

/// G5 and G7, when all has been taken down: no process, socket or shared memory is left, and nobody panicked.
pub(crate) fn nothing_is_left(book: &mut Book, world: &World) {
    nothing_runs(book, world);
    book.check("nobody panicked (G7)", 1, files::nowhere_in(world.root(), "panicked at"));
}

/// G5 alone, where something was told to panic.
pub(crate) fn nothing_runs(book: &mut Book, world: &World) {
    let processes = eventually("all processes have ended", || match procfs::naming(world.root()) {
        left if left.is_empty() => Ok(()),
        left => Err(format!("{left:?} still run")),
    });
    book.check("no process is left (G5)", 1, processes);
    let is_socket = |file: &PathBuf| file.extension().is_some_and(|e| e == "sock");
    book.check("no socket is left (G5)", 1, none(files::below(world.root()), is_socket));
    let is_ours = |file: &PathBuf| file.to_string_lossy().contains("trocar");
    let shared = files::below(Path::new("/dev/shm"));
    book.check("no shared memory with a name is left (G5)", 1, none(shared, is_ours));
}

fn none(files: BTreeSet<PathBuf>, such: impl Fn(&PathBuf) -> bool) -> Result<(), String> {
    let left: Vec<PathBuf> = files.into_iter().filter(such).collect();
    if left.is_empty() { Ok(()) } else { Err(format!("{left:?}")) }
}
