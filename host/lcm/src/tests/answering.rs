//! State of a component that a caller finds right after its answer.
//!
//! Promise: no caller is told of a failure before the state shows it.

use super::super::boundary::puppet::{ArgRet, Own};
use super::*;

/// Panics in the entry of this name.
struct Panics(&'static str);

impl Panics {
    fn pass(&self, entry: &str) -> Result<(), String> {
        if self.0 == entry {
            // Without the output of the panic hook, hundreds of times.
            std::panic::resume_unwind(Box::new("chaos"));
        }
        Ok(())
    }
}

impl Behaviour for Panics {
    fn start(&self) -> Result<(), String> {
        self.pass("start")
    }
    fn stop(&self) -> Result<(), String> {
        self.pass("stop")
    }
    fn resume(&self) -> Result<(), String> {
        self.pass("resume")
    }
    fn command(&self, _: u32, _: ArgRet, _: &Own) -> Result<(), String> {
        self.pass("command")
    }
}

/// State of the component as other components see it.
async fn get_state(world: &World, name: &str) -> serde_json::Value {
    let member = MemberId::parse(&format!("{}/{name}/system/GetState", world.process)).unwrap();
    let call = Invoke { member, arg: Payload::None, send: false, deadline_ns: 0 };
    world.lcm.invoke(call).await.unwrap().value.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_is_told_of_a_panic_finds_the_component_in_fault() {
    let world = World::new("a_fault");
    let threads = [periodic(1000), model(ExecutionModel::OnSignal), model(ExecutionModel::None)];
    for (number, execution) in threads.iter().enumerate() {
        for entry in ["start", "stop", "resume", "command"] {
            let name = format!("{entry}{number}");
            let info = class(ctl(), Safety::None);
            world.create_as(&name, info, execution.clone(), Arc::new(Panics(entry))).await;
            for round in 0..100 {
                let started = world.run(&name, Verb::Start).await;
                if entry != "start" {
                    started.unwrap();
                }
                match entry {
                    "command" => {
                        let refused = world.call(&name).await.unwrap_err();
                        assert!(matches!(refused, Refusal::CommandFailed { .. }), "{name}: {refused}");
                    }
                    "stop" => _ = world.run(&name, Verb::Stop).await.unwrap_err(),
                    "resume" => {
                        world.run(&name, Verb::Stop).await.unwrap();
                        world.run(&name, Verb::Resume).await.unwrap_err();
                    }
                    _ => {}
                }
                let stands = world.lcm.instance(&world.id(&name)).unwrap().report(false);
                assert_eq!(stands.state, State::Fault, "{name}, round {round}: {stands:?}");
                assert!(stands.fault.contains("chaos"), "{name}, round {round}: {stands:?}");
                let row = get_state(&world, &name).await;
                assert_eq!(row["state"], "FAULT", "{name}, round {round}: {row}");
                world.run(&name, Verb::Reset).await.unwrap();
            }
        }
    }
    world.end().await;
}
