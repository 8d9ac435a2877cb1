//! Callers that connect and say nothing, more of them than a process may have files.

use std::net::TcpStream;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde_json::json;
use trocar_tests::{HostProcess, Trocar, World, eventually, skip};

use super::holds;

pub(super) const CALLERS: u64 = 1100;
const FILES: u64 = 1024;

/// So many files for this program, which holds the other ends.
fn may_open(files: u64) -> bool {
    let now = getrlimit(Resource::Nofile);
    let wanted = Rlimit { current: Some(files.max(now.current.unwrap_or(files))), maximum: now.maximum };
    now.maximum.is_none_or(|most| most >= files) && setrlimit(Resource::Nofile, wanted).is_ok()
}

/// A host with a running component and few files for all its callers; `None` where this program may not have as many as it plays.
pub(super) fn few_files() -> Option<(World, HostProcess)> {
    if !may_open(4 * CALLERS) {
        return None;
    }
    let world = World::with_plugins(&["example"]);
    let host = HostProcess::start_with(&world, "host", &[]);
    super::limits::limit(&host, "nofile", &format!("{FILES}:4096"));
    let grpc = host.grpcurl();
    grpc.await_class("host", "Server");
    grpc.create("host/server", "Server", json!({}));
    grpc.start("host/server");
    Some((world, host))
}

/// Callers that say nothing, until they are dropped.
pub(super) struct Crowd(Vec<TcpStream>);

impl Crowd {
    pub(super) fn at(host: &HostProcess) -> Crowd {
        Crowd((0..CALLERS).map(|_| TcpStream::connect(host.address()).unwrap()).collect())
    }
}

#[test]
fn a_thousand_silent_callers_keep_nobody_away_and_are_let_go() {
    let Some((world, host)) = few_files() else {
        skip("this machine lets a program open too few files to play so many callers");
        return;
    };
    let (grpc, trocar) = (host.grpcurl(), Trocar::at(&world, host.address()));
    let before = holds(host.pid());
    let crowd = Crowd::at(&host);
    trocar.run(&["stop", "host/server"]).ends_with(0);
    trocar.run(&["start", "host/server"]).ends_with(0);
    // Its socket is not the port's, whose callers waited in turn; those who say nothing gave way.
    grpc.ok("GcmService/Stop", json!({ "path": "host/server" }));
    let most = usize::try_from(FILES).unwrap();
    let now = holds(host.pid());
    assert!(now.files + 32 < most, "no files are left for plugins and links: {now:?} of {most}");
    eventually("they are let go", || {
        let now = holds(host.pid());
        // A caller of a moment ago may be closing.
        if now.files <= before.files + 2 { Ok(()) } else { Err(format!("{now:?}, before {before:?}")) }
    });
    assert_eq!(crowd.0.len() as u64, CALLERS, "they held on until now");
}
