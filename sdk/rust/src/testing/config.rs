//! Which settings of a running component may change.
//!
//! Invariant: the rule is the host's: a setting that is not declared `live` stays as it was configured.

use serde_json::{Map, Value as Json};
use trocar_plugin_api::desc::ClassDesc;

/// Why a started component is not configured so; none when only live settings differ.
pub(crate) fn fixed_change(
    class: &ClassDesc,
    now: &Map<String, Json>,
    wanted: &Map<String, Json>,
) -> Option<String> {
    let fixed = class.config.iter().find(|f| !f.live && !same(now.get(f.name), wanted.get(f.name)))?;
    let live: Vec<&str> = class.config.iter().filter(|f| f.live).map(|f| f.name).collect();
    let live =
        if live.is_empty() { "no setting is".to_string() } else { format!("live are {}", live.join(", ")) };
    Some(format!("{}: is not live, so it cannot change while the component runs; {live}", fixed.name))
}

/// 1 and 1.0 are the same setting.
fn same(a: Option<&Json>, b: Option<&Json>) -> bool {
    match (a.and_then(Json::as_f64), b.and_then(Json::as_f64)) {
        (Some(a), Some(b)) => a == b,
        _ => a == b,
    }
}
