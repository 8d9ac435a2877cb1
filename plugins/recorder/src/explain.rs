//! Everything that makes a recording explain itself: the graph as it is and each change of it,
//! configurations, plugins.
//!
//! Invariant: the file holds what the GCM said, word by word. A graph that did not change is not told again;
//! one in which only a state or a health changed counts as changed.

use std::collections::{BTreeMap, BTreeSet};

use trocar_sdk::serde_json::{Value as Json, json};

use crate::block::Kind;
use crate::orders::Order;
use crate::topic::Link;
use crate::way::Way;

/// Longest wait for the first answer, ns: without a GCM a recording begins all the same.
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
    /// Path, class and incarnation of the process of each component that was there when classes were told
    /// last: one that is made later may be of another plugin file.
    made: BTreeSet<(String, String, u64)>,
    /// The files that each plugin was of, in whichever process.
    plugins: BTreeMap<String, BTreeSet<String>>,
    /// The whole answer, for recordings that begin later.
    last: Json,
    /// Configurations of components, as they were last told.
    configs: BTreeMap<String, Json>,
    /// `last` as text, while it waits for room to be told; empty = it was told.
    waits: String,
}

/// An input and its source.
pub(crate) struct Connected {
    pub(crate) input: String,
    pub(crate) server: String,
    /// None if no data can come by it.
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

fn elements<'a>(value: &'a Json, key: &str) -> impl Iterator<Item = &'a Json> + use<'a> {
    value[key].as_array().into_iter().flatten()
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

    /// Returns the inputs of `who` with their sources.
    pub(crate) fn connected(graph: &Json, who: &str) -> Vec<Connected> {
        let (term, _) = revision(graph);
        elements(graph, "connections")
            .filter_map(|connection| {
                let input = text(connection, "client").strip_prefix(who)?.strip_prefix('/')?;
                // A connection without halves stays in the process, and goes with it. A process that is not
                // heard for a while may still send: whether data come, its own end here knows.
                let own = |half: &&Json| text(half, "end") == "CONNECTION_END_CLIENT";
                let link = match elements(connection, "proxies").find(own) {
                    None => Some(0),
                    Some(half) => Some(number(half, "epoch")).filter(|epoch| *epoch != 0),
                };
                Some(Connected {
                    input: input.to_owned(),
                    server: text(connection, "server").to_owned(),
                    link: link.map(|epoch| Link { id: number(connection, "id"), epoch, term }),
                })
            })
            .collect()
    }

    /// Whether the GCM hears the process of `who`: what it says of the ends in there is of no worth else.
    pub(crate) fn is_heard(graph: &Json, who: &str) -> bool {
        let own = who.split('/').next();
        elements(graph, "processes").any(|process| {
            process["name"].as_str() == own && text(process, "state") == "PROCESS_STATE_ATTACHED"
        })
    }

    /// Tells whether an answer told of all the classes its processes have, and of the files that its
    /// components were made from.
    pub(crate) fn knows_classes(&mut self, graph: &Json) -> bool {
        let all = |key: &str| elements(graph, key);
        let names = all("processes").flat_map(|process| elements(process, "classes"));
        let names: BTreeSet<&str> = names.filter_map(Json::as_str).collect();
        // Classes of a process that is gone still made the samples it sent.
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
        let mut more = false;
        for class in elements(&graph, "classes") {
            let file = format!("{} sha256:{}", text(class, "version"), text(class, "hash"));
            more |= self.plugins.entry(text(class, "plugin").to_owned()).or_default().insert(file);
        }
        if more {
            let files = |(plugin, files): (&String, &BTreeSet<String>)| {
                (plugin.clone(), files.iter().cloned().collect::<Vec<_>>().join(", "))
            };
            let all = self.plugins.iter().map(files).collect();
            way.order(Order::Metadata("trocar.plugins".into(), all));
        }
        // The list of possible classes is no part of the graph: a recording is told their plugins. The etag,
        // by which the answer is known, is none either.
        if let Some(told) = graph.as_object_mut() {
            told.remove("classes");
            told.remove("etag");
        }
        // An answer without a change in these parts is no change of the graph.
        if ["processes", "components", "connections"].iter().all(|part| self.last[part] == graph[part]) {
            return;
        }
        self.last = graph;
        self.waits = self.last.to_string();
        self.tell_what_waits(now_ns, way);
    }

    /// Tells the graph and the configurations that changed as soon as there is room for them; of several that
    /// waited, the last one.
    pub(crate) fn tell_what_waits(&mut self, now_ns: u64, way: &mut Way) {
        if !self.waits.is_empty() && (way.has_room(self.waits.len()) || way.is_clear()) {
            self.tell_now(now_ns, way);
        }
    }

    fn tell_now(&mut self, now_ns: u64, way: &mut Way) {
        tell(self.graph, &std::mem::take(&mut self.waits), now_ns, way);
        // Components that are gone have nothing to tell in later recordings.
        let there = elements(&self.last, "components").map(|c| text(c, "path"));
        let there: BTreeSet<&str> = there.collect();
        self.configs.retain(|path, _| there.contains(path.as_str()));
        for component in elements(&self.last, "components") {
            let (path, config) = (text(component, "path").to_owned(), component["config"].clone());
            if self.configs.get(&path) != Some(&config) {
                tell(self.config, &json!({ "path": path, "config": config }).to_string(), now_ns, way);
                self.configs.insert(path, config);
            }
        }
    }

    /// Begins a recording: the known graph stands in it as a record of its own.
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
        self.waits = self.last.to_string();
        self.configs.clear();
        self.tell_now(now_ns, way);
    }
}

fn tell(channel: u32, text: &str, now_ns: u64, way: &mut Way) {
    way.block().push((channel, 0, now_ns, now_ns), Kind::Ready, |to| to.extend_from_slice(text.as_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A graph in which `host/rec/a` is connected to `there/sine/value` by a link of this number; without a
    /// number both are in one process.
    fn graph(host: &str, there: &str, link: Option<u64>) -> Json {
        let half = |end: &str, process: &str| json!({ "end": end, "process": process, "epoch": link.map(|n| n.to_string()) });
        let halves = [half("CONNECTION_END_CLIENT", "host"), half("CONNECTION_END_SERVER", "there")];
        json!({
            "term": 3,
            "processes": [{ "name": "host", "state": host, "epoch": "1" }, { "name": "there", "state": there, "epoch": "2" }],
            "connections": [
                { "id": "7", "client": "host/rec/a", "server": "there/sine/value",
                  "proxies": link.map_or(json!([]), |_| json!(halves)) },
                { "id": "8", "client": "host/recorder/a", "server": "there/sine/value" },
            ],
        })
    }

    fn link(graph: &Json) -> Option<u64> {
        let [Connected { input, server, link }] = &Explaining::connected(graph, "host/rec")[..] else {
            panic!("it has one connection: {graph}");
        };
        assert_eq!((input.as_str(), server.as_str()), ("a", "there/sine/value"));
        link.map(|link| link.epoch)
    }

    #[test]
    fn graphs_wait_bounded_while_the_disk_stands_still_and_the_last_one_is_told() {
        let (mut way, received, returns) = crate::way::way(2_000);
        let mut explaining = Explaining { graph: 1, config: 2, ..Explaining::default() };
        for n in 0..1000u64 {
            let path = format!("host/sine{n}");
            let made = json!({ "revision": n + 1, "processes": [], "connections": [],
                "components": [{ "path": path, "config": { "rate": n } }] });
            explaining.graph_is(made, n, &mut way);
        }
        way.send();
        let mut told = Vec::new();
        let mut arrive = || {
            for order in received.try_iter() {
                let Order::Block(block) = order else { continue };
                returns.arrived(&block);
                told.extend(block.messages().map(|(head, [text, _])| {
                    let value: Json = trocar_sdk::serde_json::from_slice(text).expect("it is JSON");
                    (head.channel, value)
                }));
            }
        };
        arrive();
        explaining.tell_what_waits(2000, &mut way);
        explaining.tell_what_waits(2001, &mut way);
        way.send();
        arrive();
        assert!(told.len() < 40, "{} were on their way", told.len());
        let revisions: Vec<u64> = told
            .iter()
            .filter(|(channel, _)| *channel == 1)
            .map(|(_, graph)| number(graph, "revision"))
            .collect();
        assert!(revisions.is_sorted() && revisions.last() == Some(&1000), "{revisions:?}");
        assert_eq!(revisions.iter().filter(|revision| **revision == 1000).count(), 1, "{revisions:?}");
        let configs: Vec<&Json> =
            told.iter().filter(|(channel, _)| *channel == 2).map(|(_, told)| told).collect();
        assert_eq!(configs.last(), Some(&&json!({ "path": "host/sine999", "config": { "rate": 999 } })));
    }

    #[test]
    fn a_process_that_is_not_heard_is_no_gap_while_its_data_come() {
        let (here, lost) = ("PROCESS_STATE_ATTACHED", "PROCESS_STATE_LOST");
        assert_eq!(link(&graph(here, lost, Some(4))), Some(4));
        assert_eq!(link(&graph(here, lost, Some(0))), None, "no data come");
        assert_eq!(link(&graph(here, here, Some(0))), None, "it is there, and not linked yet");
        assert_eq!(link(&graph(lost, here, None)), Some(0), "it does not leave the process");
        assert!(Explaining::is_heard(&graph(here, lost, None), "host/rec"));
        assert!(
            !Explaining::is_heard(&graph(lost, here, Some(0)), "host/rec"),
            "what is said of its end is old"
        );
    }
}
