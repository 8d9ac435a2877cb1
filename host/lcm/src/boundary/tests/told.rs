//! Events that a step sends to other threads: all observers are told once it has ended, however many there
//! are.

use trocar_plugin_api::abi::*;

use super::commands::{client, server};
use super::script::*;
use super::world::*;

/// More than the list of one turn holds.
const OBSERVERS: usize = 70;

#[test]
fn a_step_that_tells_more_components_than_its_list_holds_reaches_all_of_them() {
    let world = World::new("told");
    let step = |stage: &Stage| {
        if stage.seen().is_empty() {
            assert_eq!([stage.emit(0, 7), stage.emit(0, 8)], [EXECUTED, EXECUTED]);
            stage.note(1);
        }
        STATUS_OK
    };
    let source = world.active(
        "source",
        &server(),
        on_signal(),
        Script { step: Some(Box::new(step)), ..Script::default() },
    );
    let first = world.id("observer0");
    source.note(0);
    let observers: Vec<_> = (0..OBSERVERS)
        .map(|i| {
            let heard = |stage: &Stage, _: u32, payload: u64| {
                stage.note(payload);
                STATUS_OK
            };
            let script = Script { on_event: Some(Box::new(heard)), ..Script::default() };
            let place = if i == 0 { on_signal() } else { with(&first) };
            let name = format!("observer{i}");
            let stage = world.active(&name, &client(false), place, script);
            world.connect(&format!("{name}/peer"), "source/ctl");
            stage
        })
        .collect();
    source.forget();
    world.instance("source").signal();
    for (i, observer) in observers.iter().enumerate() {
        eventually(&format!("both events at observer {i}"), || observer.seen() == [7, 8]);
    }
    assert_eq!(source.seen(), [1], "the step emitted once");
}
