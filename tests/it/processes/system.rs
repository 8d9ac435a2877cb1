//! A system file that is up, and its processes by number.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, Trocar, World, eventually, number};

/// `trocar up` in a world of its own.
pub(crate) struct System {
    pub(crate) process: HostProcess,
    pub(crate) grpc: Grpcurl,
    pub(crate) world: World,
}

impl System {
    /// Waits until everything is up.
    pub(crate) fn up(file: &str, more: &[&str]) -> System {
        System::up_with(&["sine", "example", "fixture_chaos"], file, more)
    }

    /// The same, of these plugins.
    pub(crate) fn up_with(plugins: &[&str], file: &str, more: &[&str]) -> System {
        let world = World::with_plugins(plugins);
        let path = world.write("system.json", file);
        let mut args =
            vec!["up".into(), path.into(), "--listen".into(), "127.0.0.1:0".into(), "--json".into()];
        args.extend(more.iter().map(Into::into));
        let process = HostProcess::spawn(&world, "up", &args);
        let grpc = process.grpcurl();
        System { process, grpc, world }
    }

    pub(crate) fn trocar(&self) -> Trocar {
        Trocar::at(&self.world, self.process.address())
    }

    pub(crate) fn list(&self) -> Value {
        self.grpc.ok("GcmService/List", json!({}))
    }

    /// A process as the GCM lists it.
    pub(crate) fn host(&self, name: &str) -> Value {
        let list = self.grpc.ok("GcmService/List", json!({ "brief": true }));
        let processes = list["processes"].as_array().cloned().unwrap_or_default();
        let mut found =
            processes.into_iter().find(|p| p["name"] == name).unwrap_or_else(|| panic!("no {name}: {list}"));
        // The classes are long and none of these tests' business.
        found["classes"] = Value::Null;
        found
    }

    /// Waits until another incarnation of a process has what the one before had.
    pub(crate) fn await_back(&self, name: &str, before: &Value) {
        eventually(&format!("{name} is back"), || {
            let now = self.host(name);
            let back = now["state"] == "PROCESS_STATE_ATTACHED" && pid(&now) != pid(before);
            // Its supervisor and itself are two who tell.
            if back && number(&now["restarts"]) > number(&before["restarts"]) {
                Ok(())
            } else {
                Err(now.to_string())
            }
        });
    }

    /// Kills every incarnation of a process until it is given up; how it stands then.
    pub(crate) fn kill_until_failed(&self, name: &str) -> Value {
        let mut last = 0;
        eventually(&format!("{name} is FAILED"), || {
            let process = self.host(name);
            if process["state"] == "PROCESS_STATE_FAILED" {
                return Ok(process);
            }
            let now = pid(&process);
            if process["state"] == "PROCESS_STATE_ATTACHED" && now != last {
                last = now;
                kill("-KILL", now);
            }
            Err(process.to_string())
        })
    }

    /// Stops a process from running and waits until that is noticed; how it was before.
    pub(crate) fn hold(&self, name: &str) -> Value {
        let before = self.host(name);
        freeze(pid(&before));
        eventually(&format!("{name} is missed"), || match self.host(name) {
            now if now["state"] == "PROCESS_STATE_LOST" => Ok(()),
            now => Err(now.to_string()),
        });
        before
    }

    /// Its children: the GCM and the hosts.
    pub(crate) fn pids(&self) -> Vec<u64> {
        children(u64::from(self.process.pid()))
    }

    /// How many files and threads `up` holds.
    pub(crate) fn holds(&self) -> (usize, usize) {
        let of = |part: &str| {
            let entries = std::fs::read_dir(format!("/proc/{}/{part}", self.process.pid()));
            entries.map_or(0, Iterator::count)
        };
        (of("fd"), of("task"))
    }

    /// The process of this name that runs now, attached or not.
    pub(crate) fn pid_of(&self, name: &str) -> Option<u64> {
        let is_it = |pid: &u64| command_line(*pid).windows(2).any(|two| two == ["--name", name]);
        self.pids().into_iter().find(is_it)
    }

    pub(crate) fn gcm_pid(&self) -> u64 {
        eventually("a GCM runs", || self.pids().into_iter().find(|pid| is_gcm(*pid)).ok_or("none"))
    }
}

pub(crate) fn pid(process: &Value) -> u64 {
    number(&process["pid"])
}

pub(crate) fn kill(signal: &str, pid: u64) {
    let sent = Command::new("kill").args([signal, &pid.to_string()]).status();
    assert!(sent.is_ok_and(|s| s.success()), "kill {signal} {pid} did not work");
}

/// Stops a process, and waits until each of its threads has heard of it: until then they go on.
pub(crate) fn freeze(pid: u64) {
    kill("-STOP", pid);
    eventually("all of its threads stand still", || match running_threads(pid) {
        0 => Ok(()),
        n => Err(n),
    });
}

/// Threads of a process that neither stand still nor have ended.
fn running_threads(pid: u64) -> usize {
    let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let stats = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("stat")).ok());
    stats
        .filter(|stat| stat.rsplit_once(") ").is_some_and(|(_, rest)| !rest.starts_with(['T', 'Z', 'X'])))
        .count()
}

/// It has ended, waited for or not.
pub(crate) fn gone(pid: u64) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(") ").is_none_or(|(_, rest)| rest.starts_with(['Z', 'X']))
}

/// Processes that keep their state in a directory.
pub(crate) fn running_in(home: &Path) -> Vec<u64> {
    let home = home.to_string_lossy();
    running(|arguments| arguments.iter().any(|arg| arg.contains(&*home)))
}

/// Processes of the machine that were started with such arguments, the program's name first.
pub(crate) fn running(are: impl Fn(&[String]) -> bool) -> Vec<u64> {
    let all = std::fs::read_dir("/proc").unwrap().flatten();
    let pids = all.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    pids.filter(|pid| are(&command_line(*pid)) && !gone(*pid)).collect()
}

pub(crate) fn is_gcm(pid: u64) -> bool {
    command_line(pid).iter().any(|arg| arg == "gcm")
}

/// Where a process listens, by the sockets it holds.
pub(crate) fn listening(pid: u64) -> Option<String> {
    sockets(pid, "0A").into_iter().next()
}

/// Its own ends of the connections of a process.
pub(crate) fn connected(pid: u64) -> BTreeSet<String> {
    sockets(pid, "01")
}

/// Local addresses of the sockets of a process that are in a state.
fn sockets(pid: u64, wanted: &str) -> BTreeSet<String> {
    let held: Vec<String> = std::fs::read_dir(format!("/proc/{pid}/fd"))
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|fd| std::fs::read_link(fd.path()).ok()?.to_str().map(str::to_owned))
        .collect();
    let table = std::fs::read_to_string("/proc/net/tcp").unwrap_or_default();
    let of_process = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let (at, state, inode) = (words.get(1)?, words.get(3)?, words.get(9)?);
        let is_it = *state == wanted && held.contains(&format!("socket:[{inode}]"));
        let port = u16::from_str_radix(at.rsplit_once(':')?.1, 16).ok()?;
        is_it.then(|| format!("127.0.0.1:{port}"))
    };
    table.lines().skip(1).filter_map(of_process).collect()
}

fn command_line(pid: u64) -> Vec<String> {
    let line = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    line.split('\0').map(str::to_owned).collect()
}

pub(crate) fn children(parent: u64) -> Vec<u64> {
    let tasks = std::fs::read_dir(Path::new("/proc").join(parent.to_string()).join("task"));
    let of = |task: std::path::PathBuf| std::fs::read_to_string(task.join("children")).unwrap_or_default();
    let all: Vec<String> = tasks.into_iter().flatten().flatten().map(|task| of(task.path())).collect();
    let all = all.iter().flat_map(|children| children.split_whitespace());
    all.filter_map(|pid| pid.parse().ok()).filter(|pid| !gone(*pid)).collect()
}
