//! Journals that releases wrote, in `tests/data/golden/VERSION`: each later release reads them as they were.
//!
//! `TROCAR_BLESS=1` writes the texts anew, and a journal only for a version that has none: one that was
//! written once is never written again.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use trocar_model::Wanted;

use super::super::{FILE, RedbStore, View, json as record_json};
use super::{fold, kinds, loaded};
use crate::gcm::Store;

const RECORDS: &str = "journal.jsonl";
const FOLD: &str = "wanted.json";

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/golden")
}

fn blesses() -> bool {
    std::env::var_os("TROCAR_BLESS").is_some()
}

#[test]
fn journals_of_every_release_are_read_as_they_were_written() {
    let here = folder().join(env!("CARGO_PKG_VERSION"));
    if blesses() && !here.join(FILE).exists() {
        fs::create_dir_all(&here).unwrap();
        write(&here);
    }
    let versions: Vec<PathBuf> = fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(versions.contains(&folder().join("0.1.0")), "{versions:?}");
    for version in versions {
        let dir = tempfile::tempdir().unwrap();
        fs::copy(version.join(FILE), dir.path().join(FILE)).unwrap();
        let view = View::open(dir.path()).unwrap();
        view.verify().unwrap();
        let mut lines = String::new();
        view.records(0, &mut |kept| {
            lines += &format!("{}\n", record_json(&kept));
            true
        })
        .unwrap();
        let wanted = format!("{:#}\n", said(&fold(&loaded(dir.path()))));
        for (name, now) in [(RECORDS, lines), (FOLD, wanted)] {
            let file = version.join(name);
            if blesses() {
                fs::write(&file, &now).unwrap();
            }
            assert_eq!(now, fs::read_to_string(&file).unwrap_or_default(), "{}", file.display());
        }
    }
}

/// Writes a journal with each kind of entry and answer.
fn write(dir: &Path) {
    let records = kinds::records();
    let mut store = RedbStore::new(dir);
    store.load().unwrap();
    store.append(&records[..2]).unwrap();
    store.append(&records[2..8]).unwrap();
    store.keep(&kinds::snapshot(&records[..8])).unwrap();
    store.append(&records[8..]).unwrap();
}

/// The fold as a text that stays when types get more fields.
fn said(wanted: &Wanted) -> Value {
    let components = wanted.components.iter().map(|(id, c)| {
        let grant = c.grant.map(|grant| {
            json!([grant.verb.to_string(), grant.revision, grant.decision, grant.epoch])
        });
        let class = json!([c.class.full_name(), c.class.config_schema]);
        let period_ns = c.execution.period_ns;
        let state = c.state.to_string();
        let fields = json!({ "class": class, "config": c.config, "period_ns": period_ns, "state": state, "grant": grant });
        (id.to_string(), fields)
    });
    let connections = wanted.connections.values();
    let connections =
        connections.map(|c| json!([c.id.0, c.client.to_string(), c.server.to_string(), c.options.delay]));
    let processes = wanted
        .processes
        .iter()
        .map(|(name, it)| (name.to_string(), json!([format!("{:032x}", it.instance), it.epoch])));
    json!({
        "revision": wanted.revision,
        "term": wanted.term,
        "next_connection": wanted.next_connection,
        "decision": wanted.decision,
        "components": components.collect::<serde_json::Map<_, _>>(),
        "connections": connections.collect::<Vec<_>>(),
        "processes": processes.collect::<serde_json::Map<_, _>>(),
    })
}
