//! Apply of a whole system file, and Save.
//!
//! Invariant: `system_file` understands the file's content, which is only passed on here; a process that does
//! not tell its plugin directories delays nobody beyond the deadline.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use tonic::{Request, Status};
use trocar_model::{Name, Refusal};
use trocar_proto::v1;

use super::gcm::{options, skipped, told};
use super::identity::identity;
use super::{Edge, refuse};
use crate::control::convert::Common;
use crate::control::deadline::deadline;
use crate::gcm::plan_lines;

impl Edge {
    pub(super) async fn apply_system(
        &self,
        request: Request<v1::ApplyRequest>,
    ) -> Result<v1::ApplyResponse, Status> {
        let (until, identity) = (deadline(&request), identity(&request));
        let r = request.into_inner();
        let bad = |why: &str, field: &str| {
            refuse(Refusal::ArgumentInvalid { what: "Apply".into(), why: why.into(), field: field.into() })
        };
        if r.system.is_empty() {
            return Err(bad("prune is for the text of a system file: give that in system", "prune"));
        }
        if !r.steps.is_empty() {
            return Err(bad("it has steps and the text of a system file: give one of them", "system"));
        }
        let common = Common {
            validate_only: r.validate_only,
            request_id: r.request_id,
            expected_revision: r.expected_revision,
        };
        let (gcm, options) = (self.gcm()?.clone(), options(common, until, identity));
        let change = async move { gcm.apply_system(&r.system, r.prune, options).await };
        let done = self.carried_out(change, until).await?;
        Ok(v1::ApplyResponse {
            revision: done.revision,
            plan: plan_lines(&done.plan),
            components: told(&done),
            skipped: skipped(&done),
            warnings: self.warnings(&done),
        })
    }

    pub(super) async fn saved(&self, request: Request<v1::SaveRequest>) -> Result<v1::SaveResponse, Status> {
        let (until, gcm) = (deadline(&request), self.gcm()?.clone());
        let folder = request.into_inner().folder;
        let (plugins, _) = self.plugins("", None, until).await?;
        let mut dirs: BTreeMap<Name, BTreeSet<PathBuf>> = BTreeMap::new();
        for plugin in plugins {
            // A plugin that is linked into a program has no file.
            let dir = Path::new(&plugin.file).parent().filter(|dir| !dir.as_os_str().is_empty());
            if let (Ok(process), Some(dir)) = (plugin.process.parse(), dir) {
                dirs.entry(process).or_default().insert(dir.to_owned());
            }
        }
        let (revision, text, notes) = gcm.save(Path::new(&folder), &dirs);
        Ok(v1::SaveResponse { revision, text, notes })
    }
}
