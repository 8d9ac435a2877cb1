//! Members of an etcd cluster of a test's own, as child processes on loopback.
//!
//! Invariant: each has free ports and a data directory of its own, and is ended by its handle. Used by the
//! outer tests, and by the unit tests of the journal, which name this file.
#![allow(clippy::unwrap_used)]

use std::fs::File;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use tempfile::TempDir;

/// Longest wait for a cluster to be there, on a machine that is loaded.
const PATIENCE: Duration = Duration::from_secs(60);

/// A cluster.
pub struct EtcdCluster {
    members: Vec<Member>,
    dir: TempDir,
}

struct Member {
    client: u16,
    peer: u16,
    child: Option<Child>,
}

/// Returns the program, which `./tests/run` fetches.
fn etcd_program() -> PathBuf {
    if let Some(path) = env::var_os("ETCD") {
        return path.into();
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let fetched = root.join("target/outer/etcd/usr/bin/etcd");
    assert!(fetched.is_file(), "there is no etcd: `./tests/run etcd` fetches it, or name it in ETCD");
    fetched
}

/// A port that was free a moment ago.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

impl EtcdCluster {
    /// Starts a cluster of so many members, and waits until it answers.
    pub fn start(size: usize) -> EtcdCluster {
        // Another program may take a port that was free.
        (0..5).find_map(|_| EtcdCluster::try_start(size)).expect("etcd does not start")
    }

    fn try_start(size: usize) -> Option<EtcdCluster> {
        let dir = tempfile::tempdir().unwrap();
        let member = |_| Member { client: free_port(), peer: free_port(), child: None };
        let mut cluster = EtcdCluster { members: (0..size).map(member).collect(), dir };
        for at in 0..size {
            cluster.restart(at);
        }
        let until = Instant::now() + PATIENCE;
        while !(0..size).all(|at| cluster.is_healthy(at)) {
            let ended = |member: &mut Member| member.child.as_mut().unwrap().try_wait().unwrap().is_some();
            if cluster.members.iter_mut().any(ended) {
                return None;
            }
            assert!(Instant::now() < until, "no cluster within {PATIENCE:?}:\n{}", cluster.log(0));
            thread::sleep(Duration::from_millis(20));
        }
        Some(cluster)
    }

    /// Starts a member, or starts it again with what it has.
    pub fn restart(&mut self, at: usize) {
        let url = |port: u16| format!("http://127.0.0.1:{port}");
        let named = |(at, member): (usize, &Member)| format!("m{at}={}", url(member.peer));
        let all: Vec<String> = self.members.iter().enumerate().map(named).collect();
        let Member { client, peer, .. } = self.members[at];
        let log = File::options().create(true).append(true).open(self.dir.path().join(format!("log{at}")));
        let log = log.unwrap();
        let mut etcd = Command::new(etcd_program());
        etcd.args(["--name", &format!("m{at}"), "--initial-cluster", &all.join(",")]);
        etcd.arg("--data-dir").arg(self.dir.path().join(format!("data{at}")));
        etcd.args(["--listen-client-urls", &url(client), "--advertise-client-urls", &url(client)]);
        etcd.args(["--listen-peer-urls", &url(peer), "--initial-advertise-peer-urls", &url(peer)]);
        etcd.env_clear().stdin(Stdio::null()).stdout(log.try_clone().unwrap()).stderr(log);
        self.members[at].child = Some(etcd.spawn().unwrap());
    }

    /// Tells whether a member has a leader and answers.
    pub fn is_healthy(&self, at: usize) -> bool {
        use std::io::{Read, Write};
        let ask = || {
            let mut way = std::net::TcpStream::connect(("127.0.0.1", self.members[at].client))?;
            way.set_read_timeout(Some(Duration::from_secs(2)))?;
            way.write_all(b"GET /health HTTP/1.0\r\n\r\n")?;
            let mut answer = String::new();
            way.read_to_string(&mut answer)?;
            std::io::Result::Ok(answer)
        };
        ask().is_ok_and(|answer| answer.contains(r#""health":"true""#))
    }

    /// Addresses of all members, with commas between them.
    pub fn addresses(&self) -> String {
        let all: Vec<String> = self.members.iter().map(|m| format!("127.0.0.1:{}", m.client)).collect();
        all.join(",")
    }

    /// Address of one member.
    pub fn address(&self, at: usize) -> String {
        format!("127.0.0.1:{}", self.members[at].client)
    }

    /// The place of a journal with that prefix.
    pub fn place(&self, prefix: &str) -> String {
        format!("etcd://{}/{prefix}", self.addresses())
    }

    /// Number of the process of a member.
    pub fn pid(&self, at: usize) -> u32 {
        self.members[at].child.as_ref().unwrap().id()
    }

    /// Kills a member; it can be started again.
    pub fn kill(&mut self, at: usize) {
        if let Some(mut child) = self.members[at].child.take() {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }

    /// Log of a member.
    pub fn log(&self, at: usize) -> String {
        fs::read_to_string(self.dir.path().join(format!("log{at}"))).unwrap_or_default()
    }
}

impl Drop for EtcdCluster {
    fn drop(&mut self) {
        for member in &mut self.members {
            if let Some(child) = &mut member.child {
                // It may have ended by itself.
                let _ = child.kill();
                let _ = child.wait();
            }
        }
    }
}
