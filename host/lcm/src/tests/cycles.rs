//! One cycle: the counts of a component that leaves ACTIVE in the middle of it.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use trocar_plugin_api::abi::Tick;
use trocar_rt::executor::Cycle;

use super::super::boundary::puppet::{ArgRet, Own};
use super::super::cycle::{self, Follow, Member};
use super::super::{context, instance::Instance};
use super::filters::counted;
use super::*;

type Act = Box<dyn FnMut() + Send>;

/// Counts its steps, and acts in its step, or in its command, as the test wants.
#[derive(Default)]
struct Acting {
    act: Mutex<Option<Act>>,
    in_command: bool,
    steps: AtomicU64,
}

impl Acting {
    fn act(&self) {
        if let Some(act) = &mut *self.act.lock().unwrap() {
            act();
        }
    }
}

impl Behaviour for Acting {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.steps.fetch_add(1, Ordering::SeqCst);
        if !self.in_command {
            self.act();
        }
        Ok(())
    }

    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        self.act();
        Ok(())
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cycle_in_which_it_was_stopped_before_its_step_is_not_counted_as_executed() {
    let world = World::new("f_stopped");
    // Its own cycles are an hour apart: those below are the test's.
    let hour = Execution { period_ns: Some(3_600_000_000_000), ..model(ExecutionModel::Stream) };
    let (before, served) =
        (Arc::new(Acting::default()), Arc::new(Acting { in_command: true, ..Acting::default() }));
    world.create_as("head", class(ctl(), Safety::None), hour, served.clone()).await;
    world.create("before", inside(ExecutionModel::ExecIn, &world.id("head")), before.clone()).await;
    for name in ["before", "head"] {
        world.start(name).await;
    }
    let of = |name: &str| world.lcm.instance(&world.id(name)).unwrap();
    let (head, member) = (of("head"), of("before"));
    let comes_to = |instance: &Arc<Instance>, state: State| -> Option<Act> {
        let instance = instance.clone();
        Some(Box::new(move || instance.set_state(state, "")))
    };
    // On a thread that counts as its own, so that a command sent to it wakes no other thread.
    let runtime = tokio::runtime::Handle::current();
    let run = |sent: bool| {
        let one = || {
            context::set_executor(head.executor_id());
            if sent {
                // A thread is inside: the command waits in the queue.
                let somebody = head.object.try_enter().unwrap();
                runtime.block_on(world.send("head"));
                drop(somebody);
            }
            let mut members = [
                Member::new(member.clone(), Follow::Member(head.number)),
                Member::new(head.clone(), Follow::Thread),
            ];
            let now_ns = trocar_rt::os::now_ns();
            let cycle = Cycle { begin_ns: now_ns, deadline_ns: now_ns, period_ns: 1_000_000_000, skipped: 3 };
            cycle::all(&mut members, &cycle);
        };
        thread::scope(|scope| scope.spawn(one).join().unwrap());
    };

    run(false);
    assert_eq!((counted(&head), counted(&member)), ((1, 0), (1, 0)), "a cycle as any");

    // The inner component steps first, and the head is stopped meanwhile: this cycle does not count for it.
    *before.act.lock().unwrap() = comes_to(&head, State::Ready);
    run(false);
    assert_eq!(served.steps.load(Ordering::SeqCst), 1, "it does not step when it was stopped");
    assert_eq!(counted(&head), (1, 0), "neither executed nor left out");
    assert_eq!(counted(&member), (2, 3), "who stepped is counted");

    // The head fails in its queued command, right before its step.
    *before.act.lock().unwrap() = None;
    *served.act.lock().unwrap() = comes_to(&head, State::Fault);
    head.set_state(State::Active, "");
    run(true);
    assert_eq!(served.steps.load(Ordering::SeqCst), 1, "it does not step when it has failed");
    assert_eq!(counted(&head), (1, 4), "its cycle had begun: left out");
    world.end().await;
}
