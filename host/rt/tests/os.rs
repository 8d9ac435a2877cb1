//! The system calls do what they say, and their refusals say what to do.
#![allow(clippy::unwrap_used)]

use std::sync::atomic::AtomicU32;

use trocar_rt::os::{self, Scope, WaitResult};

#[test]
fn the_clock_never_goes_back_and_sleeping_reaches_its_deadline() {
    let start = os::now_ns();
    os::sleep_until(start + 1_000_000);
    assert!(os::now_ns() >= start + 1_000_000);
    os::sleep_until(0);
}

#[test]
fn a_futex_wait_tells_change_and_time_apart() {
    let word = AtomicU32::new(1);
    assert_eq!(os::futex_wait(&word, 2, None, Scope::Process), WaitResult::Changed);
    assert_eq!(
        os::futex_wait(&word, 1, Some(os::now_ns() + 1_000_000), Scope::Machine),
        WaitResult::TimedOut
    );
    os::futex_wake(&word, 1, Scope::Process);
}

/// A line of what the kernel tells of the calling thread.
fn own(name: &str) -> String {
    let status = std::fs::read_to_string("/proc/thread-self/status").unwrap();
    status.lines().find_map(|l| l.strip_prefix(name)).unwrap().trim().to_owned()
}

/// Policy and priority of the calling thread, as the kernel has them.
fn scheduling() -> (i32, i32) {
    let mut param = libc::sched_param { sched_priority: -1 };
    // SAFETY: 0 is the calling thread, and `param` is a valid place for the answer.
    assert_eq!(unsafe { libc::sched_getparam(0, &mut param) }, 0);
    // SAFETY: it asks for a number; 0 is the calling thread.
    (unsafe { libc::sched_getscheduler(0) }, param.sched_priority)
}

#[test]
fn settings_of_a_thread_are_taken_or_refused_with_help() {
    let thread = std::thread::spawn(|| {
        os::set_thread_name("name-of-a-thread-that-is-long");
        os::set_timer_slack_ns(1).unwrap();
        let name = std::fs::read_to_string("/proc/thread-self/comm").unwrap();
        assert_eq!(name.trim_end(), "name-of-a-threa");
        let before = scheduling();
        match os::set_fifo(10) {
            Ok(()) => assert_eq!(scheduling(), (libc::SCHED_FIFO, 10), "granted"),
            Err(e) => {
                let said = e.to_string();
                assert!(said.contains("SCHED_FIFO priority 10") && said.contains("CAP_SYS_NICE"), "{said}");
                assert_eq!(scheduling(), before, "refused");
            }
        }
        let stands = scheduling();
        let none = os::set_fifo(100).expect_err("there is no priority 100").to_string();
        assert!(none.ends_with("use a priority from 1 to 99"), "{none}");
        assert_eq!(scheduling(), stands, "a refusal changes nothing");
        let cpu: usize = own("Cpus_allowed_list:").split(['-', ',']).next().unwrap().parse().unwrap();
        os::set_affinity(&[cpu]).unwrap();
        assert_eq!(own("Cpus_allowed_list:"), cpu.to_string());
    });
    thread.join().unwrap();
    for cpus in [&[][..], &[100_000], &[1_000]] {
        let e = os::set_affinity(cpus).unwrap_err();
        assert!(e.to_string().contains(&format!("{cpus:?}")), "{e}");
    }
}

#[test]
fn locking_memory_is_refused_where_it_would_break_later_threads() {
    let locked_kib = || own("VmLck:").trim_end_matches(" kB").parse::<u64>().unwrap();
    let before = locked_kib();
    match os::lock_memory() {
        Ok(()) => assert!(locked_kib() > before, "{} KiB before, {} after", before, locked_kib()),
        Err(e) => {
            assert!(e.to_string().contains("lock all memory"), "{e}");
            assert_eq!(locked_kib(), before, "refused");
        }
    }
    // Threads can still be made and memory mapped, whatever the answer was.
    std::thread::spawn(|| vec![1u8; 16 << 20].len()).join().unwrap();
}

#[test]
fn a_thread_that_sleeps_is_told_from_one_that_runs() {
    let (tell, told) = std::sync::mpsc::channel();
    let (wake, woken) = std::sync::mpsc::channel::<()>();
    let stop = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
    let end = stop.clone();
    let thread = std::thread::spawn(move || {
        // SAFETY: it asks for a number and has no conditions.
        tell.send(unsafe { libc::gettid() }).unwrap();
        woken.recv().unwrap();
        while !end.load(std::sync::atomic::Ordering::Relaxed) {}
    });
    let tid = told.recv().unwrap();
    while os::is_ready(tid) {
        std::thread::yield_now();
    }
    let slept_at = os::thread_ran_ns(tid).expect("it is there");
    assert_eq!(os::thread_ran_ns(tid), Some(slept_at), "who sleeps does not run");
    wake.send(()).unwrap();
    while os::thread_ran_ns(tid).is_some_and(|ran| ran < slept_at + 1_000_000) {
        std::thread::yield_now();
    }
    assert!(os::is_ready(tid), "it runs, or waits for a processor");
    stop.store(true, std::sync::atomic::Ordering::Relaxed);
    thread.join().unwrap();
    assert_eq!(os::thread_ran_ns(i32::MAX - 1), None, "nobody has this number");
}
