//! Bells that other processes ring for the components of a thread.

use std::sync::atomic::{AtomicU64, Ordering};

use trocar_plugin_api::abi::Tick;
use trocar_rt::region::{Layout, Region};
use trocar_rt::wake::{MOST_BELLS, Waker};

use super::super::boundary::puppet::Own;
use super::super::executor::Executor;
use super::super::realtime::Memory;
use super::*;

struct Counter(AtomicU64);

impl Behaviour for Counter {
    fn step(&self, _: &Tick, _: &Own) -> Result<(), String> {
        self.0.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

/// A bell as two processes share it.
fn bell() -> Arc<Waker> {
    let region = Region::shared(Layout::measure(Waker::lay_out)).unwrap();
    Arc::new(Waker::lay_out(&mut Layout::fresh(&region)))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_thread_hears_as_many_bells_as_the_kernel_lets_it_and_refuses_one_more_with_a_sentence() {
    let (world, counter) = (World::new("x_bells"), Arc::new(Counter(AtomicU64::new(0))));
    world.create("woken", model(ExecutionModel::OnSignal), counter.clone()).await;
    world.start("woken").await;
    let instance = world.lcm.instance(&world.id("woken")).unwrap();
    let ears = Executor::spawn("ears", &model(ExecutionModel::OnSignal), &Memory::Loose, |_, _| ()).unwrap();
    let bells: Vec<_> = (0..MOST_BELLS).map(|_| bell()).collect();
    for bell in &bells {
        ears.add_bell(bell.clone(), instance.core.clone()).unwrap();
    }
    let why = ears.add_bell(bell(), instance.core.clone()).unwrap_err();
    assert!(why.contains("x_bells/woken's thread is woken by 127 connections"), "{why}");
    for (rung, bell) in [&bells[0], &bells[63], &bells[126]].into_iter().enumerate() {
        bell.notify();
        eventually("a step for the bell", || counter.0.load(Ordering::SeqCst) > rung as u64).await;
    }
    // Removing a bell makes room for another.
    ears.remove_bell(bells[5].clone());
    let late = bell();
    ears.add_bell(late.clone(), instance.core.clone()).unwrap();
    let before = counter.0.load(Ordering::SeqCst);
    late.notify();
    eventually("a step for the late one", || counter.0.load(Ordering::SeqCst) > before).await;
    ears.close();
    world.end().await;
}
