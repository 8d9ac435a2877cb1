//! The journal of a GCM as `trocar journal` tells it.
//!
//! Invariant: read as anybody could read it, from the file, whatever becomes of the GCM.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::files;
use crate::json::number;
use crate::world::World;

pub(crate) struct Journal {
    pub(crate) records: Vec<Value>,
}

impl Journal {
    /// Reads all records of the journal in that directory, which `verify` has found whole.
    pub(crate) fn read(world: &World, dir: &Path) -> Result<Journal, String> {
        said(world, &["journal", "verify", "--state", &dir.to_string_lossy()])?;
        let text = said(world, &["journal", "show", "--json", "--state", &dir.to_string_lossy()])?;
        let records: Result<Vec<Value>, _> = serde_json::Deserializer::from_str(&text).into_iter().collect();
        Ok(Journal { records: records.map_err(|e| format!("`trocar journal show --json`: {e}"))? })
    }

    /// The numbers follow each other, terms and revisions never go back, and of two requests that changed
    /// something the later one has the higher revision.
    pub(crate) fn grows(&self) -> Result<(), String> {
        let mut before: Option<(u64, u64)> = None;
        let (mut revision, mut changed) = (0, 0);
        for record in &self.records {
            let now = (number(&record["number"]), number(&record["term"]));
            if let Some((last, term)) = before
                && (now.0 != last + 1 || now.1 < term)
            {
                return Err(format!("record {last} of term {term} comes before {record}"));
            }
            before = Some(now);
            let Some(of_this) = record["revision"].as_u64() else { continue };
            if of_this < revision {
                return Err(format!("revision {revision} is followed by {record}"));
            }
            revision = of_this;
            if record["entry"] == "changed" && record["asked"].is_object() {
                if of_this <= changed {
                    return Err(format!("revision {changed} is given again in {record}"));
                }
                changed = of_this;
            }
        }
        if before.is_some() { Ok(()) } else { Err("there is no record".into()) }
    }

    /// The records of each request that had an id.
    pub(crate) fn by_request(&self) -> BTreeMap<&str, Vec<&Value>> {
        let mut by_request: BTreeMap<&str, Vec<&Value>> = BTreeMap::new();
        for record in &self.records {
            if let Some(id) = record["asked"]["request_id"].as_str().filter(|id| !id.is_empty()) {
                by_request.entry(id).or_default().push(record);
            }
        }
        by_request
    }
}

/// Standard output of `trocar` when it ends well.
pub(crate) fn said(world: &World, args: &[&str]) -> Result<String, String> {
    let mut command = Command::new(files::built("trocar")?);
    command.args(args).env_remove("TROCAR_GCM").env("XDG_STATE_HOME", world.path("xdg-state"));
    let ended = command.current_dir(world.root()).output().map_err(|e| format!("trocar: {e}"))?;
    if !ended.status.success() {
        let told = String::from_utf8_lossy(&ended.stderr).into_owned();
        return Err(format!("`trocar {}` ended with {}: {told}", args.join(" "), ended.status));
    }
    String::from_utf8(ended.stdout).map_err(|e| format!("`trocar {}`: {e}", args.join(" ")))
}
