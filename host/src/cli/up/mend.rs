//! What only the system file says of a process that was started again: what is to go on by itself, and, when the GCM had ended
//! with it, what it had.
//!
//! Invariant: a GCM makes anew what a process had, and a process brings along what a GCM had; only what both have lost is
//! taken from the file. What moves something is started only where the file says `"resume": "auto"`.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use trocar_model::{ComponentId, Request, Target};

use super::programs::GCM;
use crate::cli::failure::Failure;
use crate::cli::out;
use crate::cli::session::Session;
use crate::cli::view::SystemView;
use crate::processes::{Phase, Status};
use crate::system_file::{ComponentSpec, SystemFile};

type Statuses = BTreeMap<String, Status>;

/// Time for what is made once more.
const WITHIN: Duration = Duration::from_secs(60);

/// How often GCM and processes had been started when all was known to be there.
#[derive(Default)]
pub(super) struct Mender {
    seen: BTreeMap<String, u32>,
}

impl Mender {
    pub(super) fn new(statuses: &Statuses) -> Mender {
        Mender { seen: restarts(statuses) }
    }

    /// True: something was started since, and `mend` is to be asked until it answers true.
    pub(super) fn is_due(&self, statuses: &Statuses) -> bool {
        self.seen != restarts(statuses)
    }

    /// Looks what is missing and makes it again. False: not all is back yet.
    pub(super) async fn mend(&mut self, statuses: &Statuses, file: &SystemFile, session: &Session) -> bool {
        let settled = |s: &Status| matches!(s.phase, Phase::Running | Phase::Failed | Phase::Ended);
        if !statuses.values().all(settled) {
            return false;
        }
        let Ok(listed) = session.list().await else { return false };
        let runs = |name: &String| statuses[name].phase == Phase::Running;
        let attached =
            |name: &String| listed.processes.iter().any(|p| p.name == *name && p.state == "ATTACHED");
        if !statuses.keys().filter(|name| *name != GCM && runs(name)).all(attached) {
            return false;
        }
        let now = restarts(statuses);
        let again = |name: &str| now.get(name) != self.seen.get(name);
        let both: Vec<&str> = if again(GCM) {
            now.keys().map(String::as_str).filter(|name| *name != GCM && again(name)).collect()
        } else {
            Vec::new()
        };
        let missing = missing(file, &listed, &both);
        if !both.is_empty()
            && let Err(failure) = make(file, &missing, &both, session).await
        {
            let names: Vec<String> = missing.iter().map(ToString::to_string).collect();
            out::complain(
                "error",
                &format!("{} cannot be made again: {}", names.join(", "), failure.message),
            );
        }
        let back: Vec<&str> = now.keys().map(String::as_str).filter(|name| again(name)).collect();
        if let Err(failure) = resume(file, &back, &both, session).await {
            out::complain("error", &format!("not resumed: {}", failure.message));
        }
        self.seen = now;
        true
    }
}

fn restarts(statuses: &Statuses) -> BTreeMap<String, u32> {
    statuses.iter().map(|(name, s)| (name.clone(), s.restarts)).collect()
}

/// What the file has in these processes and the system has not.
fn missing(file: &SystemFile, listed: &SystemView, processes: &[&str]) -> BTreeSet<ComponentId> {
    let lost = |id: &ComponentId| {
        let path = id.to_string();
        processes.contains(&id.process.as_str()) && listed.components.iter().all(|c| c.path != path)
    };
    file.components.iter().map(|c| &c.id).filter(|id| lost(id)).cloned().collect()
}

/// The requests of the file that concern these, and no Start.
fn requests(file: &SystemFile, missing: &BTreeSet<ComponentId>) -> Vec<Request> {
    let concerned = |request: &Request| match request {
        Request::Create { id, .. } => missing.contains(id),
        Request::Connect { client, server, .. } => {
            missing.contains(&client.component) || missing.contains(&server.component)
        }
        _ => false,
    };
    file.requests().into_iter().filter(concerned).collect()
}

/// Lets go on what the file says goes on by itself.
async fn resume(
    file: &SystemFile,
    processes: &[&str],
    both: &[&str],
    session: &Session,
) -> Result<(), Failure> {
    let goes_on = |c: &&ComponentSpec| c.resumes && processes.contains(&c.id.process.as_str());
    if !file.components.iter().any(|c| goes_on(&c)) {
        return Ok(());
    }
    let listed = session.list().await?;
    let stands = |c: &ComponentSpec, state: &str| {
        let path = c.id.to_string();
        listed.components.iter().any(|l| l.path == path && l.state == state)
    };
    let those = |state: &str| -> Vec<Target> {
        let those = file.components.iter().filter(goes_on).filter(|c| stands(c, state));
        those.map(|c| Target::One(c.id.clone())).collect()
    };
    let from_file = |target: &Target| {
        let Target::One(id) = target else { return false };
        both.contains(&id.process.as_str()) && file.components.iter().any(|c| c.start && c.id == *id)
    };
    let (stopped, ready) = (those("STOPPED{restarted}"), those("READY"));
    let mut requests = Vec::new();
    if !stopped.is_empty() {
        requests.push(Request::Resume { targets: stopped });
    }
    // Made from the file, when the GCM had ended with it.
    let ready: Vec<Target> = ready.into_iter().filter(from_file).collect();
    if !ready.is_empty() {
        requests.push(Request::Start { targets: ready });
    }
    session.apply(&requests, WITHIN).await.map(|_| ())
}

/// Makes what is missing in these processes, and starts what only measures there: the GCM may have ended in the middle of
/// making them anew.
async fn make(
    file: &SystemFile,
    missing: &BTreeSet<ComponentId>,
    processes: &[&str],
    session: &Session,
) -> Result<(), Failure> {
    session.apply(&requests(file, missing), WITHIN).await?;
    let listed = session.list().await?;
    let here = |c: &&ComponentSpec| c.start && processes.contains(&c.id.process.as_str());
    let ready = |c: &&ComponentSpec| {
        let path = c.id.to_string();
        listed
            .components
            .iter()
            .find(|l| l.path == path && l.state == "READY")
            .map(|l| l.safety == "actuator")
    };
    let stands = |moves: bool| file.components.iter().filter(here).filter(move |c| ready(c) == Some(moves));
    let targets: Vec<Target> = stands(false).map(|c| Target::One(c.id.clone())).collect();
    if !targets.is_empty() {
        session.apply(&[Request::Start { targets }], WITHIN).await?;
    }
    let text = |ids: Vec<String>| ids.join(", ");
    let made = text(missing.iter().map(ToString::to_string).collect());
    let mut said = format!("the GCM had ended together with {}", processes.join(", "));
    if !made.is_empty() {
        said.push_str(&format!(": {made} made again from the file"));
    }
    let waiting = text(stands(true).map(|c| c.id.to_string()).collect());
    if !waiting.is_empty() {
        said.push_str(&format!("; {waiting} can move something and is not started by that"));
    }
    out::complain("warning", &said);
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::cli::view::ComponentView;

    const FILE: &str = r#"{"version": 1,
        "components": { "a/x": {"class": "c"}, "a/y": {"class": "c"}, "b/z": {"class": "c"} },
        "connections": [ {"client": "a/x/i", "server": "a/y/o"}, {"client": "b/z/i", "server": "b/z/o"} ]}"#;

    #[test]
    fn only_what_both_have_lost_is_taken_from_the_file() {
        let file = SystemFile::parse("f", FILE.to_owned()).unwrap();
        let there = |path: &str| ComponentView { path: path.into(), ..ComponentView::default() };
        let listed = SystemView { components: vec![there("a/y")], ..SystemView::default() };
        let lost = missing(&file, &listed, &["a"]);
        assert_eq!(lost.iter().map(ToString::to_string).collect::<Vec<_>>(), ["a/x"], "b is not concerned");
        let kinds: Vec<bool> =
            requests(&file, &lost).iter().map(|r| matches!(r, Request::Create { .. })).collect();
        assert_eq!(kinds, [true, false], "its Create, its connection, and no Start");
        assert!(missing(&file, &listed, &[]).is_empty());
    }
}
