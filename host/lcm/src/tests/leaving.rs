//! Leftovers: a refused or removed component keeps nothing; its threads end, and their jobs are dropped.

use std::sync::mpsc::{Sender, TryRecvError, channel};
use std::thread::JoinHandle;

use super::branches::frames;
use super::*;

struct Idle;

impl Behaviour for Idle {}

/// Names of this process's threads.
fn threads() -> Vec<String> {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap().flatten();
    let names = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("comm")).ok());
    names.map(|name| name.trim().to_owned()).collect()
}

fn component() -> Box<Component> {
    let info = class(Ports::default(), Safety::None);
    Box::new(Component {
        ports: Arc::new(info.ports.clone()),
        class: Arc::new(info),
        config: serde_json::json!({}),
        execution: periodic(1000),
        state: State::Created,
        health: Health::Ok,
        fault: String::new(),
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_that_could_not_be_created_leaves_no_thread_and_its_name_is_free() {
    let world = World::new("lv_refused");
    // No test has set its behaviour, so it is not made.
    let id = world.id("lv-ghost");
    for _ in 0..3 {
        let refused =
            world.apply(Change::Create { id: id.clone(), component: component() }).await.unwrap_err();
        assert!(matches!(refused, Refusal::ComponentRefused { entry: "create", .. }), "{refused:?}");
    }
    eventually("its threads have ended", || !threads().iter().any(|name| name == "lv-ghost")).await;
    world.create("lv-ghost", periodic(1000), Arc::new(Idle)).await;
    world.start("lv-ghost").await;
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn work_for_a_thread_that_has_ended_is_let_go_of_at_once() {
    let world = World::new("lv_ended");
    world.create("c", periodic(1000), Arc::new(Idle)).await;
    let instance = world.lcm.instance(&world.id("c")).unwrap();
    let executor = world.lcm.executor_of(&instance).unwrap();
    world.apply(Change::Destroy { id: world.id("c"), component: component() }).await.unwrap();
    let task = format!("/proc/self/task/{}", executor.tid());
    eventually("its thread has ended", || !std::path::Path::new(&task).exists()).await;
    let (tell, told) = channel::<()>();
    executor.submit(move |_| drop(tell));
    assert_eq!(told.try_recv(), Err(TryRecvError::Disconnected), "whoever asked would wait for ever");
    world.end().await;
}

/// A cycle of another thread, which goes on until it is told to end, or the test has failed.
pub(super) struct LongCycle {
    end: Sender<()>,
    thread: JoinHandle<()>,
}

impl LongCycle {
    /// Under way when this returns.
    pub(super) fn begin() -> Self {
        let (begun, began) = channel();
        let (end, ends) = channel::<()>();
        let thread = std::thread::spawn(move || {
            trocar_rt::turn::run(|| {
                begun.send(()).unwrap();
                let _ = ends.recv();
            });
        });
        began.recv().unwrap();
        Self { end, thread }
    }

    pub(super) fn end(self) {
        drop(self.end);
        self.thread.join().unwrap();
    }
}

/// The remains of a component are kept for long, but not the objects lent or owned by others: neither at once
/// nor later.
#[tokio::test(flavor = "multi_thread")]
async fn the_frame_memory_of_a_removed_component_is_freed_although_a_cycle_was_under_way() {
    let world = World::new("lv_pool");
    world.create_as("camera", class(frames(false, true), Safety::None), periodic(1000), Arc::new(Idle)).await;
    let instance = Arc::downgrade(&world.lcm.instance(&world.id("camera")).unwrap());
    let files = instance.upgrade().unwrap().described.now().slots.output(0).pool_files();
    let memory: Vec<_> = files.iter().map(Arc::downgrade).collect();
    assert_eq!(memory.len(), 1, "the pool of its output");
    drop(files);
    let cycle = LongCycle::begin();
    world.apply(Change::Destroy { id: world.id("camera"), component: component() }).await.unwrap();
    eventually("the component is dropped", || instance.strong_count() == 0).await;
    assert_eq!(memory[0].strong_count(), 1, "the cycle may still look at it");
    cycle.end();
    eventually("its frame memory is freed", || memory[0].strong_count() == 0).await;
    world.end().await;
}

/// A cycle that looked at a wire when it was cut holds the component behind it, and that component may hold
/// the first one: a circle that is never dropped once the follower has ended.
#[tokio::test(flavor = "multi_thread")]
async fn components_that_were_connected_to_each_other_are_gone_with_their_process_although_a_cycle_was_under_way()
 {
    let world = World::new("lv_circle");
    let ports = || Ports { required: requires_ctl().required, ..ctl() };
    for name in ["a", "b"] {
        world.create_as(name, class(ports(), Safety::None), periodic(1000), Arc::new(Idle)).await;
    }
    world.connect(1, "a/peer", "b/ctl", ConnectOptions::default()).await;
    world.connect(2, "b/peer", "a/ctl", ConnectOptions::default()).await;
    let kept = ["a", "b"].map(|name| Arc::downgrade(&world.lcm.instance(&world.id(name)).unwrap()));
    let (begun, began) = channel();
    let lcm = Arc::downgrade(&world.lcm);
    // Acts as a cycle of another thread: it begins before the cut and ends when cut wires are followed no
    // more.
    let cycle = std::thread::spawn(move || {
        trocar_rt::turn::run(|| {
            begun.send(()).unwrap();
            while lcm.upgrade().is_some_and(|lcm| lcm.is_followed()) {
                std::thread::yield_now();
            }
        });
    });
    began.recv().unwrap();
    world.end().await;
    cycle.join().unwrap();
    let left = || kept.iter().map(std::sync::Weak::strong_count).sum::<usize>();
    eventually("both are dropped", || left() == 0).await;
}
