//! A running system as a system file would say it.
//!
//! Invariant: pure. What a class fills in by itself is left out, so the file makes the same system again and
//! reads as if written by hand; what cannot be said in a file is told beside it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use trocar_model::{
    Component, ComponentId, ConnectOptions, Connection, Name, PortId, PortType, ProcessState, Programs,
    State, StopReason, SystemGraph, default_max_age, least_execution, without_defaults,
};

use super::write::Picture;
use super::{ComponentSpec, ConnectionSpec, ProcessSpec};

/// A system as its GCM sees it, and what it knows beside the graph.
#[derive(Debug)]
pub struct Running<'a> {
    pub graph: &'a SystemGraph,
    /// Components that come and go with a program, such as recorders of `trocar record`.
    pub held: &'a BTreeSet<ComponentId>,
    /// Plugin directories of each process, as far as it told them.
    pub plugins: &'a BTreeMap<Name, BTreeSet<PathBuf>>,
}

/// Settings of processes and components that a GCM is not told.
const NOT_KNOWN: &str = "the GCM does not know these settings, so the file lacks them: trust, listen, state, env, restart and memory of \
                         processes, resume of components; copy those that the system's own file has";

impl Running<'_> {
    /// The system as a file that lies in `folder` says it, and notes on what such a file does not say.
    pub fn picture(&self, folder: &Path) -> (Picture, Vec<String>) {
        let (graph, mut notes) = (self.graph, Vec::new());
        let guests = graph.processes.iter().filter(|(_, p)| !p.guest.is_empty());
        let guests: BTreeSet<&Name> = guests.map(|(name, _)| name).collect();
        if !guests.is_empty() {
            let names: Vec<&str> = guests.iter().map(|name| name.as_str()).collect();
            notes.push(format!("guests are not in it, they join by themselves: {}", names.join(", ")));
        }
        let isolated: BTreeSet<&Name> =
            graph.components.keys().filter(|id| home(graph, id).is_some()).map(|id| &id.process).collect();
        let ours = graph.processes.keys().filter(|name| !guests.contains(*name) && !isolated.contains(*name));
        let processes: Vec<ProcessSpec> = ours.map(|name| self.process(name, folder, &mut notes)).collect();
        let held = self.held.iter().filter(|id| graph.components.contains_key(*id));
        let held: Vec<String> = held.map(ToString::to_string).collect();
        if !held.is_empty() {
            let held = held.join(", ");
            notes.push(format!("what programs hold is not in it, it comes and goes with them: {held}"));
        }
        if !processes.is_empty() {
            notes.push(NOT_KNOWN.to_owned());
        }
        let stays = |id: &ComponentId| !guests.contains(&id.process) && !self.held.contains(id);
        let inside = graph.components.iter().filter(|(id, _)| stays(id));
        let mut components: Vec<ComponentSpec> = inside.map(|(id, c)| self.component(id, c)).collect();
        components.sort_by(|a, b| a.written.cmp(&b.written));
        notes.extend(relative_paths(&components));
        let mut between: Vec<&Connection> = graph.connections.values().collect();
        between.retain(|c| stays(&c.client.component) && stays(&c.server.component));
        // An output without a type is what the first input with one makes of it.
        between.sort_by_key(|c| is_untyped(graph, &c.client));
        let connections = between.into_iter().map(|c| connection(graph, c)).collect();
        (Picture { processes, components, connections, ..Picture::default() }, notes)
    }

    fn process(&self, name: &Name, folder: &Path, notes: &mut Vec<String>) -> ProcessSpec {
        let mut spec = ProcessSpec::new(name.clone());
        let offered = self.graph.processes.get(name).into_iter().flat_map(|process| &process.classes);
        spec.allow_exec = offered.into_iter().any(|class| class.programs == Programs::Allowed);
        match self.plugins.get(name) {
            Some(dirs) => spec.plugins = dirs.iter().map(|dir| relative(dir, folder)).collect(),
            None if self.graph.processes.get(name).is_some_and(|p| p.state != ProcessState::Attached) => {
                notes.push(format!("process {name} is not there to tell its plugin directories: add them"));
            }
            None => notes.push(format!("process {name} does not tell its plugin directories: add them")),
        }
        spec
    }

    fn component(&self, id: &ComponentId, c: &Component) -> ComponentSpec {
        let home = home(self.graph, id);
        let isolated = home.is_some();
        let written = home.map_or_else(|| id.clone(), |home| ComponentId::new(home, id.component.clone()));
        let config = without_defaults(&c.class.config_schema, &c.config);
        // A component in CREATED has an incomplete one, which is not taken when it is given.
        let given =
            c.state != State::Created && config.as_object().is_none_or(|settings| !settings.is_empty());
        ComponentSpec {
            id: id.clone(),
            written,
            resumes: false,
            isolated,
            class: c.class.full_name(),
            config: given.then_some(config),
            execution: least_execution(&c.class.execution, &c.execution),
            start: runs(c.state),
        }
    }
}

/// Names the settings with a relative path of a file. Such a path counts from where the host was started, but
/// in a system file from the folder of that file.
fn relative_paths(components: &[ComponentSpec]) -> Option<String> {
    let is_path = |key: &str| {
        let last = key.rsplit('_').next().unwrap_or(key);
        matches!(last, "path" | "file" | "directory" | "dir" | "folder")
    };
    let mut found = Vec::new();
    for component in components {
        for (key, value) in component.config.iter().flat_map(|config| config.as_object()).flatten() {
            let text = value.as_str().filter(|text| !text.is_empty() && Path::new(text).is_relative());
            found.extend(
                text.filter(|_| is_path(key)).map(|text| format!("{}.{key} = {text:?}", component.written)),
            );
        }
    }
    (!found.is_empty()).then(|| {
        format!(
            "relative paths count from where the hosts were started; in the file they will count from where it lies: {}",
            found.join(", ")
        )
    })
}

/// Returns the process that served as the model for this component's own process; `None`: the component lives
/// where others may.
pub(super) fn home(graph: &SystemGraph, id: &ComponentId) -> Option<Name> {
    let name = id.process.as_str().strip_suffix(id.component.as_str())?.strip_suffix('.')?;
    let home: Name = name.parse().ok()?;
    let (like, its) = (graph.processes.get(&home)?, graph.processes.get(&id.process)?);
    // A process that was called so by a person has other plugins, and one of the other name may be
    // there as well.
    let is_like = like.state != ProcessState::Attached
        || its.state != ProcessState::Attached
        || like.classes.len() == its.classes.len()
            && like.classes.iter().zip(&its.classes).all(|(a, b)| a.full_name() == b.full_name());
    let written = ComponentId::new(home.clone(), id.component.clone());
    let first = ComponentId::new(id.process.clone(), "A".parse().ok()?);
    let alone =
        graph.components.range(first..).take_while(|(other, _)| other.process == id.process).count() == 1;
    (is_like && alone && !graph.components.contains_key(&written)).then_some(home)
}

/// Tells whether this input takes any type.
fn is_untyped(graph: &SystemGraph, client: &PortId) -> bool {
    let ports = graph.components.get(&client.component).map(|c| &c.ports);
    let input = ports.and_then(|ports| ports.inputs.iter().find(|i| client.port == i.name.as_str()));
    input.is_some_and(|input| matches!(input.ty, PortType::Any))
}

/// Tells whether a component runs, or did until something came between.
fn runs(state: State) -> bool {
    match state {
        State::Created | State::Ready | State::Stopped(StopReason::Requested) => false,
        State::Active | State::Fault | State::Stopped(_) => true,
    }
}

fn connection(graph: &SystemGraph, c: &Connection) -> ConnectionSpec {
    let usual = c.options.max_age_ns == default_max_age(graph, c);
    let max_age_ns = c.options.max_age_ns.filter(|_| !usual);
    let options = ConnectOptions { max_age_ns, replace: false, ..c.options.clone() };
    ConnectionSpec { client: c.client.clone(), server: c.server.clone(), options }
}

/// A directory as a file in `folder` names it.
fn relative(dir: &Path, folder: &Path) -> PathBuf {
    match dir.strip_prefix(folder) {
        Ok(inside) if folder.as_os_str().is_empty() => inside.to_owned(),
        Ok(inside) if inside.as_os_str().is_empty() => PathBuf::from("."),
        Ok(inside) => inside.to_owned(),
        Err(_) => dir.to_owned(),
    }
}
