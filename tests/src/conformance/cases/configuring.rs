//! Configuring a component that runs.

use serde_json::{Value, json};
use trocar::model::{Refusal, State};
use trocar_sdk::Outcome;

use super::super::{Call, Function, Lab, Reach, Way};
use super::commands::waiting;

fn configure(lab: &Lab, patch: Value) -> Result<(), Refusal> {
    lab.configure("server", patch)
}

pub fn a_live_setting_changes_while_the_component_runs(way: &Way) {
    let lab = Lab::running(way);
    assert_eq!(lab.perform(waiting(way, Function::Twice, 3.0)).value, 6.0);
    configure(&lab, json!({ "factor": 5.0 })).expect("factor is live");
    assert_eq!(lab.perform(waiting(way, Function::Twice, 3.0)).value, 15.0);
    assert_eq!(lab.stands("server").map(|s| s.0), Some(State::Active));
    assert_eq!(lab.count("server", "starts"), 1, "nothing was restarted");
}

pub fn any_other_setting_of_a_running_component_is_refused(way: &Way) {
    let lab = Lab::running(way);
    let before = lab.graph().components[&lab.id("server")].config.clone();
    let refused =
        configure(&lab, json!({ "gate": "/nowhere", "factor": 5.0 })).expect_err("gate is not live");
    assert_eq!(refused.reason(), "WRONG_STATE", "{refused}");
    assert_eq!(lab.graph().components[&lab.id("server")].config, before, "a refused request changes nothing");
    assert_eq!(lab.perform(waiting(way, Function::Twice, 3.0)).value, 6.0);
}

pub fn a_value_outside_its_limits_is_refused_whole(way: &Way) {
    let lab = Lab::running(way);
    for bad in [json!({ "factor": 11.0 }), json!({ "factor": "5" }), json!({ "factro": 5.0 })] {
        let refused = configure(&lab, bad.clone()).expect_err("it is refused");
        assert_eq!(refused.reason(), "CONFIG_INVALID", "{bad}: {refused}");
    }
    assert_eq!(lab.perform(waiting(way, Function::Twice, 3.0)).value, 6.0);
}

pub fn a_configuration_survives_a_reset(way: &Way) {
    let lab = Lab::running(way);
    configure(&lab, json!({ "factor": 5.0 })).expect("factor is live");
    lab.reset("server");
    lab.start("server");
    assert_eq!(lab.perform(waiting(way, Function::Twice, 3.0)).value, 15.0);
}

pub fn settings_change_under_load_and_each_answer_is_of_one_of_them(way: &Way) {
    let lab = Lab::running(way);
    std::thread::scope(|scope| {
        let changing = scope.spawn(|| {
            for round in 0..20 {
                let factor = if round % 2 == 0 { 3.0 } else { 2.0 };
                configure(&lab, json!({ "factor": factor })).expect("factor is live");
            }
        });
        // From a thread that may wait for whoever is inside a server without a thread of its own.
        let from = u32::from(way.reach() != Reach::Thread);
        while !changing.is_finished() {
            let answer = lab.perform(Call::call(Function::Twice, 1.0).from_threads(from));
            assert_eq!(answer.only(), Outcome::Executed, "{answer:?}");
            assert!([2.0, 3.0].contains(&answer.value), "{answer:?}");
        }
        changing.join().expect("each change was made");
    });
}
