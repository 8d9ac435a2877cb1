//! Questions of a recording to a system: which outputs there are, and which components can record them.
//!
//! Invariant: nothing here changes a system; making, connecting and removing go through the verbs that every
//! subcommand uses.

use trocar_proto::v1;

use super::Session;
use crate::failure::Failure;

/// Something that can be recorded.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Source {
    /// process/component/output.
    pub(crate) path: String,
    /// True: the output gives frames.
    pub(crate) frames: bool,
    /// Bytes of a sample, or of the header of a frame.
    pub(crate) size: u32,
}

/// A system, as far as a recording needs to know it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sources {
    pub(crate) all: Vec<Source>,
    /// Processes with a class that records, and its name there.
    pub(crate) recorders: Vec<String>,
}

impl Session {
    /// Every output of every component.
    pub(crate) async fn sources(&self, class: &str) -> Result<Sources, Failure> {
        let mut gcm = self.client().await?.gcm;
        let ask = v1::ListRequest { brief: true, ..v1::ListRequest::default() };
        let there = gcm.list(ask).await.map_err(|s| self.failed(&s))?.into_inner();
        let has = |process: &&v1::Process| process.classes.iter().any(|other| other == class);
        let recorders = there.processes.iter().filter(has).map(|process| process.name.clone()).collect();
        let mut all = Vec::new();
        for component in &there.components {
            let ask = v1::DescribeRequest { path: component.path.clone(), ..Default::default() };
            // A component that went away meanwhile is not there to be recorded.
            let Ok(told) = gcm.describe(ask).await else { continue };
            for output in told.into_inner().ports.unwrap_or_default().outputs {
                let path = format!("{}/{}", component.path, output.name);
                let (frames, size) = match output.r#type.and_then(|ty| ty.kind) {
                    Some(v1::port_type::Kind::Plain(ty)) => (false, ty.size),
                    Some(v1::port_type::Kind::Frame(frame)) => (true, frame.header.map_or(0, |h| h.size)),
                    // A port without a type of its own takes the type of its connection: there is
                    // none to record.
                    Some(v1::port_type::Kind::Any(_)) | None => continue,
                };
                all.push(Source { path, frames, size });
            }
        }
        Ok(Sources { all, recorders })
    }
}
