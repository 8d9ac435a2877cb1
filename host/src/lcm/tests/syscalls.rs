//! Ten thousand steps of every execution model in which the thread that steps calls nothing of the system but its own sleep
//! and wake: anything else ends the process they run in.

use std::process::Command as Process;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar_plugin_api::abi::{EXECUTED, Tick};

use super::super::boundary::fake::{Device, Own};
use super::super::boundary::trap;
use super::*;

/// Steps in the trap.
const STEPS: u64 = 10_000;
/// Steps before it is set, in which first uses may call the system.
const WARM: u64 = 100;
/// Says which model the child process is to run.
const MODEL: &str = "TROCAR_TRAP_MODEL";
/// Exit code of a child whose kernel has no such trap.
const NO_TRAP: i32 = 250;

/// Sets the trap in its thread and steps on in it.
#[derive(Default)]
struct Trapped {
    steps: AtomicU64,
    device: Mutex<Option<Device>>,
}

impl Trapped {
    fn count(&self) {
        let n = self.steps.load(Ordering::Relaxed) + 1;
        if n == WARM && !trap::set() {
            std::process::exit(NO_TRAP);
        }
        self.steps.store(n, Ordering::Release);
    }
}

impl Behaviour for Trapped {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        self.count();
        if own.has_output() {
            own.write(0, &tick.cycle);
        }
        Ok(())
    }

    fn command(&self, _: u32, own: &Own) -> Result<(), String> {
        *self.device.lock().unwrap() = Some(own.device());
        Ok(())
    }
}

/// Does nothing.
struct Idle;

impl Behaviour for Idle {}

/// The child process: ends itself when its steps are done.
#[tokio::test(flavor = "multi_thread")]
async fn the_process_in_which_the_trap_is_set() {
    let Ok(name) = std::env::var(MODEL) else { return };
    let world = World::new("t_trap");
    let trapped = Arc::new(Trapped::default());
    let input = || class(plain(true, false), Safety::None);
    let output = || class(plain(false, true), Safety::None);
    let link = ConnectOptions::default;
    match name.as_str() {
        "periodic, exec_in and exec_out" => {
            world.create("head", periodic(20), trapped.clone()).await;
            for (name, how) in [("before", ExecutionModel::ExecIn), ("after", ExecutionModel::ExecOut)] {
                world.create(name, inside(how, &world.id("head")), Arc::new(Idle)).await;
                world.start(name).await;
            }
            world.start("head").await;
        }
        "continuous" => {
            world.create_as("head", output(), model(ExecutionModel::Continuous), trapped.clone()).await;
            world.create_as("woken", input(), model(ExecutionModel::OnSignal), Arc::new(Idle)).await;
            world.connect(1, "woken/in", "head/out", link()).await;
            world.start("woken").await;
            world.start("head").await;
        }
        "on_signal" => {
            let free = Arc::new(Writes);
            world.create_as("head", output(), model(ExecutionModel::Continuous), free).await;
            world.create_as("woken", input(), model(ExecutionModel::OnSignal), trapped.clone()).await;
            world.connect(1, "woken/in", "head/out", link()).await;
            world.start("woken").await;
            world.start("head").await;
        }
        "stream" => {
            let head = Execution { period_ns: Some(20_000), ..model(ExecutionModel::Stream) };
            world.create_as("head", output(), head, Arc::new(Writes)).await;
            world.create_as("filter", input(), stream_of(&world.id("head")), trapped.clone()).await;
            world.connect(1, "filter/in", "head/out", link()).await;
            world.start("filter").await;
            world.start("head").await;
        }
        "on_callback" => {
            let info = class(ctl(), Safety::None);
            world.create_as("device", info, model(ExecutionModel::OnCallback), trapped.clone()).await;
            world.start("device").await;
            world.call("device").await.unwrap();
            let device = trapped.device.lock().unwrap().unwrap();
            let called = trapped.clone();
            std::thread::spawn(move || {
                for _ in 0..WARM + STEPS {
                    while device.enter() != EXECUTED {
                        std::hint::spin_loop();
                    }
                    called.count();
                    device.leave();
                }
                // Its end would call the system.
                loop {
                    std::thread::park();
                }
            });
        }
        other => panic!("no model {other}"),
    }
    eventually("all steps", || trapped.steps.load(Ordering::Acquire) >= WARM + STEPS).await;
    // The thread cannot leave the trap: the process ends here.
    std::process::exit(0);
}

/// Writes its output at each step.
struct Writes;

impl Behaviour for Writes {
    fn step(&self, tick: &Tick, own: &Own) -> Result<(), String> {
        own.write(0, &tick.cycle);
        Ok(())
    }
}

#[test]
fn a_stepping_thread_calls_nothing_of_the_system_but_its_own_sleep_and_wake() {
    for name in ["periodic, exec_in and exec_out", "continuous", "on_signal", "stream", "on_callback"] {
        let child = Process::new(std::env::current_exe().unwrap())
            .args(["--exact", "lcm::tests::syscalls::the_process_in_which_the_trap_is_set", "--nocapture"])
            .env(MODEL, name)
            .output()
            .unwrap();
        match child.status.code() {
            Some(0) => {}
            Some(NO_TRAP) => println!("{name}: this kernel lets no thread be trapped; not looked at"),
            Some(101) => panic!("{name}: {}", String::from_utf8_lossy(&child.stderr)),
            Some(call) => panic!("{name}: system call number {call} in a step"),
            None => panic!("{name}: ended by {}", child.status),
        }
    }
}
