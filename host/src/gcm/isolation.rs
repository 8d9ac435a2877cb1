//! Processes for isolated components: those that are wanted, and the supervisors that can make them.
//!
//! Invariant: all wanted processes are one list, of which each supervisor is told the whole of its part.

use std::collections::{BTreeMap, BTreeSet};

use trocar_model::{Name, Refusal};

/// A process for one component alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Isolated {
    pub process: Name,
    /// The process it is made like.
    pub home: Name,
}

/// A supervisor's orders.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Orders {
    /// All it is to keep for isolated components.
    pub isolated: Vec<Isolated>,
    /// Processes it is to start again now.
    pub restart: Vec<Name>,
}

#[derive(Default)]
pub(super) struct Isolation {
    /// By process: the process it is made like.
    wanted: BTreeMap<Name, Name>,
    /// Supervisors that listen, by number, each with the processes beside which it can make others.
    listening: BTreeMap<u64, BTreeSet<Name>>,
    newest: u64,
    /// Processes that were asked to be started again, with how often.
    restarts: BTreeMap<Name, u64>,
}

impl Isolation {
    /// Takes in a supervisor that can make processes beside these; returns its number.
    pub(super) fn listens(&mut self, homes: BTreeSet<Name>) -> u64 {
        self.newest += 1;
        self.listening.insert(self.newest, homes);
        self.newest
    }

    pub(super) fn listens_no_more(&mut self, number: u64) {
        self.listening.remove(&number);
    }

    pub(super) fn want(&mut self, isolated: impl IntoIterator<Item = Isolated>) {
        self.wanted.extend(isolated.into_iter().map(|isolated| (isolated.process, isolated.home)));
    }

    pub(super) fn is_wanted(&self, process: &Name) -> bool {
        self.wanted.contains_key(process)
    }

    /// Takes processes off the list; true: some were on it.
    pub(super) fn not_wanted(&mut self, processes: &BTreeSet<Name>) -> bool {
        let before = self.wanted.len();
        self.wanted.retain(|process, _| !processes.contains(process));
        self.wanted.len() != before
    }

    /// Has the supervisor of a process start it again.
    pub(super) fn restart(&mut self, process: &Name) {
        *self.restarts.entry(process.clone()).or_default() += 1;
    }

    /// Returns how often each process was asked to be started again.
    pub(super) fn restarts(&self) -> &BTreeMap<Name, u64> {
        &self.restarts
    }

    /// Returns the orders for a supervisor that was told these restarts.
    pub(super) fn orders(&self, number: u64, told: &BTreeMap<Name, u64>) -> Orders {
        let none = BTreeSet::new();
        let homes = self.listening.get(&number).unwrap_or(&none);
        let its = self.wanted.iter().filter(|(_, home)| homes.contains(*home));
        let isolated = its.map(|(process, home)| Isolated { process: process.clone(), home: home.clone() });
        let asked = self
            .restarts
            .iter()
            .filter(|(process, asked)| told.get(*process) != Some(*asked) && self.keeps(homes, process));
        let restart = asked.map(|(process, _)| process.clone()).collect();
        Orders { isolated: isolated.collect(), restart }
    }

    /// Tells whether supervisors are there that make these.
    ///
    /// # Errors
    /// NotSupervised, with the processes beside which others can be made.
    pub(super) fn can_be_made(&self, isolated: &[Isolated]) -> Result<(), Refusal> {
        match isolated
            .iter()
            .find(|isolated| self.listening.values().all(|homes| !homes.contains(&isolated.home)))
        {
            Some(isolated) => Err(self.not_supervised(&isolated.home)),
            None => Ok(()),
        }
    }

    /// Tells whether a supervisor keeps the process.
    ///
    /// # Errors
    /// NotSupervised, with the processes beside which others can be made.
    pub(super) fn is_kept(&self, process: &Name) -> Result<(), Refusal> {
        let kept = self.listening.values().any(|homes| self.keeps(homes, process));
        if kept { Ok(()) } else { Err(self.not_supervised(process)) }
    }

    fn not_supervised(&self, process: &Name) -> Refusal {
        let known: BTreeSet<&Name> = self.listening.values().flatten().collect();
        Refusal::NotSupervised { process: process.clone(), known: known.into_iter().cloned().collect() }
    }

    /// Tells whether a supervisor that listens beside these keeps the process.
    fn keeps(&self, homes: &BTreeSet<Name>, process: &Name) -> bool {
        homes.contains(process) || self.wanted.get(process).is_some_and(|home| homes.contains(home))
    }
}
