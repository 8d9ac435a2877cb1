//! A component that changes the working directory, in a process of its own: the directory is everybody's.

use std::env;
use std::process::Command as Process;

use super::super::boundary::fake::Own;
use super::*;

/// Says that this is the process made for it.
const CHILD: &str = "TROCAR_PREMISES_CHILD";

/// Goes elsewhere in the entry it is told to.
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
    fn command(&self, _: u32, _: &Own) -> Result<(), String> {
        self.strike("command")
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_process_whose_directory_is_changed() {
    if env::var_os(CHILD).is_none() {
        return;
    }
    let home = env::current_dir().unwrap();
    let world = World::new("p_dir");
    world.create("settled", periodic(1000), Arc::new(Strays(""))).await;
    world.start("settled").await;
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

#[test]
fn whoever_changes_the_working_directory_is_named_and_it_is_put_back() {
    let child = Process::new(env::current_exe().unwrap())
        .args(["--exact", "lcm::tests::premises::the_process_whose_directory_is_changed", "--nocapture"])
        .env(CHILD, "1")
        .output()
        .unwrap();
    assert!(child.status.success(), "{}", String::from_utf8_lossy(&child.stderr));
}
