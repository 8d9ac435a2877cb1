//! Meaning of the facts for a system, and what to do about them. Pure.
//!
//! Invariant: every finding that is not fine says what it costs and how to allow more.

use super::limits::Limit;
use super::probe::Facts;

/// Verdict of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Fine,
    /// Works, with less than there could be.
    Limited,
    /// Something a host needs does not work.
    Bad,
}

impl Verdict {
    pub fn word(self) -> &'static str {
        match self {
            Verdict::Fine => "ok",
            Verdict::Limited => "limited",
            Verdict::Bad => "bad",
        }
    }
}

/// One thing the machine allows, or does not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// One word: "priority", "memlock", …
    pub what: &'static str,
    pub verdict: Verdict,
    /// The observation, one line.
    pub found: String,
    /// Its cost; empty when fine.
    pub means: String,
    /// A way to allow more; empty when fine.
    pub allow: String,
}

/// Returns all findings, in the order a reader needs them.
pub fn judge(facts: &Facts) -> Vec<Finding> {
    vec![
        priority(facts),
        memlock(facts),
        kernel(facts),
        cpus(facts),
        clock(facts),
        wakes(facts),
        shm(facts),
        inotify(facts),
        files(facts),
        threads(facts),
    ]
}

fn fine(what: &'static str, found: String) -> Finding {
    Finding { what, verdict: Verdict::Fine, found, means: String::new(), allow: String::new() }
}

fn limited(what: &'static str, found: String, means: &str, allow: &str) -> Finding {
    Finding { what, verdict: Verdict::Limited, found, means: means.into(), allow: allow.into() }
}

fn bad(what: &'static str, found: String, means: &str, allow: &str) -> Finding {
    Finding { what, verdict: Verdict::Bad, found, means: means.into(), allow: allow.into() }
}

fn amount(limit: Option<Limit>, unit: impl Fn(u64) -> String) -> String {
    match limit.map(|l| l.soft) {
        None => "not told by the kernel".into(),
        Some(None) => "unlimited".into(),
        Some(Some(n)) => unit(n),
    }
}

fn priority(f: &Facts) -> Finding {
    match &f.fifo {
        Ok(()) if f.rt_runtime_us.is_some_and(|us| us >= 0) => fine(
            "priority",
            format!(
                "SCHED_FIFO granted; real-time threads may use {:.1} % of each second",
                f.rt_runtime_us.unwrap_or(0) as f64 / 1e4
            ),
        ),
        Ok(()) => fine("priority", "SCHED_FIFO granted".into()),
        Err(text) => limited(
            "priority",
            format!("SCHED_FIFO refused ({text}); limit {}", amount(f.limits.rt_priority, |n| n.to_string())),
            "components with a priority run with normal scheduling: any busy program makes them late",
            "put `@realtime - rtprio 95` into /etc/security/limits.d/realtime.conf, add the user to group realtime and log \
             in again; or `setcap cap_sys_nice+ep` on the executable, for which LD_LIBRARY_PATH does not count then: libraries of plugins \
             need their directory in /etc/ld.so.conf.d; for a service: LimitRTPRIO=95",
        ),
    }
}

fn memlock(f: &Facts) -> Finding {
    let limit = amount(f.limits.locked, |n| format!("{} KiB", n / 1024));
    if let Err(text) = &f.lock {
        return limited(
            "memlock",
            format!("locking memory refused ({text}); limit {limit}"),
            "a page that was swapped out makes a step late by milliseconds",
            "put `@realtime - memlock unlimited` into /etc/security/limits.d/realtime.conf; for a service: LimitMEMLOCK=infinity",
        );
    }
    match f.limits.locked {
        Some(Limit { soft: Some(_), .. }) if !f.may_lock_all => limited(
            "memlock",
            format!("up to {limit} may be locked"),
            "frame pools and the upper 128 KiB of each thread's stack are locked as far as that reaches; the rest of the \
             process is not",
            "put `@realtime - memlock unlimited` into /etc/security/limits.d/realtime.conf; for a service: LimitMEMLOCK=infinity",
        ),
        // Locking one page went well, so there is nothing to complain of; how far that reaches is not known.
        None if !f.may_lock_all => fine("memlock", format!("memory may be locked; limit {limit}")),
        _ => fine("memlock", "all memory may be locked".into()),
    }
}

fn kernel(f: &Facts) -> Finding {
    if f.preempt_rt {
        return fine("kernel", format!("{} with PREEMPT_RT", f.kernel));
    }
    limited(
        "kernel",
        format!("{} without PREEMPT_RT", f.kernel),
        "drivers and interrupts can hold a component back for a millisecond now and then",
        "install the distribution's real-time kernel (Debian: linux-image-rt-amd64) where deadlines are hard",
    )
}

fn cpus(f: &Facts) -> Finding {
    let isolated =
        if f.isolated.is_empty() { String::new() } else { format!(", {} kept free of others", f.isolated) };
    let governor = if f.governor.is_empty() { String::new() } else { format!(", governor {}", f.governor) };
    let found = format!("{} usable{isolated}{governor}", f.cpus);
    if f.cpus < 2 {
        return limited(
            "cpus",
            found,
            "everything shares one CPU: a component that computes long delays all others",
            "give the process a second CPU (see `taskset -p`, the service's AllowedCPUs=)",
        );
    }
    if f.governor == "powersave" {
        return limited(
            "cpus",
            found,
            "the CPU slows down between cycles and takes time to speed up",
            "`cpupower frequency-set -g performance`",
        );
    }
    fine("cpus", found)
}

fn clock(f: &Facts) -> Finding {
    let found = format!("{}, {:.0} ns a reading", f.clock_source, f.figures.clock_read_ns);
    if f.figures.clock_read_ns > 200.0 {
        return limited(
            "clock",
            found,
            "each reading is a system call; a step reads the clock about three times",
            "boot with clocksource=tsc (or tsc=reliable) where the machine's TSC is sound; see dmesg for why it was left",
        );
    }
    fine("clock", found)
}

fn wakes(f: &Facts) -> Finding {
    let us = |ns: u64| ns as f64 / 1e3;
    let fifo = if f.fifo.is_ok() { "SCHED_FIFO" } else { "normal scheduling" };
    let found = format!(
        "{:.0} µs late (median), {:.0} (99 %), {:.0} (worst of 400 at 1 kHz, {fifo})",
        us(f.figures.wake_p50_ns),
        us(f.figures.wake_p99_ns),
        us(f.figures.wake_max_ns)
    );
    if f.figures.wake_p99_ns > 500_000 {
        return limited(
            "wakes",
            found,
            "a 1 kHz component begins more than half a period late once in a hundred cycles",
            "stop what loads the machine, allow priorities, or use a real-time kernel; in a virtual machine pin its CPUs",
        );
    }
    fine("wakes", found)
}

fn shm(f: &Facts) -> Finding {
    match &f.shm {
        Ok(()) => fine("shm", "sealed shared memory (memfd) works".into()),
        Err(text) => bad(
            "shm",
            format!("a frame pool could not be made: {text}"),
            "no component can send frames",
            "allow memfd_create and file sealing (a container's seccomp profile, the service's MemoryDenyWriteExecute=)",
        ),
    }
}

fn inotify(f: &Facts) -> Finding {
    let limits = format!(
        "{} instances, {} watches per user",
        f.inotify_instances.map_or("?".into(), |n| n.to_string()),
        f.inotify_watches.map_or("?".into(), |n| n.to_string())
    );
    match &f.inotify {
        Ok(()) => fine("inotify", limits),
        Err(text) => limited(
            "inotify",
            format!("a directory could not be watched: {text}; {limits}"),
            "a dropped plugin is seen by the scan every 2 s, not at once",
            "`sysctl fs.inotify.max_user_instances=1024 fs.inotify.max_user_watches=524288`, or close programs that watch \
             many directories",
        ),
    }
}

fn files(f: &Facts) -> Finding {
    let found = format!("{} open files", amount(f.limits.files, |n| n.to_string()));
    match f.limits.files {
        Some(Limit { soft: Some(n), hard }) if n < 1024 => limited(
            "files",
            found,
            "each caller, connection between processes and frame pool takes one",
            match hard {
                Some(hard) if hard < 1024 => {
                    "raise the hard limit: `@realtime - nofile 65536` in /etc/security/limits.d"
                }
                _ => "`ulimit -n 4096` before the start; for a service: LimitNOFILE=65536",
            },
        ),
        _ => fine("files", found),
    }
}

fn threads(f: &Facts) -> Finding {
    let found = format!("{} processes and threads", amount(f.limits.threads, |n| n.to_string()));
    match f.limits.threads {
        Some(Limit { soft: Some(n), .. }) if n < 256 => limited(
            "threads",
            found,
            "each component with a thread of its own takes one",
            "`ulimit -u 4096` before the start; for a service: TasksMax=4096",
        ),
        _ => fine("threads", found),
    }
}

#[cfg(test)]
mod tests {
    use super::super::limits::Limits;
    use super::super::probe::Figures;
    use super::*;

    fn generous() -> Facts {
        let all = Some(Limit { soft: None, hard: None });
        Facts {
            limits: Limits { rt_priority: all, locked: all, files: all, threads: all },
            fifo: Ok(()),
            lock: Ok(()),
            cpus: 4,
            preempt_rt: true,
            inotify: Ok(()),
            shm: Ok(()),
            figures: Figures {
                clock_read_ns: 23.0,
                wake_p50_ns: 20_000,
                wake_p99_ns: 50_000,
                wake_max_ns: 90_000,
            },
            may_lock_all: false,
            isolated: String::new(),
            kernel: "6.1".into(),
            rt_runtime_us: Some(950_000),
            governor: "performance".into(),
            inotify_instances: Some(128),
            inotify_watches: Some(65_536),
            clock_source: "tsc".into(),
        }
    }

    fn only_complaint(facts: &Facts) -> Finding {
        let mut complaints: Vec<Finding> =
            judge(facts).into_iter().filter(|f| f.verdict != Verdict::Fine).collect();
        assert_eq!(complaints.len(), 1, "{complaints:?}");
        complaints.remove(0)
    }

    #[test]
    fn a_generous_machine_gets_no_complaint() {
        assert!(judge(&generous()).iter().all(|f| f.verdict == Verdict::Fine && f.allow.is_empty()));
    }

    #[test]
    fn each_limit_is_named_with_what_it_costs_and_how_to_allow_more() {
        let no = || Err("Operation not permitted".to_owned());
        let some = |n| Some(Limit { soft: Some(n), hard: Some(n) });
        let g = generous();
        let late = Figures { wake_p99_ns: 800_000, ..g.figures };
        let cases: [(&str, Facts); 12] = [
            ("priority", Facts { fifo: no(), ..g.clone() }),
            ("memlock", Facts { lock: no(), ..g.clone() }),
            ("memlock", Facts { limits: Limits { locked: some(8 << 20), ..g.limits }, ..g.clone() }),
            ("kernel", Facts { preempt_rt: false, ..g.clone() }),
            ("cpus", Facts { cpus: 1, ..g.clone() }),
            ("cpus", Facts { governor: "powersave".into(), ..g.clone() }),
            ("wakes", Facts { figures: late, ..g.clone() }),
            ("threads", Facts { limits: Limits { threads: some(100), ..g.limits }, ..g.clone() }),
            ("clock", Facts { figures: Figures { clock_read_ns: 900.0, ..g.figures }, ..g.clone() }),
            ("shm", Facts { shm: no(), ..g.clone() }),
            ("inotify", Facts { inotify: no(), ..g.clone() }),
            ("files", Facts { limits: Limits { files: some(256), ..g.limits }, ..g.clone() }),
        ];
        for (what, facts) in cases {
            let complaint = only_complaint(&facts);
            assert_eq!(complaint.what, what);
            assert!(!complaint.means.is_empty() && !complaint.allow.is_empty(), "{complaint:?}");
        }
    }

    #[test]
    fn an_untold_limit_is_no_promise() {
        let facts = Facts { limits: Limits { locked: None, ..generous().limits }, ..generous() };
        let found = |facts: &Facts| judge(facts).into_iter().find(|f| f.what == "memlock").unwrap();
        assert_eq!(found(&facts).found, "memory may be locked; limit not told by the kernel");
        assert_eq!(found(&generous()).found, "all memory may be locked");
        assert_eq!(found(&Facts { may_lock_all: true, ..facts }).found, "all memory may be locked");
    }

    #[test]
    fn a_directory_that_cannot_be_watched_names_both_limits() {
        let complaint = only_complaint(&Facts { inotify: Err("no space".into()), ..generous() });
        for limit in ["fs.inotify.max_user_instances=", "fs.inotify.max_user_watches="] {
            assert!(complaint.allow.contains(limit), "{complaint:?}");
        }
    }

    #[test]
    fn only_what_a_host_cannot_do_without_is_bad() {
        let facts = Facts { shm: Err("no".into()), fifo: Err("no".into()), ..generous() };
        let bad: Vec<&str> =
            judge(&facts).iter().filter(|f| f.verdict == Verdict::Bad).map(|f| f.what).collect();
        assert_eq!(bad, ["shm"]);
    }

    #[test]
    fn this_machine_is_probed_without_a_panic_and_every_finding_says_what_was_found() {
        let findings = judge(&super::super::probe());
        assert_eq!(findings.len(), 10);
        assert!(findings.iter().all(|f| !f.found.is_empty()), "{findings:?}");
    }
}
