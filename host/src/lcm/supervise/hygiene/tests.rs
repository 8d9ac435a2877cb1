//! A thread whose signal mask was changed while it hangs is given one job for it, not one with every look.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use trocar_model::{Change, Component, ComponentId, Execution, Health, Name, Ports, Safety, State};
use trocar_rt::os;

use super::super::Ward;
use super::{blocked, mask};
use crate::lcm::boundary::fake::{Behaviour, FakeClasses, behave, class};
use crate::lcm::{Lcm, LcmConfig, LocalLcm};

const PATIENCE: Duration = Duration::from_secs(120);

struct Idle;

impl Behaviour for Idle {}

#[tokio::test(flavor = "multi_thread")]
async fn a_hung_thread_with_another_signal_mask_has_one_job_waiting_for_it_and_gets_its_own_back() {
    let config = LcmConfig {
        process: Name::parse("hy_mask").unwrap(),
        classes: Some(Arc::new(FakeClasses)),
        links: None,
        lock_memory: false,
    };
    let lcm = LocalLcm::new(config).unwrap();
    let id = ComponentId::parse("hy_mask/c").unwrap();
    behave(&id.to_string(), Arc::new(Idle));
    let info = class(Ports::default(), Safety::None);
    let component = Box::new(Component {
        ports: Arc::new(info.ports.clone()),
        class: Arc::new(info),
        config: serde_json::json!({}),
        execution: Execution::default(),
        state: State::Created,
        health: Health::Ok,
        fault: String::new(),
    });
    lcm.apply(Change::Create { id: id.clone(), component }, Instant::now() + PATIENCE).await.unwrap();
    let instance = lcm.instance(&id).unwrap();
    let executor = lcm.executor_of(&instance).unwrap();
    let ward = Ward::new(instance, executor.clone());
    let own = executor.settings.hygiene().unwrap().sigmask;
    // Twice: what was asked for once and done can be asked for again.
    for _ in 0..2 {
        let (tell, told) = channel();
        let (go, wait) = channel::<()>();
        executor.submit(move |_| {
            os::set_sigmask(own ^ 1 << 11);
            tell.send(()).unwrap();
            // The test lets go, or has ended.
            let _ = wait.recv();
        });
        told.recv().unwrap();
        // The watchdog looks as well, whenever it comes to it.
        (0..100).for_each(|_| _ = mask(&ward, &[&ward]));
        assert_eq!(executor.waiting(), 1, "every look has left a job");
        go.send(()).unwrap();
        let until = Instant::now() + PATIENCE;
        while executor.waiting() > 0 || blocked(executor.tid()) != Some(own) {
            assert!(Instant::now() < until, "{:?} instead of {own:#x}", blocked(executor.tid()));
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }
    lcm.shutdown(PATIENCE).await;
}
