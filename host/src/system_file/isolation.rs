//! `"isolation": "process"`: a component in a process of its own, made as its process would have been.
//!
//! Invariant: the file names such a component by its written name only; `host/robot` then lives in process
//! `host.robot`. Components that share a thread cannot be taken apart.

use trocar_model::ComponentId;

use super::cursor::{Document, Found};
use super::problem::join;
use super::{ComponentSpec, ConnectionSpec, ProcessSpec};

pub(super) fn isolate(
    document: &Document,
    processes: &mut Vec<ProcessSpec>,
    components: &mut [ComponentSpec],
    connections: &mut [ConnectionSpec],
    found: &Found,
) {
    let wrong = |id: &ComponentId, key: &str, what: String, help: &str| {
        let pointer = join("/components", &id.to_string()) + key;
        let at = document.root.nearest_to(&pointer).at;
        document.problem(at, &pointer, what, help.to_owned())
    };
    let isolated: Vec<ComponentId> = components.iter().filter(|c| c.isolated).map(|c| c.id.clone()).collect();
    for c in components.iter() {
        for (key, owner) in [("stream_of", &c.execution.stream_of), ("inside", &c.execution.inside)] {
            let Some(owner) = owner else { continue };
            let lender = isolated.iter().find(|id| id.to_string() == *owner);
            if c.isolated || lender.is_some() {
                found.note(wrong(
                    &c.id,
                    &format!("/execution/{key}"),
                    format!(
                        "{} runs in the thread of {owner}, and one of them has a process of its own",
                        c.id
                    ),
                    "leave the isolation or the shared thread out",
                ));
            }
        }
    }
    for id in &isolated {
        let lives = id.isolated().map_err(|e| {
            let what = format!("its own process cannot be called so: {e}");
            wrong(id, "/isolation", what, "give component or process a shorter name")
        });
        let Some(lives) = found.take(lives) else { continue };
        let name = &lives.process;
        if processes.iter().any(|p| p.name == *name) {
            let what = format!("its own process would be called {name}, and there is one of that name");
            found.note(wrong(id, "/isolation", what, "give that process another name"));
            continue;
        }
        let Some(home) = processes.iter().find(|p| p.name == id.process).cloned() else { continue };
        processes.push(home.isolated(&lives));
        for c in components.iter_mut().filter(|c| c.id == *id) {
            c.id = lives.clone();
        }
        for end in connections.iter_mut().flat_map(|c| [&mut c.client, &mut c.server]) {
            if end.component == *id {
                end.component = lives.clone();
            }
        }
    }
}
