//! Knowledge about a restarted process that only the supervisor has: which components go on by themselves
//! and, when the GCM had ended with it, what the process had.
//!
//! Invariant: a GCM makes anew what a process had, and a process brings along what a GCM had. Only components
//! that both have lost are made as they were last seen, or from the file when they never were. A component
//! that moves something goes on only where the file says `"resume": "auto"`, when it ran before, and never
//! against a Stop.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use trocar_model::{ComponentId, Request, Target};

use super::last_seen::LastSeen;
use super::standing::Standing;
use super::telling::Voice;
use crate::failure::Failure;
use crate::session::Session;
use crate::view::{ComponentView, SystemView};
use trocar::processes::{Phase, Status};
use trocar::system_file::{ComponentSpec, SystemFile};

/// Time to make components once more.
const WITHIN: Duration = Duration::from_secs(60);
/// Pause before a failed attempt is repeated: the first one, and the longest.
const AGAIN: (Duration, Duration) = (Duration::from_millis(50), Duration::from_secs(5));

/// Memory of the supervisor about one process.
pub(super) struct Mender {
    process: String,
    /// Number of restarts at the last look.
    restarts: u32,
    /// True: the process was restarted since, and mending it is still due.
    owed: bool,
    /// Term of the GCM under which the process was last seen whole.
    term: u64,
    /// Contents of the process at that time.
    last_seen: LastSeen,
    /// Components that were made again, and may wait for connections to processes that are not back yet.
    remade: BTreeSet<ComponentId>,
}

/// Everything that a mender works with.
pub(super) struct Tools<'a> {
    pub(super) file: &'a SystemFile,
    pub(super) session: &'a Session,
    pub(super) voice: Option<&'a Voice>,
    /// One mender at a time makes missing components: connections have ends in two processes.
    pub(super) making: &'a tokio::sync::Mutex<()>,
}

impl Mender {
    /// Makes the mender of a process that is up.
    pub(super) fn new(process: &str, status: &Status, standing: &Standing) -> Mender {
        let mut mender = Mender {
            process: process.to_owned(),
            restarts: status.restarts,
            owed: false,
            term: standing.term,
            last_seen: LastSeen::default(),
            remade: BTreeSet::new(),
        };
        mender.look(status, standing);
        mender
    }

    /// Takes in the state of the process. True: `mend` is to be called until it succeeds.
    pub(super) fn look(&mut self, status: &Status, standing: &Standing) -> bool {
        self.owed |= status.restarts != self.restarts;
        self.restarts = status.restarts;
        let whole = status.phase == Phase::Running && standing.is_whole(&self.process, status.pid);
        if whole && !self.owed {
            self.term = standing.term;
            self.last_seen.take(&self.process, status.pid, standing);
        } else if standing.heard {
            self.last_seen.take_last(&self.process, standing);
        }
        whole && self.owed
    }

    /// Does the mending that is due.
    ///
    /// # Errors
    /// A part of it failed: all is to be tried once more.
    pub(super) async fn mend(&mut self, standing: &Standing, tools: &Tools<'_>) -> Result<(), Failure> {
        if self.term != standing.term {
            let _alone = tools.making.lock().await;
            self.make(tools).await?;
        }
        self.resume(tools).await?;
        self.owed = false;
        Ok(())
    }

    /// Returns the components that the process should have: those of the file in its order, then those
    /// that came since.
    fn should_have(&self, file: &SystemFile) -> Vec<ComponentId> {
        let written = self.here(file).map(|c| c.id.clone());
        if !self.last_seen.is_known() {
            return written.collect();
        }
        let known = self.last_seen.components();
        let mut all: Vec<ComponentId> = written.filter(|id| known.contains(id)).collect();
        let since: Vec<ComponentId> = known.into_iter().filter(|id| !all.contains(id)).collect();
        all.extend(since);
        all
    }

    /// Returns the requests that make these components, and their connections.
    fn requests(&self, file: &SystemFile) -> Vec<Request> {
        if self.last_seen.is_known() { self.last_seen.requests() } else { file.requests() }
    }

    fn here<'f>(&self, file: &'f SystemFile) -> impl Iterator<Item = &'f ComponentSpec> {
        file.components.iter().filter(move |c| c.id.process.as_str() == self.process)
    }

    /// Resumes the components that ran and that the file lets go on by themselves, unless a Stop comes
    /// in this moment.
    async fn resume(&self, tools: &Tools<'_>) -> Result<(), Failure> {
        let resumes: BTreeSet<String> =
            self.here(tools.file).filter(|c| c.resumes).map(|c| c.id.to_string()).collect();
        if resumes.is_empty() {
            return Ok(());
        }
        let listed = tools.session.standing().await?;
        let waits = |c: &&ComponentView| c.state == "STOPPED{restarted}" && self.last_seen.ran(&c.path);
        let stopped = listed.components.iter().filter(waits).filter(|c| resumes.contains(&c.path));
        let targets = targets(stopped.map(|c| c.path.as_str()));
        if targets.is_empty() {
            return Ok(());
        }
        let resume = [Request::Resume { targets }];
        tools.session.apply_at(&resume, WITHIN, Some(listed.revision)).await.map(|_| ())
    }

    /// Makes the components that are missing here, and starts those that ran, unless they move something: the
    /// GCM may have ended while it made the process anew.
    async fn make(&mut self, tools: &Tools<'_>) -> Result<(), Failure> {
        let Tools { file, session, .. } = tools;
        let listed = session.standing().await?;
        let missing = missing(&self.should_have(file), &listed);
        self.remade.extend(missing.iter().cloned());
        let all = self.requests(file);
        session.apply(&of_missing(all.clone(), &missing, &self.remade, &listed), WITHIN).await?;
        let made = session.standing().await?;
        let (starts, waits) = self.to_start(file, &made);
        if !starts.is_empty() {
            let start = [Request::Start { targets: targets(starts.into_iter()) }];
            session.apply_at(&start, WITHIN, Some(made.revision)).await?;
        }
        if let Some(other) = self.waits_for(all, &made) {
            let text = format!("its connections to {other} wait for that");
            return Err(Failure::local("PROCESS_LOST", text, "It is tried again."));
        }
        let remade = std::mem::take(&mut self.remade);
        let Some(voice) = tools.voice else { return Ok(()) };
        let mut said = format!("the GCM had ended together with {}", self.process);
        if !remade.is_empty() {
            let missing: Vec<String> = remade.iter().map(ToString::to_string).collect();
            said.push_str(&format!(": {} made again", missing.join(", ")));
        }
        if !waits.is_empty() {
            said.push_str(&format!("; {} can move something and is not started by that", waits.join(", ")));
        }
        voice.complain("warning", &said);
        Ok(())
    }

    /// Returns a component that is not there yet, and that a component made again is to be connected to.
    fn waits_for(&self, all: Vec<Request>, listed: &SystemView) -> Option<ComponentId> {
        let there = |id: &ComponentId| listed.components.iter().any(|c| c.path == id.to_string());
        all.into_iter().find_map(|request| {
            let Request::Connect { client, server, .. } = request else { return None };
            let ends = [client.component, server.component];
            let mine = ends.iter().any(|id| self.remade.contains(id));
            ends.into_iter().find(|id| mine && !there(id))
        })
    }

    /// Returns the components that are READY here and ran before: those to start, and those that
    /// wait for a person.
    fn to_start<'l>(&self, file: &SystemFile, listed: &'l SystemView) -> (Vec<&'l str>, Vec<&'l str>) {
        let (mut starts, mut waits) = (Vec::new(), Vec::new());
        for id in self.should_have(file) {
            let (path, spec) = (id.to_string(), self.here(file).find(|c| c.id == id));
            let ran = match self.last_seen.is_known() {
                true => self.last_seen.ran(&path),
                false => spec.is_some_and(|c| c.start),
            };
            let is_it = |c: &&ComponentView| c.path == path && c.state == "READY" && ran;
            let Some(component) = listed.components.iter().find(is_it) else { continue };
            if component.safety != "actuator" || spec.is_some_and(|c| c.resumes) {
                starts.push(component.path.as_str());
            } else {
                waits.push(component.path.as_str());
            }
        }
        (starts, waits)
    }
}

/// Mends one process whenever that is due, for ever.
pub(super) async fn keep_whole(
    mut mender: Mender,
    mut statuses: tokio::sync::watch::Receiver<BTreeMap<String, Status>>,
    mut standing: tokio::sync::watch::Receiver<std::sync::Arc<Standing>>,
    tools: &Tools<'_>,
) -> std::convert::Infallible {
    let (mut pause, mut said) = (AGAIN.0, None);
    loop {
        let status = statuses.borrow_and_update().get(&mender.process).cloned().unwrap_or_default();
        let stands = standing.borrow_and_update().clone();
        if mender.look(&status, &stands) {
            match mender.mend(&stands, tools).await {
                Ok(()) => {
                    (pause, said) = (AGAIN.0, None);
                    continue;
                }
                Err(failure) => {
                    if let (Some(voice), true) = (tools.voice, is_news(&failure, &mut said)) {
                        let text = format!("{} is not whole yet: {}", mender.process, failure.message);
                        voice.complain("warning", &text);
                    }
                    tokio::time::sleep(pause).await;
                    pause = (pause * 2).min(AGAIN.1);
                    continue;
                }
            }
        }
        // Both senders live for as long as the system is kept.
        tokio::select! {
            _ = statuses.changed() => {}
            _ = standing.changed() => {}
        }
    }
}

/// Tells whether a failure is worth a warning: a change in the moment of looking is not, and neither is a
/// repeated message.
fn is_news(failure: &Failure, said: &mut Option<String>) -> bool {
    let passes = matches!(failure.reason.as_str(), "REVISION_CONFLICT" | "PROCESS_LOST" | "NO_GCM");
    !passes && said.replace(failure.message.clone()).as_ref() != Some(&failure.message)
}

fn targets<'a>(paths: impl Iterator<Item = &'a str>) -> Vec<Target> {
    paths.filter_map(|path| ComponentId::parse(path).ok()).map(Target::One).collect()
}

/// Returns the components that the process should have and the system has not.
fn missing(should: &[ComponentId], listed: &SystemView) -> BTreeSet<ComponentId> {
    let lost = |id: &&ComponentId| {
        let path = id.to_string();
        listed.components.iter().all(|c| c.path != path)
    };
    should.iter().filter(lost).cloned().collect()
}

/// Returns requests that make missing components, configure those that an earlier attempt has left half made,
/// and connect both; no Start. A connection whose other end is missing too comes with that one.
fn of_missing(
    all: Vec<Request>,
    missing: &BTreeSet<ComponentId>,
    remade: &BTreeSet<ComponentId>,
    listed: &SystemView,
) -> Vec<Request> {
    let there = |id: &ComponentId| {
        let path = id.to_string();
        missing.contains(id) || listed.components.iter().any(|c| c.path == path)
    };
    // Tells whether a component is made, but not configured: an attempt that was begun could not
    // be taken back.
    let is_half = |id: &ComponentId| {
        let path = id.to_string();
        remade.contains(id) && listed.components.iter().any(|c| c.path == path && c.state == "CREATED")
    };
    let concerned = |request: Request| match request {
        Request::Create { ref id, .. } if missing.contains(id) => Some(request),
        Request::Create { id, config, .. } if is_half(&id) => {
            let patch = config.unwrap_or_else(|| serde_json::json!({}));
            Some(Request::Configure { id, patch, execution: None })
        }
        Request::Connect { ref client, ref server, .. } => {
            let (from, to) = (client.to_string(), server.to_string());
            let ends = [&client.component, &server.component];
            let wanted = ends.iter().any(|id| remade.contains(*id))
                && ends.iter().all(|id| there(id))
                && !listed.connections.iter().any(|c| c.client == from && c.server == to);
            wanted.then_some(request)
        }
        _ => None,
    };
    all.into_iter().filter_map(concerned).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::view::{ConnectionView, ProcessView};

    const FILE: &str = r#"{"version": 1,
        "components": {
            "a/x": {"class": "c"}, "a/y": {"class": "c"}, "a/z": {"class": "c", "start": false},
            "a/arm": {"class": "c"}, "a/leg": {"class": "c", "resume": "auto"}, "b/z": {"class": "c"}
        },
        "connections": [
            {"client": "a/x/i", "server": "a/y/o"}, {"client": "b/z/i", "server": "b/z/o"},
            {"client": "a/x/far", "server": "b/z/o"}
        ]}"#;

    fn file() -> SystemFile {
        SystemFile::parse("f", FILE.to_owned()).unwrap()
    }

    fn component(path: &str, state: &str, safety: &str) -> ComponentView {
        ComponentView {
            path: path.into(),
            state: state.into(),
            safety: safety.into(),
            ..ComponentView::default()
        }
    }

    fn standing(term: u64, pid: u32, components: &[(&str, &str)]) -> Standing {
        let process =
            ProcessView { name: "a".into(), state: "ATTACHED".into(), pid, ..ProcessView::default() };
        let components = components.iter();
        Standing {
            heard: true,
            term,
            processes: [("a".to_owned(), process)].into(),
            components: components
                .map(|(path, state)| ((*path).to_owned(), component(path, state, "none")))
                .collect(),
            ..Standing::default()
        }
    }

    fn running(pid: u32, restarts: u32) -> Status {
        Status { phase: Phase::Running, pid, restarts, ..Status::default() }
    }

    #[test]
    fn only_what_both_have_lost_is_taken_from_the_file() {
        let file = file();
        let here: Vec<ComponentId> =
            file.components.iter().filter(|c| c.id.process.as_str() == "a").map(|c| c.id.clone()).collect();
        let there = |path: &str| component(path, "ACTIVE", "none");
        let listed = SystemView {
            components: ["a/y", "a/z", "a/arm", "a/leg"].map(there).into(),
            ..SystemView::default()
        };
        let lost = missing(&here, &listed);
        assert_eq!(lost.iter().map(ToString::to_string).collect::<Vec<_>>(), ["a/x"], "b is not concerned");
        let kinds = |listed: &SystemView| -> Vec<bool> {
            of_missing(file.requests(), &lost, &lost, listed)
                .iter()
                .map(|r| matches!(r, Request::Create { .. }))
                .collect()
        };
        assert_eq!(kinds(&listed), [true, false], "its Create and its connection; b/z is not there yet");
        let mut more = listed.clone();
        more.components.push(there("b/z"));
        assert_eq!(kinds(&more), [true, false, false], "the connection to b, too");
        let known = ConnectionView { client: "a/x/far".into(), server: "b/z/o".into(), ..Default::default() };
        more.connections.push(known);
        assert_eq!(kinds(&more), [true, false], "which may be there already");
    }

    #[test]
    fn what_an_earlier_attempt_has_left_half_made_is_completed() {
        let (file, none) = (file(), BTreeSet::new());
        let remade: BTreeSet<ComponentId> =
            ["a/x", "a/y"].map(|path| ComponentId::parse(path).unwrap()).into();
        let listed = SystemView {
            components: [component("a/x", "CREATED", "none"), component("a/y", "READY", "none")].into(),
            ..SystemView::default()
        };
        let asked = of_missing(file.requests(), &none, &remade, &listed);
        let [Request::Configure { id, .. }, Request::Connect { client, .. }] = &asked[..] else {
            panic!("{asked:?}")
        };
        assert_eq!((id.to_string(), client.to_string()), ("a/x".to_owned(), "a/x/i".to_owned()));
        let foreign = of_missing(file.requests(), &none, &none, &listed);
        assert!(foreign.is_empty(), "somebody else's is left as it is: {foreign:?}");
    }

    #[test]
    fn what_is_owed_stays_owed_until_it_is_done() {
        let whole = standing(1, 7, &[("a/x", "ACTIVE")]);
        let mut mender = Mender::new("a", &running(7, 0), &whole);
        assert!(!mender.look(&running(7, 0), &whole));
        assert!(!mender.look(&Status { phase: Phase::Starting, ..running(8, 1) }, &whole), "it is not back");
        assert!(!mender.look(&running(8, 1), &whole), "the GCM speaks of the one before");
        let back = standing(1, 8, &[("a/x", "ACTIVE")]);
        assert!(mender.look(&running(8, 1), &back) && mender.look(&running(8, 1), &back));
        assert_eq!(mender.term, back.term, "the GCM has it all");
        mender.owed = false;
        assert!(!mender.look(&running(8, 1), &back));
    }

    #[test]
    fn a_gcm_that_ended_too_is_known_by_its_term_whoever_ended_first() {
        let first = standing(1, 7, &[("a/x", "ACTIVE")]);
        let mut mender = Mender::new("a", &running(7, 0), &first);
        // The process is back under the next GCM, which never heard of what it had.
        let next = standing(2, 8, &[]);
        assert!(mender.look(&running(8, 1), &next) && mender.term != next.term);
        // A process that only lost its GCM brings its contents along.
        let mut other = Mender::new("a", &running(7, 0), &first);
        assert!(!other.look(&running(7, 0), &Standing { term: 2, ..first.clone() }));
        assert_eq!(other.term, 2);
    }

    #[test]
    fn what_somebody_had_stopped_and_what_moves_is_not_started_from_the_file() {
        let before = standing(
            1,
            7,
            &[("a/x", "STOPPED{requested}"), ("a/y", "ACTIVE"), ("a/arm", "ACTIVE"), ("a/leg", "ACTIVE")],
        );
        let mender = Mender::new("a", &running(7, 0), &before);
        let ready = |path: &str| {
            component(
                path,
                "READY",
                if path.ends_with("g") || path.ends_with("m") { "actuator" } else { "none" },
            )
        };
        let made = SystemView {
            components: ["a/x", "a/y", "a/z", "a/arm", "a/leg", "b/z"].map(ready).into(),
            ..SystemView::default()
        };
        assert_eq!(mender.to_start(&file(), &made), (vec!["a/y", "a/leg"], vec!["a/arm"]));
        let stopped = standing(1, 7, &[("a/leg", "STOPPED{requested}")]);
        let mender = Mender::new("a", &running(7, 0), &stopped);
        let (starts, _) = mender.to_start(&file(), &made);
        assert!(!starts.contains(&"a/leg"), "somebody had stopped it: {starts:?}");
    }
    #[test]
    fn what_had_failed_or_was_stopped_before_the_end_is_not_let_go_on() {
        let seen = |state: &str| standing(1, 7, &[("a/leg", state)]);
        let mut mender = Mender::new("a", &running(7, 0), &seen("ACTIVE"));
        assert!(mender.last_seen.ran("a/leg"));
        // The last news of the component came together with its end.
        let mut ended = seen("FAULT");
        ended.processes.get_mut("a").unwrap().state = "LOST".into();
        assert!(!mender.look(&running(7, 0), &ended) && !mender.last_seen.ran("a/leg"));
        let mut back = standing(1, 8, &[("a/leg", "STOPPED{restarted}")]);
        assert!(mender.look(&running(8, 1), &back) && !mender.last_seen.ran("a/leg"), "whatever it is now");
        // A component that ran goes on even when the process ends again before it was let go on.
        let mut mender = Mender::new("a", &running(7, 0), &seen("ACTIVE"));
        assert!(mender.look(&running(8, 1), &back));
        mender.owed = false;
        assert!(!mender.look(&running(8, 1), &back) && mender.last_seen.ran("a/leg"));
        back.components.insert("a/leg".into(), component("a/leg", "STOPPED{requested}", "none"));
        assert!(!mender.look(&running(8, 1), &back) && !mender.last_seen.ran("a/leg"));
    }

    #[test]
    fn what_was_made_and_removed_since_the_file_was_read_is_known() {
        let mut seen = standing(1, 7, &[("a/y", "ACTIVE"), ("a/new", "ACTIVE"), ("b/z", "ACTIVE")]);
        let to_b = ConnectionView {
            id: 3,
            client: "a/new/in".into(),
            server: "b/z/o".into(),
            options: crate::view::OptionsView { fifo: Some(7), ..Default::default() },
            ..Default::default()
        };
        seen.connections.insert(3, to_b.clone());
        seen.connections.insert(4, ConnectionView { id: 4, client: "b/z/i".into(), ..to_b });
        let mut mender = Mender::new("a", &running(7, 0), &seen);
        // A GCM that has not heard of b again yet: the connection to it is still remembered.
        assert!(!mender.look(&running(7, 0), &Standing { term: 2, connections: BTreeMap::new(), ..seen }));
        let paths: Vec<String> = mender.should_have(&file()).iter().map(ToString::to_string).collect();
        assert_eq!(paths, ["a/y", "a/new"], "not what somebody removed");
        let connects: Vec<Request> = mender.requests(&file()).into_iter().skip(2).collect();
        let [Request::Connect { client, server, options }] = &connects[..] else { panic!("{connects:?}") };
        assert_eq!((client.to_string(), server.to_string()), ("a/new/in".to_owned(), "b/z/o".to_owned()));
        assert!(
            matches!(options.queue, Some(trocar_model::Queue::Fifo { depth: 7, .. })),
            "as it was made: {options:?}"
        );
    }
}
