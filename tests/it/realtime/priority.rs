//! Real-time priority and locked memory: granted or refused, as the kernel has it and as the component tells
//! it.
//!
//! Promise: GetState says nothing else than /proc, and a component whose wishes are refused runs all the
//! same.

use std::fs;

use serde_json::{Value, json};
use trocar_tests::{HostProcess, World, eventually};

use super::Scene;
use super::rights::{self, Limit};

const PRIORITY: u64 = 10;
/// What a thread locks of its stack where not all memory may be locked.
const OF_A_STACK_KIB: u64 = 128;
/// One thread of `host/p`, three of `host/camera`.
const THREADS: [&str; 4] = ["p", "camera", "+1 camera", "+2 camera"];

/// A host that is to lock its memory, with components that want a priority, under these limits; `None`: as
/// this process is.
fn scene(limits: Option<&'static [Limit]>) -> Scene {
    let world = World::with_plugins(&["fixture_pace"]);
    let host = HostProcess::start_prepared(&world, "host", &["--lock-memory"], |command| {
        if let Some(limits) = limits {
            rights::limit(command, limits);
        }
    });
    let grpc = host.grpcurl();
    grpc.await_class("host", "pace");
    let scene = Scene { grpc, host, _world: world };
    scene.pace("host/p", json!({ "priority": PRIORITY }), json!({}));
    let team = json!({ "priority": PRIORITY, "threads": 3 });
    scene.grpc.create_with("host/camera", "camera", json!({}), team);
    scene.grpc.start("host/camera");
    scene.until("host/p", "steps", 5);
    scene.until("host/camera", "frames", 5);
    scene
}

impl Scene {
    /// Waits until the kernel schedules a thread by this policy with this real-time priority: a helper may
    /// begin late.
    fn until_scheduled(&self, thread: &str, expected: (u64, u64)) {
        eventually(&format!("{thread:?} has policy and priority {expected:?}"), || {
            let tasks = fs::read_dir(format!("/proc/{}/task", self.host.pid())).unwrap().flatten();
            let mut seen = Vec::new();
            for stat in tasks.map(|task| fs::read_to_string(task.path().join("stat")).unwrap_or_default()) {
                let Some((name, rest)) = stat.rsplit_once(") ") else { continue };
                let name = name.split_once('(').map_or("", |(_, name)| name);
                // Counted from the state, which is field 3: rt_priority is field 40, policy 41.
                let field = |n: usize| rest.split(' ').nth(n - 3).unwrap().parse::<u64>().unwrap();
                let stands = (field(41), field(40));
                if name == thread && stands == expected {
                    return Ok(());
                }
                seen.push(format!("{name:?} {stands:?}"));
            }
            Err(seen.join(", "))
        });
    }

    /// A line of the host's status in /proc.
    fn status(&self, name: &str) -> String {
        let status = fs::read_to_string(format!("/proc/{}/status", self.host.pid())).unwrap();
        status.lines().find_map(|line| line.strip_prefix(name)).unwrap().trim().to_owned()
    }

    fn locked_kib(&self) -> u64 {
        self.status("VmLck:").trim_end_matches(" kB").parse().unwrap()
    }

    /// What its state warns of that has these words.
    fn warnings(&self, path: &str, words: &str) -> Vec<String> {
        let stats = self.stats(path);
        let all = stats["warnings"].as_array().cloned().unwrap_or_default();
        all.iter().filter_map(Value::as_str).filter(|w| w.contains(words)).map(str::to_owned).collect()
    }

    /// All its threads stand as its state says; whether the priority was granted.
    fn tells_its_priority(&self) -> bool {
        let granted = self.stats("host/p")["realtime"] == true;
        for path in ["host/p", "host/camera"] {
            let refused = self.warnings(path, "real-time priority 10 was refused");
            assert_eq!(self.stats(path)["realtime"] == true, granted, "{}", self.stats(path));
            assert_eq!(refused.is_empty(), granted, "{path}: {refused:?}");
            for way_out in ["normal scheduling", "CAP_SYS_NICE", "ulimit -r"] {
                assert!(refused.iter().all(|w| w.contains(way_out)), "{refused:?} does not say {way_out}");
            }
        }
        let expected = if granted { (libc::SCHED_FIFO, PRIORITY) } else { (libc::SCHED_OTHER, 0) };
        for thread in THREADS {
            self.until_scheduled(thread, (expected.0 as u64, expected.1));
        }
        granted
    }

    /// It steps on, whatever was refused.
    fn goes_on(&self) {
        for (path, field) in [("host/p", "steps"), ("host/camera", "frames")] {
            let now = self.count(path, field);
            self.until(path, field, now + 5);
            assert_eq!(self.grpc.state(path), "ACTIVE", "{path}");
        }
    }
}

#[test]
fn a_priority_is_what_the_kernel_gave_or_the_state_says_how_to_get_it() {
    let scene = scene(None);
    scene.tells_its_priority();
    scene.goes_on();
}

#[test]
fn a_priority_that_is_refused_is_told_and_the_component_steps_all_the_same() {
    let scene = scene(Some(&[(libc::RLIMIT_RTPRIO, 0)]));
    assert!(!scene.tells_its_priority(), "the host may ask for none");
    scene.goes_on();
}

#[test]
fn all_memory_is_locked_or_the_state_says_what_is_and_why() {
    let scene = scene(None);
    let said = scene.warnings("host/p", "locked into memory");
    if said.is_empty() {
        let resident: u64 = scene.status("VmRSS:").trim_end_matches(" kB").parse().unwrap();
        assert!(scene.locked_kib() >= resident, "{} of {resident} KiB", scene.locked_kib());
    } else {
        assert!(said.iter().all(|w| w.contains("ulimit -l") && w.contains("CAP_IPC_LOCK")), "{said:?}");
    }
    scene.goes_on();
}

#[test]
fn under_a_finite_limit_the_stacks_of_all_threads_are_locked_and_the_state_says_so() {
    if !rights::may_lock(2 << 20) {
        return;
    }
    let scene = scene(Some(&[(libc::RLIMIT_MEMLOCK, 2 << 20)]));
    for path in ["host/p", "host/camera"] {
        let said = scene.warnings(path, "locked into memory");
        assert_eq!(said.len(), 1, "{said:?}");
        for words in ["the upper 128 KiB of each thread's stack", "limit is finite", "ulimit -l unlimited"] {
            assert!(said[0].contains(words), "{said:?}: {words}");
        }
    }
    let least = OF_A_STACK_KIB * THREADS.len() as u64;
    eventually(&format!("{least} KiB of stacks are locked"), || match scene.locked_kib() {
        locked if (least..=2048).contains(&locked) => Ok(()),
        locked => Err(format!("{locked} KiB")),
    });
    scene.goes_on();
}

#[test]
fn where_nothing_may_be_locked_the_state_says_so_and_the_component_steps_all_the_same() {
    let scene = scene(Some(&[(libc::RLIMIT_MEMLOCK, 0)]));
    assert_eq!(scene.locked_kib(), 0);
    for path in ["host/p", "host/camera"] {
        let said = scene.warnings(path, "its stack is not locked into memory");
        assert_eq!(said.len(), 1, "{}", scene.stats(path));
        assert!(said[0].contains("page faults may delay it") && said[0].contains("ulimit -l"), "{said:?}");
    }
    for helper in [1, 2] {
        let words = format!("helper thread {helper} is not locked");
        eventually(&words, || match scene.warnings("host/camera", &words).len() {
            1 => Ok(()),
            _ => Err(scene.stats("host/camera")),
        });
    }
    let frames = scene.grpc.component("host/camera").to_string();
    assert!(frames.contains("the frames of frame are not locked into memory"), "{frames}");
    scene.goes_on();
}
