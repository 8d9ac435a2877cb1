//! Number of processes in which a file of several runs: components without a process of their own run in the
//! first one.
//!
//! Invariant: only the first part of paths changes; components, connections and settings stay as written.

use serde_json::{Map, Value};

use trocar::system_file::{Problem, SystemFile};

/// First process of the files, which every layout has.
const HOME: &str = "host";
/// Largest number of processes.
pub(super) const MOST: usize = 3;

/// Number of processes that the demo's components are spread over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// 1 to [`MOST`].
    processes: usize,
}

impl Layout {
    pub(super) fn of(processes: usize) -> Layout {
        Layout { processes: processes.clamp(1, MOST) }
    }

    pub(super) fn processes(self) -> usize {
        self.processes
    }

    /// A path as it is in this layout.
    pub(super) fn place(self, path: &str) -> String {
        match path.split_once('/') {
            Some((process, rest)) if !self.has_process(process) => format!("{HOME}/{rest}"),
            _ => path.to_owned(),
        }
    }

    /// Tells whether there is such a process: OCT is the third one, that which moves the tool is the second.
    fn has_process(self, process: &str) -> bool {
        match process {
            HOME => true,
            "oct" => self.processes > 2,
            _ => self.processes > 1,
        }
    }

    /// The system file in this layout.
    ///
    /// # Errors
    /// It is no system file.
    pub(super) fn file(self, name: &str, text: &str) -> Result<SystemFile, Problem> {
        let mut json: Value = serde_json::from_str(text).unwrap_or_default();
        if let Some(processes) = json["processes"].as_object_mut() {
            processes.retain(|process, _| self.has_process(process));
        }
        if let Some(components) = json["components"].as_object_mut() {
            let placed: Map<String, Value> = std::mem::take(components)
                .into_iter()
                .map(|(path, value)| (self.place(&path), value))
                .collect();
            *components = placed;
            for component in components.values_mut() {
                if let Some(of) = component.pointer_mut("/execution/stream_of") {
                    *of = self.place(of.as_str().unwrap_or_default()).into();
                }
            }
        }
        for connection in json["connections"].as_array_mut().into_iter().flatten() {
            for end in ["client", "server"] {
                connection[end] = self.place(connection[end].as_str().unwrap_or_default()).into();
            }
        }
        SystemFile::parse(name, format!("{json:#}"))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::behavior::Behavior;
    use super::*;
    use clap::ValueEnum;

    #[test]
    fn every_behaviour_is_a_file_of_one_to_three_processes_and_only_where_things_are_differs() {
        for behavior in Behavior::value_variants() {
            let file = |n| Layout::of(n).file("demo.json", behavior.system()).unwrap();
            let parts = |file: &SystemFile| -> Vec<_> {
                let mut all: Vec<_> = file
                    .components
                    .iter()
                    .map(|c| (c.id.component.to_string(), c.class.clone(), c.config.clone()))
                    .collect();
                all.sort_by(|a, b| a.0.cmp(&b.0));
                all
            };
            let written = SystemFile::parse("demo.json", behavior.system().to_owned()).unwrap();
            for n in 1..=MOST {
                let placed = file(n);
                assert_eq!(placed.processes.len(), n, "{behavior:?}");
                assert_eq!(parts(&placed), parts(&written), "{behavior:?} in {n} processes");
                assert_eq!(placed.connections.len(), written.connections.len());
            }
            file(1).single_process().unwrap();
            for part in behavior.commander().into_iter().chain([behavior.leader()]) {
                assert!(file(3).components.iter().any(|c| c.id.to_string() == part), "{behavior:?}: {part}");
            }
        }
    }

    #[test]
    fn with_two_processes_whoever_moves_the_tool_is_apart() {
        let two = Layout::of(2);
        let placed =
            ["robot/robot/arm", "hand/hand", "oct/source", "host/display"].map(|path| two.place(path));
        assert_eq!(placed, ["robot/robot/arm", "hand/hand", "host/source", "host/display"]);
    }
}
