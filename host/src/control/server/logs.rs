//! Log lines: first the kept ones, then, for followers, the new ones.

use tokio::sync::{OwnedSemaphorePermit, broadcast, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;
use trocar_model::{ComponentId, Name, Pattern, Refusal, SystemGraph};
use trocar_proto::v1;

use crate::control::convert;
use crate::gcm::Lines;
use crate::lcm::LogLine;

/// Lines one caller may have waiting.
const WAITING: usize = 256;

/// Which lines are wanted.
pub(super) struct Wanted {
    place: Place,
    /// Most detailed level, 1 error … 5 trace.
    level: u32,
}

enum Place {
    Everywhere,
    /// A process or component, and what is below it.
    At(String),
    Glob {
        pattern: Pattern,
        /// The process whose own lines belong to it, "" = none.
        process: String,
    },
}

impl Wanted {
    pub(super) fn parse(path: &str, level: &str) -> Result<Wanted, Refusal> {
        let level = convert::level(level).ok_or_else(|| Refusal::ArgumentInvalid {
            what: format!("level \"{level}\""),
            why: "it is not one of error, warn, info, debug, trace".into(),
            field: "level".into(),
        })?;
        let place = if path.is_empty() || path == "**" {
            Place::Everywhere
        } else if path.contains('*') {
            let process = path.strip_suffix("/**").unwrap_or_default().to_owned();
            Place::Glob { pattern: Pattern::parse(path)?, process }
        } else if path.contains('/') {
            Place::At(ComponentId::parse(path)?.to_string())
        } else {
            Place::At(Name::parse(path)?.to_string())
        };
        Ok(Wanted { place, level })
    }

    /// Refuses the name of a process or component that neither exists nor has left a line.
    pub(super) fn names_somebody(&self, graph: Option<&SystemGraph>, lines: &Lines) -> Result<(), Refusal> {
        let (Place::At(place), Some(graph)) = (&self.place, graph) else { return Ok(()) };
        if lines.tail().0.iter().any(|line| self.comes_from(line)) {
            return Ok(());
        }
        let processes = || graph.processes.keys().cloned().collect();
        match ComponentId::parse(place) {
            Ok(id) if graph.components.contains_key(&id) => Ok(()),
            Ok(id) if graph.processes.contains_key(&id.process) => {
                Err(Refusal::ComponentNotFound { id, known: graph.components.keys().cloned().collect() })
            }
            Ok(id) => Err(Refusal::ProcessNotFound { process: id.process, known: processes() }),
            Err(_) => match Name::parse(place) {
                Ok(process) if !graph.processes.contains_key(&process) => {
                    Err(Refusal::ProcessNotFound { process, known: processes() })
                }
                _ => Ok(()),
            },
        }
    }

    fn wants(&self, line: &LogLine) -> bool {
        self.comes_from(line) && line.level <= self.level
    }

    fn comes_from(&self, line: &LogLine) -> bool {
        match &self.place {
            Place::Everywhere => true,
            Place::At(place) => line
                .path
                .strip_prefix(place.as_str())
                .is_some_and(|rest| rest.is_empty() || rest.starts_with('/')),
            Place::Glob { pattern, process } => {
                line.path == *process || ComponentId::parse(&line.path).is_ok_and(|id| pattern.matches(&id))
            }
        }
    }
}

/// The stream of lines: of the kept ones the `last`, 0 = all. It ends after those, unless it follows, for
/// which it has a place.
pub(super) fn stream(
    lines: &Lines,
    wanted: Wanted,
    follows: Option<OwnedSemaphorePermit>,
    last: u32,
) -> ReceiverStream<Result<v1::LogsResponse, Status>> {
    let (kept, mut live) = lines.tail();
    let (tell, told) = mpsc::channel(WAITING);
    tokio::spawn(async move {
        let mut skipped = 0;
        let kept: Vec<LogLine> = kept.into_iter().filter(|line| wanted.wants(line)).collect();
        let newest = if last == 0 { kept.len() } else { kept.len().min(last as usize) };
        let older = kept.len() - newest;
        for line in kept.into_iter().skip(older) {
            if tell.send(Ok(response(line, 0))).await.is_err() {
                return;
            }
        }
        let Some(_held) = follows else { return };
        loop {
            let heard = tokio::select! {
                () = tell.closed() => return,
                heard = live.recv() => heard,
            };
            match heard {
                Ok(line) if wanted.wants(&line) => {
                    if tell.send(Ok(response(line, skipped))).await.is_err() {
                        return;
                    }
                    skipped = 0;
                }
                Ok(_) => {}
                Err(broadcast::error::RecvError::Lagged(n)) => skipped += n,
                Err(broadcast::error::RecvError::Closed) => return,
            }
        }
    });
    ReceiverStream::new(told)
}

fn response(line: LogLine, skipped: u64) -> v1::LogsResponse {
    v1::LogsResponse { line: Some(convert::line(line)), skipped }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn wants(path: &str, line: &str) -> bool {
        let line = LogLine {
            wall_ns: 0,
            level: 3,
            path: line.into(),
            target: String::new(),
            message: String::new(),
        };
        Wanted::parse(path, "").unwrap().wants(&line)
    }

    #[test]
    fn a_path_means_whole_names() {
        assert!(wants("", "host/robot"));
        assert!(wants("host", "host") && wants("host", "host/robot") && wants("host/robot", "host/robot"));
        assert!(!wants("host/rob", "host/robot"), "half a name is no name");
        assert!(!wants("ho", "host"), "half a name is no name");
        assert!(wants("host/**", "host") && wants("host/**", "host/robot") && !wants("host/**", "gui/robot"));
        assert!(wants("host/rob*", "host/robot") && !wants("host/rob*", "host/ascan"));
    }

    #[test]
    fn a_malformed_path_or_level_is_refused() {
        assert!(matches!(Wanted::parse("/host", "").err(), Some(Refusal::BadPath { .. })));
        let Some(Refusal::ArgumentInvalid { field, .. }) = Wanted::parse("", "loud").err() else {
            panic!("loud is no level");
        };
        assert_eq!(field, "level");
    }
}
