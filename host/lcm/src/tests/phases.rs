//! The components of a process step at their given phases; a phase that was asked for stays.

use std::sync::Mutex;

use trocar_model::Phase;
use trocar_plugin_api::abi::Tick;

use super::super::boundary::puppet::Own;
use super::*;

const PERIOD_NS: u64 = 2_000_000;

/// Notes the number and the deadline of each cycle.
#[derive(Default)]
struct Beating(Mutex<Vec<(u64, u64)>>);

impl Behaviour for Beating {
    fn step(&self, tick: &Tick, _: &Own) -> Result<(), String> {
        self.0.lock().unwrap().push((tick.cycle, tick.deadline_ns));
        Ok(())
    }
}

impl Beating {
    /// Time from a multiple of the period to the newest deadline, ns.
    fn phase(&self) -> Option<u64> {
        self.0.lock().unwrap().last().map(|(_, deadline_ns)| deadline_ns % PERIOD_NS)
    }
}

impl World {
    async fn give(&self, name: &str, phase_ns: u64) {
        let phase = Phase { phase_ns, note: "it is tight".into() };
        let given = vec![(self.id(name), phase)];
        self.lcm.phases(Some(given), Instant::now() + PATIENCE).await.unwrap();
    }

    async fn phase(&self, name: &str) -> (Option<u64>, bool) {
        let detail = self.detail(name).await;
        (detail.phase_ns, detail.phase_auto)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_phase_that_changes_while_it_runs_leaves_out_and_doubles_no_cycle() {
    let (world, beating) = (World::new("p_moving"), Arc::new(Beating::default()));
    world.create("a", periodic(PERIOD_NS / 1_000), beating.clone()).await;
    world.start("a").await;
    for phase_ns in [0, 1_500_000, 250_000] {
        world.give("a", phase_ns).await;
        eventually(&format!("it steps at {phase_ns} ns"), || beating.phase() == Some(phase_ns)).await;
        assert_eq!(world.phase("a").await, (Some(phase_ns), true));
    }
    world.run("a", Verb::Stop).await.unwrap();
    let cycles = beating.0.lock().unwrap().clone();
    let (_, first_ns) = cycles[0];
    for (number, deadline_ns) in cycles {
        let elapsed = deadline_ns / PERIOD_NS - first_ns / PERIOD_NS;
        assert_eq!(number, elapsed, "executed and skipped are the elapsed periods, at {deadline_ns} ns");
    }
    let warnings = world.detail("a").await.warnings;
    assert!(warnings.contains(&"phase: it is tight".to_owned()), "{warnings:?}");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_phase_that_was_asked_for_is_kept_and_without_a_grid_there_is_none() {
    let world = World::new("p_kept");
    let asked = Execution { phase_ns: Some(300_000), ..periodic(2_000) };
    world.create("asked", asked, Arc::new(Beating::default())).await;
    world
        .create("other", inside(ExecutionModel::ExecIn, &world.id("asked")), Arc::new(Beating::default()))
        .await;
    for name in ["asked", "other"] {
        world.give(name, 900_000).await;
    }
    assert_eq!(world.phase("asked").await, (Some(300_000), false));
    assert_eq!(world.phase("other").await, (None, false));
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_made_anew_steps_where_it_was_given() {
    let world = World::new("p_anew");
    world.give("a", 700_000).await;
    world.create("a", periodic(2_000), Arc::new(Beating::default())).await;
    assert_eq!(world.phase("a").await, (Some(700_000), true));
    world.lcm.phases(Some(Vec::new()), Instant::now() + PATIENCE).await.unwrap();
    assert_eq!(world.phase("a").await, (Some(0), true), "one that is left out steps at 0");
    world.end().await;
}
