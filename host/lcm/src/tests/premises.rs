//! Components that change the working directory or the umask, in processes of their own: both belong to the
//! whole process.

use std::env;
use std::process::Command as Process;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

use trocar_plugin_api::abi::Tick;

use super::super::boundary::puppet::{ArgRet, Own, set_umask};
use super::*;

/// Marks the process made for the test.
const CHILD: &str = "TROCAR_PREMISES_CHILD";

/// Changes the working directory in the given entry.
struct Strays(&'static str);

impl Strays {
    fn strike(&self, entry: &str) -> Result<(), String> {
        if self.0 == entry { env::set_current_dir("/").map_err(|e| e.to_string()) } else { Ok(()) }
    }
}

impl Behaviour for Strays {
    fn start(&self) -> Result<(), String> {
        self.strike("start")
    }
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        self.strike("command")
    }
}

/// Closes new files to everybody but their owner, in the given entry.
struct Closes(&'static str);

impl Closes {
    fn strike(&self, entry: &str) -> Result<(), String> {
        if self.0 == entry {
            set_umask(0o077);
        }
        Ok(())
    }
}

impl Behaviour for Closes {
    fn start(&self) -> Result<(), String> {
        self.strike("start")
    }
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        self.strike("command")
    }
}

fn umask() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    status.lines().find_map(|l| l.strip_prefix("Umask:")).unwrap().trim().to_string()
}

/// Counts its steps.
#[derive(Default)]
struct Settled(AtomicU64);

impl Behaviour for Settled {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.0.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

/// Changes the directory in `start` and stays inside until the other component has stepped so often that the
/// watchdog has looked.
struct Lingers(Arc<Settled>);

impl Behaviour for Lingers {
    fn start(&self) -> Result<(), String> {
        env::set_current_dir("/").map_err(|e| e.to_string())?;
        let until = self.0.0.load(Ordering::SeqCst) + 200;
        while self.0.0.load(Ordering::SeqCst) < until {
            std::thread::yield_now();
        }
        Ok(())
    }
}

/// Changes the directory in `start` and tells the test; returns when the test lets go.
struct Hangs(Mutex<(Sender<()>, Receiver<()>)>);

impl Behaviour for Hangs {
    fn start(&self) -> Result<(), String> {
        env::set_current_dir("/").map_err(|e| e.to_string())?;
        let door = self.0.lock().unwrap();
        let _ = door.0.send(());
        // The test lets go, or has ended.
        let _ = door.1.recv();
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_process_whose_directory_is_changed() {
    if env::var_os(CHILD).is_none() {
        return;
    }
    let home = env::current_dir().unwrap();
    let world = World::new("p_dir");
    let settled = Arc::new(Settled::default());
    world.create("settled", periodic(1000), settled.clone()).await;
    world.start("settled").await;
    let info = || class(plain(false, false), Safety::None);
    let signalled = || model(ExecutionModel::OnSignal);
    world.create_as("lingers", info(), signalled(), Arc::new(Lingers(settled))).await;
    world.start("lingers").await;
    assert!(env::current_dir().is_ok_and(|now| now == home), "put back when its start has ended");
    let own = "start: it changed the working directory of the process, which was put back";
    assert_eq!(world.report("lingers").await.warnings, [own], "while it is inside, it is its own finding");
    let ((inside, came), (open, door)) = (channel(), channel());
    world.create_as("hangs", info(), signalled(), Arc::new(Hangs(Mutex::new((inside, door))))).await;
    tokio::join!(world.start("hangs"), async {
        eventually("it is inside", || came.try_recv().is_ok()).await;
        let others = "the working directory of the process was changed, which was put back";
        let named = |r: &Report| r.warnings.iter().any(|w| w == others);
        world.eventually("naming who hangs elsewhere", "hangs", named).await;
        assert!(env::current_dir().is_ok_and(|now| now == home), "put back while it hangs");
        drop(open);
    });
    for entry in ["start", "command"] {
        let info = class(ctl(), Safety::None);
        world.create_as(entry, info, model(ExecutionModel::OnSignal), Arc::new(Strays(entry))).await;
        world.start(entry).await;
        world.call(entry).await.unwrap();
        let named = |r: &Report| r.warnings.iter().any(|w| w.contains("the working directory"));
        world.eventually("naming who changed the directory", entry, named).await;
        eventually("the directory is put back", || env::current_dir().is_ok_and(|now| now == home)).await;
    }
    assert_eq!(world.report("settled").await.warnings, Vec::<String>::new());
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_process_whose_umask_is_changed() {
    if env::var_os(CHILD).is_none() {
        return;
    }
    set_umask(0o022);
    // A program that embeds a host does what it likes with itself.
    let world = World::new("p_theirs");
    let info = class(ctl(), Safety::None);
    world.create_as("theirs", info, model(ExecutionModel::OnSignal), Arc::new(Closes("start"))).await;
    world.start("theirs").await;
    assert_eq!((umask().as_str(), world.report("theirs").await.warnings), ("0077", Vec::new()));
    world.end().await;
    set_umask(0o022);
    crate::own_process();
    for (entry, says) in [("start", "start: it changed the umask"), ("command", "it changed the umask")] {
        let world = World::new("p_mask");
        let info = class(ctl(), Safety::None);
        world.create_as(entry, info, model(ExecutionModel::OnSignal), Arc::new(Closes(entry))).await;
        world.start(entry).await;
        world.call(entry).await.unwrap();
        let whole = format!("{says} of the process to 077, which was put back to 022");
        world.eventually("naming who changed the umask", entry, |r| r.warnings.contains(&whole)).await;
        eventually("the umask is put back", || umask() == "0022").await;
        world.end().await;
    }
}

#[test]
fn whoever_changes_the_working_directory_is_named_and_it_is_put_back() {
    alone("the_process_whose_directory_is_changed");
}

#[test]
fn whoever_changes_the_umask_is_named_and_it_is_put_back() {
    alone("the_process_whose_umask_is_changed");
}

/// Runs one of these tests in a process of its own.
fn alone(test: &str) {
    let child = Process::new(env::current_exe().unwrap())
        .args(["--exact", &format!("tests::premises::{test}"), "--nocapture"])
        .env(CHILD, "1")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&child.stdout).into_owned() + &String::from_utf8_lossy(&child.stderr);
    assert!(child.status.success() && said.contains("1 passed"), "{said}");
}
