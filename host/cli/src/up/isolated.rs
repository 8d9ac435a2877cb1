//! The processes that a GCM wants for isolated components, kept beside those of the file.
//!
//! Invariant: the GCM's list is followed, never added to. A process that is not on it any more ends,
//! and the GCM is told when it has ended. A GCM that was restarted gets the list from here, since it
//! has lost its own.

use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::time::Duration;

use trocar_model::Name;

use super::System;
use crate::session::Session;
use trocar::gcm::{Fate, Isolated, Supervisor, Told};
use trocar::processes::{Phase, Status};

/// Pause between two attempts to hear a GCM that does not answer.
const PAUSE: Duration = Duration::from_millis(100);

/// Processes that are wanted, and those on their way out.
#[derive(Default)]
struct Wishes {
    /// Term of the GCM that wants them; 0 = none was heard.
    term: u64,
    wanted: Vec<Isolated>,
    leaving: BTreeSet<String>,
    /// Processes that have ended, which the GCM is not told yet.
    gone: Vec<Told>,
}

impl System {
    /// Makes the processes that are wanted and ends those that are not any more, for ever.
    pub(super) async fn attend(&self, session: &Session) -> Infallible {
        let mut wishes = Wishes::default();
        loop {
            // A connection that was cut is made anew.
            let session = Session::new(Some(session.address()), false);
            if let Err(failure) = self.listen(&session, &mut wishes).await {
                log::debug!("what is wanted beside is not heard: {}", failure.message);
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    /// Follows the GCM's list for as long as the GCM is heard.
    async fn listen(&self, session: &Session, wishes: &mut Wishes) -> Result<(), crate::failure::Failure> {
        let processes = self.hosts.iter().filter_map(|host| Name::parse(host.name()).ok()).collect();
        let who = Supervisor { processes, isolated: wishes.wanted.clone(), term: wishes.term };
        let mut lists = session.supervise(&who).await?;
        let mut statuses = self.supervisor.statuses();
        loop {
            let now = statuses.borrow_and_update().clone();
            wishes.settle(self, &now);
            if !wishes.gone.is_empty() {
                session.tell(&wishes.gone).await?;
                wishes.gone.clear();
            }
            tokio::select! {
                list = lists.next() => match list? {
                    Some(Ok((term, wanted))) => {
                        (wishes.term, wishes.wanted) = (term, wanted.isolated);
                        wanted.restart.iter().for_each(|process| self.supervisor.again(process.as_str()));
                    }
                    Some(Err(refusal)) => log::error!("the GCM wants what cannot be: {refusal}"),
                    None => return Ok(()),
                },
                // The supervisor lives as long as this does.
                _ = statuses.changed() => {}
            }
        }
    }
}

impl Wishes {
    /// Forgets processes that have ended, asks unwanted ones to end, and makes missing ones.
    fn settle(&mut self, system: &System, statuses: &BTreeMap<String, Status>) {
        let kept: Vec<String> = system.isolated.borrow().keys().cloned().collect();
        for name in kept {
            if self.wanted.iter().any(|isolated| isolated.process.as_str() == name) {
                continue;
            }
            if self.leaving.insert(name.clone()) {
                system.supervisor.ask_to_end(&name);
            }
            let status = statuses.get(&name).cloned().unwrap_or_default();
            if matches!(status.phase, Phase::Ended | Phase::Failed) {
                system.supervisor.forget(&name);
                system.isolated.send_modify(|isolated| _ = isolated.remove(&name));
                self.leaving.remove(&name);
                self.gone.extend(dismissed(&name, &status));
            }
        }
        for isolated in &self.wanted {
            let name = isolated.process.as_str();
            if system.isolated.borrow().contains_key(name) {
                continue;
            }
            match system.launch.isolated(&isolated.process, &isolated.home) {
                Some(program) => {
                    let program = system.under_gcm(program);
                    system.isolated.send_modify(|all| _ = all.insert(name.to_owned(), program.clone()));
                    system.supervisor.start(program);
                }
                None => log::error!("process {name} is wanted, and cannot be made like {}", isolated.home),
            }
        }
    }
}

fn dismissed(name: &str, status: &Status) -> Option<Told> {
    let (process, last_exit) = (Name::parse(name).ok()?, status.exit_text());
    Some(Told { process, fate: Fate::Dismissed, pid: status.pid, last_exit, restarts: status.restarts })
}
