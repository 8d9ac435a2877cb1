//! Threads of devices that call in: permitted actions inside, and the state they resume outside.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar_plugin_api::abi::{EXECUTED, NOT_ACTIVE};

use super::super::boundary::inside;
use super::super::boundary::puppet::{ArgRet, Own};
use super::super::context;
use super::*;

/// Hands its device out to the test; counts its commands.
#[derive(Default)]
struct Called {
    device: Mutex<Option<Own>>,
    commands: AtomicU64,
}

impl Behaviour for Called {
    fn command(&self, _: u32, _: ArgRet, own: &Own) -> Result<(), String> {
        *self.device.lock().unwrap() = Some(*own);
        self.commands.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

async fn device(world: &World, name: &str) -> Own {
    let called = Arc::new(Called::default());
    let execution = model(ExecutionModel::OnCallback);
    world.create_as(name, class(ctl(), Safety::None), execution, called.clone()).await;
    world.start(name).await;
    world.call(name).await.unwrap();
    called.device.lock().unwrap().unwrap()
}

/// Activity of this thread: the component whose code it runs, and whether it may not wait.
fn doing() -> (usize, bool) {
    (inside::component() as usize, context::stepping())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_callback_is_a_step_and_its_thread_goes_on_with_what_it_did_before() {
    let world = World::new("c_nested");
    let (outer, inner) = (device(&world, "outer").await, device(&world, "inner").await);
    let seen = std::thread::spawn(move || {
        let mut seen = vec![doing()];
        assert_eq!(outer.enter(), EXECUTED);
        seen.push(doing());
        assert_eq!(inner.enter(), EXECUTED);
        seen.push(doing());
        inner.leave();
        seen.push(doing());
        outer.leave();
        seen.push(doing());
        // One leave too many changes nothing.
        outer.leave();
        seen.push(doing());
        seen
    });
    let [before, in_outer, in_inner, in_outer_again, after, still] = seen.join().unwrap()[..] else {
        panic!("not six looks");
    };
    assert_eq!(before, (0, false));
    assert!(in_outer.1 && in_outer.0 != 0, "inside: {in_outer:?}");
    assert!(in_inner.1 && in_inner.0 != in_outer.0, "inside of the other: {in_inner:?}");
    assert_eq!(in_outer_again, in_outer);
    assert_eq!((after, still), (before, before));
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn callbacks_that_are_left_in_the_order_they_were_entered_leave_nothing_behind() {
    let world = World::new("c_crossed");
    let (first, second) = (device(&world, "first").await, device(&world, "second").await);
    let seen = std::thread::spawn(move || {
        assert_eq!((first.enter(), second.enter()), (EXECUTED, EXECUTED));
        first.leave();
        second.leave();
        doing()
    });
    assert_eq!(seen.join().unwrap(), (0, false));
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_is_woken_out_of_a_callback_wakes_when_it_ends() {
    let world = World::new("c_wakes");
    let calls = device(&world, "device").await;
    let woken = Arc::new(Called::default());
    let info = class(ctl(), Safety::None);
    world.create_as("woken", info, model(ExecutionModel::OnSignal), woken.clone()).await;
    world.start("woken").await;
    let instance = world.lcm.instance(&world.id("woken")).unwrap();
    let device = std::thread::spawn(move || {
        assert_eq!(calls.enter(), EXECUTED);
        instance.signal();
        let noted = context::has_wakes();
        calls.leave();
        (noted, context::has_wakes())
    });
    assert_eq!(device.join().unwrap(), (true, false), "noted inside, issued on leaving");
    world.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_is_turned_away_goes_on_as_before() {
    let world = World::new("c_away");
    let calls = device(&world, "device").await;
    world.run("device", Verb::Stop).await.unwrap();
    let device = std::thread::spawn(move || (calls.enter(), doing()));
    assert_eq!(device.join().unwrap(), (NOT_ACTIVE, (0, false)));
    world.end().await;
}
