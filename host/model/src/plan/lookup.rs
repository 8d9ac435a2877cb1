//! Finds what a request names, and says what exists when it does not.
//!
//! Invariant: an unknown process is reported before an unknown component, a lost process only when asked to
//! act there.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::{
    ClassInfo, Component, ComponentId, Connection, Name, Pattern, PortId, Process, ProcessState, Programs,
    Refusal, SystemGraph, Target, Verb,
};

impl SystemGraph {
    /// The process, lost or not.
    ///
    /// # Errors
    /// PROCESS_NOT_FOUND with the known ones.
    pub fn process(&self, name: &Name) -> Result<&Process, Refusal> {
        self.processes.get(name).ok_or_else(|| Refusal::ProcessNotFound {
            process: name.clone(),
            known: self.processes.keys().cloned().collect(),
        })
    }

    /// The process, if it answers.
    ///
    /// # Errors
    /// PROCESS_NOT_FOUND, PROCESS_LOST.
    pub fn attached(&self, name: &Name) -> Result<&Process, Refusal> {
        let process = self.process(name)?;
        match process.state {
            ProcessState::Attached => Ok(process),
            ProcessState::Lost | ProcessState::Restarting | ProcessState::Failed => Err(process.lost(name)),
        }
    }

    pub(super) fn is_lost(&self, id: &ComponentId) -> bool {
        self.processes.get(&id.process).is_none_or(|p| p.state != ProcessState::Attached)
    }

    /// The component, whether its process is lost or not.
    ///
    /// # Errors
    /// PROCESS_NOT_FOUND; COMPONENT_NOT_FOUND with the components of that process.
    pub fn component(&self, id: &ComponentId) -> Result<&Component, Refusal> {
        self.process(&id.process)?;
        self.components.get(id).ok_or_else(|| Refusal::ComponentNotFound {
            id: id.clone(),
            known: self.components.keys().filter(|k| k.process == id.process).cloned().collect(),
        })
    }

    /// Returns the class that `class` means in `process`: `plugin/class`, or the class alone where that is
    /// unique.
    ///
    /// # Errors
    /// PROCESS_NOT_FOUND; CLASS_NOT_FOUND with what exists, where else it exists, or what it could mean.
    pub fn class(&self, process: &Name, class: &str) -> Result<Arc<ClassInfo>, Refusal> {
        let classes = &self.process(process)?.classes;
        let matching = find_class(classes, class);
        match matching.as_slice() {
            [one] => Ok(Arc::clone(one)),
            found => Err(Refusal::ClassNotFound {
                process: process.clone(),
                class: class.to_owned(),
                known: spellings(classes, class.contains('/')),
                elsewhere: if found.is_empty() { self.offering(class) } else { Vec::new() },
                ambiguous: found.iter().map(|c| c.full_name()).collect(),
            }),
        }
    }

    fn offering(&self, class: &str) -> Vec<Name> {
        let has =
            |p: &Process| p.state == ProcessState::Attached && !find_class(&p.classes, class).is_empty();
        self.processes.iter().filter(|(_, p)| has(p)).map(|(name, _)| name.clone()).collect()
    }

    /// The connection whose client end is `port`; there is at most one.
    pub fn source_of(&self, port: &PortId) -> Option<&Connection> {
        self.connections.values().find(|c| c.client == *port)
    }

    /// "3: host/robot/arm → host/bscan/robot", server first as data flows, for refusals.
    pub(super) fn connection_list(&self) -> Vec<String> {
        self.connections.values().map(|c| format!("{}: {} → {}", c.id.0, c.server, c.client)).collect()
    }

    /// Returns the components `targets` mean, in the order of their paths; true = named, not only matched by
    /// a glob.
    pub(super) fn targets(
        &self,
        verb: Verb,
        targets: &[Target],
    ) -> Result<Vec<(ComponentId, bool)>, Refusal> {
        if targets.is_empty() {
            return Err(Refusal::ArgumentInvalid {
                what: verb.to_string(),
                why: "it was given no path".to_owned(),
                field: "paths".to_owned(),
            });
        }
        let mut out = BTreeMap::new();
        for target in targets {
            match target {
                Target::One(id) => {
                    self.component(id)?;
                    out.insert(id.clone(), true);
                }
                Target::Glob(pattern) => {
                    let mut any = false;
                    for id in self.components.keys().filter(|id| pattern.matches(id)) {
                        any = true;
                        out.entry(id.clone()).or_insert(false);
                    }
                    // "Stop everything" must hold also where there is nothing.
                    let all = verb == Verb::Stop && *pattern == Pattern::all();
                    if !any && !all {
                        return Err(Refusal::NothingMatches {
                            pattern: pattern.to_string(),
                            known: self.components.keys().cloned().collect(),
                        });
                    }
                }
            }
        }
        Ok(out.into_iter().collect())
    }
}

impl Process {
    /// Returns the refusal for a process that cannot be asked, in its present state.
    pub fn lost(&self, name: &Name) -> Refusal {
        let last_exit = self.last_exit.clone();
        Refusal::ProcessLost { process: name.clone(), state: self.state, last_exit }
    }
}

impl ClassInfo {
    /// Tells whether `process`, whose class it is, lets a component of it be made.
    ///
    /// # Errors
    /// ProgramsNotAllowed.
    pub fn is_let_into(&self, process: &Name) -> Result<(), Refusal> {
        if self.programs != Programs::Refused {
            return Ok(());
        }
        Err(Refusal::ProgramsNotAllowed { process: process.clone(), class: self.full_name() })
    }
}

fn find_class<'a>(classes: &'a [Arc<ClassInfo>], wanted: &str) -> Vec<&'a Arc<ClassInfo>> {
    let is = |c: &&Arc<ClassInfo>| match wanted.split_once('/') {
        Some((plugin, class)) => c.plugin == plugin && c.name == class,
        None => c.name == wanted,
    };
    classes.iter().filter(is).collect()
}

/// Returns every class as a user would type it: short where unique, unless the question was asked in full.
fn spellings(classes: &[Arc<ClassInfo>], full: bool) -> Vec<String> {
    let spell = |c: &Arc<ClassInfo>| {
        if full || find_class(classes, &c.name).len() > 1 { c.full_name() } else { c.name.clone() }
    };
    let mut out: Vec<String> = classes.iter().map(spell).collect();
    out.sort();
    out
}
