//! Pools whose frames pass between two processes: announced by the writer, mapped by the reader.
//!
//! Invariant: a pool is announced once, under its place on the link, and before that its frames wait at the
//! reader.

use std::os::fd::OwnedFd;

use trocar_rt::pool::PoolFile;
use trocar_rt::stream::RemoteViews;

use super::medium::Message;
use super::server::ServerWires;
use super::words::Pool;

/// Pools that are not announced to the other end yet.
#[derive(Default)]
pub(super) struct Untold {
    pub(super) pools: Vec<Pool>,
    pub(super) files: Vec<OwnedFd>,
    /// Number of announced pools, these included.
    pub(super) told: usize,
}

impl Untold {
    pub(super) fn of(wires: &ServerWires) -> Untold {
        let ServerWires::Output { pools, told, .. } = wires else { return Untold::default() };
        let mut untold = Untold { told: *told, ..Untold::default() };
        while let Some(number) = pools.at(untold.told) {
            // A pool that is gone already has no frames that could come.
            if let Some(file) = PoolFile::numbered(number) {
                // Out of files: the next look may find one.
                let Ok(fd) = file.fd().try_clone_to_owned() else { break };
                untold.pools.push(Pool::new(untold.told, file.shape()));
                untold.files.push(fd);
            }
            untold.told += 1;
        }
        untold
    }

    /// Notes that the pools were announced.
    pub(super) fn note(told_now: usize, wires: &mut ServerWires) {
        if let ServerWires::Output { told, .. } = wires {
            *told = told_now;
        }
    }
}

/// Checks that every file that was sent along has arrived.
pub(super) fn all_came(message: &Message) -> Result<(), String> {
    let (given, announced) = (message.files.len(), message.announced);
    if given == announced {
        return Ok(());
    }
    Err(format!("{given} of {announced} files came along: this process may open no more (ulimit -n)"))
}

/// Maps pools of the other process.
pub(super) fn map(
    views: &RemoteViews,
    pools: &[Pool],
    files: impl IntoIterator<Item = OwnedFd>,
) -> Result<(), String> {
    let mut files = files.into_iter();
    for pool in pools {
        let fd = files.next().ok_or("the memory of a pool did not come along")?;
        let file = PoolFile::open(fd, pool.shape()).map_err(|e| e.to_string())?;
        if !views.know(pool.place, file) {
            return Err("the place of a pool is taken, or its headers have another length".into());
        }
    }
    Ok(())
}
