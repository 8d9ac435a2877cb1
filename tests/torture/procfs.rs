//! What a process holds, and which processes there are, as the kernel says it.
//!
//! Invariant: a process that has ended but was not yet waited for counts as ended.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// What a process holds, of each kind how many of each name.
#[derive(Clone, Default)]
pub(crate) struct Held {
    /// By what they lead to: memory files, `socket`, `anon_inode:…`, paths.
    fds: Names,
    threads: Names,
    /// Mappings of memory files.
    segments: Names,
}

type Names = BTreeMap<String, usize>;

impl Held {
    /// How anything of it is more than before; `None` when nothing is.
    pub(crate) fn beyond(&self, before: &Held) -> Option<String> {
        let sockets = |held: &Held| held.fds.get(SOCKET).copied().unwrap_or(0);
        let grown = count(&self.fds) > count(&before.fds)
            || sockets(self) > sockets(before)
            || count(&self.threads) > count(&before.threads)
            || count(&self.segments) > count(&before.segments);
        let kinds = [
            ("files", &self.fds, &before.fds),
            ("threads", &self.threads, &before.threads),
            ("segments", &self.segments, &before.segments),
        ];
        grown.then(|| kinds.map(|(what, now, before)| difference(what, now, before)).join("; "))
    }
}

const SOCKET: &str = "socket";

fn count(names: &Names) -> usize {
    names.values().sum()
}

fn difference(what: &str, now: &Names, before: &Names) -> String {
    let names: BTreeSet<&String> = now.keys().chain(before.keys()).collect();
    let of = |names: &Names, name: &String| names.get(name).copied().unwrap_or(0);
    let changed = names.into_iter().filter(|name| of(now, name) != of(before, name));
    let changed: Vec<String> =
        changed.map(|name| format!("{name} {} (before {})", of(now, name), of(before, name))).collect();
    format!("{} {what} (before {}): {}", count(now), count(before), changed.join(", "))
}

fn names(all: impl Iterator<Item = String>) -> Names {
    let mut names = Names::new();
    for name in all {
        *names.entry(name).or_default() += 1;
    }
    names
}

/// How many threads a process has.
pub(crate) fn threads(pid: u32) -> usize {
    entries(&format!("/proc/{pid}/task")).len()
}

pub(crate) fn held(pid: u32) -> Held {
    let fds = entries(&format!("/proc/{pid}/fd")).into_iter().map(|fd| {
        let to = fs::read_link(format!("/proc/{pid}/fd/{fd}"));
        let to = to.map_or_else(|_| "closed meanwhile".to_owned(), |to| to.to_string_lossy().into_owned());
        // Without the number of each.
        if to.starts_with("socket:") { SOCKET.to_owned() } else { to }
    });
    let threads = entries(&format!("/proc/{pid}/task")).into_iter().map(|tid| {
        let name = fs::read_to_string(format!("/proc/{pid}/task/{tid}/comm")).unwrap_or_default();
        name.trim().to_owned()
    });
    let maps = fs::read_to_string(format!("/proc/{pid}/maps")).unwrap_or_default();
    let segments = maps.lines().filter_map(|line| Some(line[line.find("/memfd:")?..].to_owned()));
    Held { fds: names(fds), threads: names(threads), segments: names(segments) }
}

/// Memory of a process that is in use, KiB.
pub(crate) fn rss_kib(pid: u32) -> u64 {
    status_kib(pid, "VmRSS:")
}

fn status_kib(pid: u32, field: &str) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(field));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

/// Processor time of a process so far, ms.
pub(crate) fn cpu_ms(pid: u32) -> u64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    let fields: Vec<&str> =
        stat.rsplit_once(") ").map(|(_, rest)| rest.split_whitespace().collect()).unwrap_or_default();
    let ticks = |at: usize| fields.get(at).and_then(|n| n.parse::<u64>().ok()).unwrap_or(0);
    (ticks(11) + ticks(12)) * 1000 / rustix::param::clock_ticks_per_second()
}

/// How long threads of this name were ready and got no processor, ms; 0 where the kernel does not count that.
pub(crate) fn kept_waiting_ms(pid: u32, name: &str) -> f64 {
    let of = |tid: String| {
        let read =
            |file: &str| fs::read_to_string(format!("/proc/{pid}/task/{tid}/{file}")).unwrap_or_default();
        let waited: u64 =
            read("schedstat").split_whitespace().nth(1).and_then(|ns| ns.parse().ok()).unwrap_or(0);
        if read("comm").trim().ends_with(name) { waited } else { 0 }
    };
    entries(&format!("/proc/{pid}/task")).into_iter().map(of).sum::<u64>() as f64 / 1e6
}

/// It has ended, waited for or not.
pub(crate) fn gone(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(") ").is_none_or(|(_, rest)| rest.starts_with(['Z', 'X']))
}

pub(crate) fn command_line(pid: u32) -> Vec<String> {
    let line = fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    line.split('\0').map(str::to_owned).collect()
}

/// The living children of a process.
pub(crate) fn children(parent: u32) -> Vec<u32> {
    let tasks = entries(&format!("/proc/{parent}/task"));
    let of = |task: &String| {
        fs::read_to_string(format!("/proc/{parent}/task/{task}/children")).unwrap_or_default()
    };
    let all: Vec<String> = tasks.iter().map(of).collect();
    let pids = all.iter().flat_map(|pids| pids.split_whitespace()).filter_map(|pid| pid.parse().ok());
    pids.filter(|pid| !gone(*pid)).collect()
}

/// Living processes that name a directory in their command line.
pub(crate) fn naming(dir: &Path) -> Vec<u32> {
    let dir = dir.to_string_lossy();
    let me = std::process::id();
    let pids = entries("/proc").into_iter().filter_map(|entry| entry.parse().ok()).filter(|pid| *pid != me);
    pids.filter(|pid| command_line(*pid).iter().any(|arg| arg.contains(&*dir)) && !gone(*pid)).collect()
}

fn entries(dir: &str) -> Vec<String> {
    let all = fs::read_dir(dir).into_iter().flatten().flatten();
    all.filter_map(|entry| entry.file_name().into_string().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_holds_files_and_threads_and_is_not_gone() {
        let me = std::process::id();
        let held = held(me);
        let counts = (count(&held.fds), count(&held.threads));
        assert!(counts.0 >= 1 && counts.1 >= 1 && rss_kib(me) > 0 && !gone(me), "{counts:?}");
        let more = held.beyond(&Held::default()).unwrap();
        assert!(more.contains("threads (before 0)"), "{more}");
        assert_eq!(held.beyond(&held), None);
    }
}
