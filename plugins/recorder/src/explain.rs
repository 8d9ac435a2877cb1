//! What makes a recording explain itself: the graph as it is and each change of it, configurations, plugins.
//!
//! Invariant: what is told in the file is what the GCM said, word by word; a graph that did not change is not told again, and one in
//! which only a state or a health did is another one.

use std::collections::{BTreeMap, BTreeSet};

use trocar_sdk::serde_json::{Value as Json, json};

use crate::block::{Kind, Way};
use crate::orders::Order;
use crate::topic::Link;

/// How long the first answer is waited for, ns: without a GCM a recording begins all the same.
const PATIENCE_NS: u64 = 5_000_000_000;

/// The graph as it was last told.
#[derive(Default)]
pub(crate) struct Explaining {
    /// Numbers of the channels.
    pub(crate) graph: u32,
    pub(crate) config: u32,
    since_ns: u64,
    /// Incarnation of the GCM, and its revision of the graph.
    revision: Option<(u64, u64)>,
    /// Names of classes, and what their plugins are.
    classes: BTreeSet<String>,
    /// Path, class and incarnation of the process of what was there when classes were told last: what is made later may be of
    /// another plugin file.
    made: BTreeSet<(String, String, u64)>,
    plugins: BTreeMap<String, String>,
    /// The whole answer, for recordings that begin later.
    last: Json,
    configs: BTreeMap<String, Json>,
}

/// An input, and what it is connected to.
pub(crate) struct Connected {
    pub(crate) input: String,
    pub(crate) server: String,
    /// None where its process is away.
    pub(crate) link: Option<Link>,
}

fn number(value: &Json, key: &str) -> u64 {
    let value = &value[key];
    value.as_u64().or_else(|| value.as_str().and_then(|text| text.parse().ok())).unwrap_or(0)
}

/// Incarnation of the GCM that answered, and its revision of the graph.
pub(crate) fn revision(graph: &Json) -> (u64, u64) {
    (number(graph, "term"), number(graph, "revision"))
}

fn text<'a>(value: &'a Json, key: &str) -> &'a str {
    value[key].as_str().unwrap_or_default()
}

impl Explaining {
    /// Whether the graph is known, or was waited for long enough.
    pub(crate) fn is_told(&mut self, now_ns: u64) -> bool {
        if self.since_ns == 0 {
            self.since_ns = now_ns;
        }
        self.revision.is_some() || now_ns.saturating_sub(self.since_ns) > PATIENCE_NS
    }

    /// Answers may overtake each other: an older one is no news.
    pub(crate) fn is_news(&self, graph: &Json) -> bool {
        self.revision.is_none_or(|known| known <= revision(graph))
    }

    /// Inputs of `who`, and what is connected to each.
    pub(crate) fn connected(&self, graph: &Json, who: &str) -> Vec<Connected> {
        let all = |key: &str| graph[key].as_array().into_iter().flatten();
        let attached = all("processes").filter(|p| text(p, "state") == "PROCESS_STATE_ATTACHED");
        let epochs: BTreeMap<&str, u64> = attached.map(|p| (text(p, "name"), number(p, "epoch"))).collect();
        let (term, _) = revision(graph);
        all("connections")
            .filter_map(|connection| {
                let input = text(connection, "client").strip_prefix(who)?.strip_prefix('/')?;
                let server = text(connection, "server");
                let epoch = server.split('/').next().and_then(|process| epochs.get(process));
                let link = epoch.map(|epoch| Link { id: number(connection, "id"), epoch: *epoch, term });
                Some(Connected { input: input.to_owned(), server: server.to_owned(), link })
            })
            .collect()
    }

    /// Whether an answer told of all the classes its processes have, and of the files that its components were made from.
    pub(crate) fn knows_classes(&mut self, graph: &Json) -> bool {
        let all = |key: &str| graph[key].as_array().into_iter().flatten();
        let names = all("processes").flat_map(|process| process["classes"].as_array().into_iter().flatten());
        let names: BTreeSet<&str> = names.filter_map(Json::as_str).collect();
        // Those of a process that is gone are still what made the samples it sent.
        let epochs: BTreeMap<&str, u64> =
            all("processes").map(|p| (text(p, "name"), number(p, "epoch"))).collect();
        let made: BTreeSet<(String, String, u64)> = all("components")
            .map(|component| {
                let path = text(component, "path");
                let process = path.split('/').next().unwrap_or_default();
                let epoch = epochs.get(process).copied().unwrap_or(0);
                (path.to_owned(), text(component, "class").to_owned(), epoch)
            })
            .collect();
        if all("classes").next().is_some() {
            self.classes.extend(names.iter().map(|name| (*name).to_owned()));
            self.made = made;
            return true;
        }
        self.made.retain(|known| made.contains(known));
        names.is_empty()
            || names.iter().all(|name| self.classes.contains(*name)) && self.made.len() == made.len()
    }

    /// News of the GCM: told when it is another graph than the last.
    pub(crate) fn graph_is(&mut self, mut graph: Json, now_ns: u64, way: &mut Way) {
        self.revision = Some(revision(&graph));
        let classes = graph["classes"].as_array().into_iter().flatten();
        let of = |class| format!("{} sha256:{}", text(class, "version"), text(class, "hash"));
        let plugins = classes.map(|class| (text(class, "plugin").to_owned(), of(class)));
        let before = self.plugins.clone();
        self.plugins.extend(plugins);
        if self.plugins != before {
            way.order(Order::Metadata("trocar.plugins".into(), self.plugins.clone()));
        }
        // What classes could be is no part of what is: a recording is told their plugins. Nor is by what the answer is known.
        if let Some(told) = graph.as_object_mut() {
            told.remove("classes");
            told.remove("etag");
        }
        // What was accepted and changed nothing is no change of it.
        if ["processes", "components", "connections"].iter().all(|part| self.last[part] == graph[part]) {
            return;
        }
        self.last = graph;
        tell(self.graph, &self.last, now_ns, way);
        // Of components that are gone there is nothing to tell in recordings to come.
        let there = self.last["components"].as_array().into_iter().flatten().map(|c| text(c, "path"));
        let there: BTreeSet<&str> = there.collect();
        self.configs.retain(|path, _| there.contains(path.as_str()));
        for component in self.last["components"].as_array().into_iter().flatten() {
            let (path, config) = (text(component, "path").to_owned(), component["config"].clone());
            if self.configs.get(&path) != Some(&config) {
                tell(self.config, &json!({ "path": path, "config": config }), now_ns, way);
                self.configs.insert(path, config);
            }
        }
    }

    /// A recording begins: what is known stands in it as a record of its own.
    pub(crate) fn begin(&mut self, now_ns: u64, way: &mut Way) {
        let graph = BTreeMap::from([
            ("json".to_owned(), self.last.to_string()),
            ("monotonic_ns".to_owned(), now_ns.to_string()),
        ]);
        way.order(Order::Metadata("trocar.graph".into(), graph));
    }

    /// Tells the graph and all configurations as they are.
    pub(crate) fn repeat(&mut self, now_ns: u64, way: &mut Way) {
        if self.last.is_null() {
            return;
        }
        tell(self.graph, &self.last, now_ns, way);
        for (path, config) in &self.configs {
            tell(self.config, &json!({ "path": path, "config": config }), now_ns, way);
        }
    }
}

fn tell(channel: u32, what: &Json, now_ns: u64, way: &mut Way) {
    let told = what.to_string();
    way.block().push((channel, 0, now_ns, now_ns), Kind::Ready, |to| to.extend_from_slice(told.as_bytes()));
}
