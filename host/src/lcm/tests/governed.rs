//! Under a real GCM: components that are given another thread, and what stays when that is refused.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::thread;

use serde_json::json;
use trocar_model::{Request, SystemGraph, Target};
use trocar_plugin_api::abi::Tick;

use super::super::boundary::LoadedClass;
use super::super::boundary::fake::Own;
use super::super::{Classes, PluginInfo};
use super::*;
use crate::gcm::{ExecuteOptions, Executed, Gcm, GcmConfig, Registration};

/// `source` with an output, `sink` with an input.
struct Catalog;

impl Classes for Catalog {
    fn catalog(&self) -> Vec<Arc<ClassInfo>> {
        let named = |name: &str, ports| {
            let execution = periodic(1000);
            Arc::new(ClassInfo { name: name.into(), execution, ..class(ports, Safety::None) })
        };
        vec![named("source", plain(false, true)), named("sink", plain(true, false))]
    }

    fn load(&self, class: &ClassInfo) -> Result<LoadedClass, Refusal> {
        FakeClasses.load(class)
    }

    fn plugins(&self) -> Vec<PluginInfo> {
        Vec::new()
    }
}

/// Counts its steps and the threads they came from.
#[derive(Default)]
struct Walker {
    steps: AtomicU64,
    last: std::sync::Mutex<Option<thread::ThreadId>>,
    /// Configure is refused at this call, from 1; 0 = never.
    refuse_at: usize,
    configured: AtomicUsize,
}

impl Walker {
    fn thread(&self) -> thread::ThreadId {
        self.last.lock().unwrap().expect("it has stepped")
    }

    async fn stepped(&self, what: &str) {
        let before = self.steps.load(Ordering::SeqCst);
        eventually(what, || self.steps.load(Ordering::SeqCst) > before + 2).await;
    }
}

impl Behaviour for Walker {
    fn configure(&self, _: &str) -> Result<(), String> {
        let n = self.configured.fetch_add(1, Ordering::SeqCst) + 1;
        if n == self.refuse_at { Err("not a second time".into()) } else { Ok(()) }
    }

    fn step(&self, _: &Tick, own: &Own) -> Result<(), String> {
        *self.last.lock().unwrap() = Some(thread::current().id());
        if own.has_output() {
            own.write(0, &1);
        }
        self.steps.fetch_add(1, Ordering::SeqCst);
        Ok(())
    }
}

struct Governed {
    gcm: Gcm,
    lcm: Arc<LocalLcm>,
    process: &'static str,
}

impl Governed {
    async fn new(process: &'static str) -> Governed {
        let config = LcmConfig {
            process: Name::parse(process).unwrap(),
            classes: Some(Arc::new(Catalog)),
            links: None,
            lock_memory: false,
            allow_exec: false,
        };
        let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), LocalLcm::new(config).unwrap());
        let who = Registration::new(Name::parse(process).unwrap(), String::new());
        gcm.register(who, lcm.clone(), lcm.inventory().await.unwrap()).await.unwrap();
        Governed { gcm, lcm, process }
    }

    fn id(&self, name: &str) -> ComponentId {
        ComponentId::parse(&format!("{}/{name}", self.process)).unwrap()
    }

    async fn ask(&self, request: Request) -> Result<Executed, Refusal> {
        self.gcm.execute(vec![request], ExecuteOptions::default()).await
    }

    async fn create(&self, name: &str, class: &str, execution: Execution, walker: Walker) -> Arc<Walker> {
        let walker = Arc::new(walker);
        behave(&self.id(name).to_string(), walker.clone());
        let request = Request::Create { id: self.id(name), class: class.into(), config: None, execution };
        self.ask(request).await.unwrap();
        walker
    }

    async fn connect(&self, client: &str, server: &str) {
        let port = |path: &str| PortId::parse(&format!("{}/{path}", self.process)).unwrap();
        let (client, server) = (port(client), port(server));
        self.ask(Request::Connect { client, server, options: ConnectOptions::default() }).await.unwrap();
    }

    async fn start_all(&self) {
        let targets = vec![Target::parse(&format!("{}/**", self.process)).unwrap()];
        self.ask(Request::Start { targets }).await.unwrap();
    }

    async fn stop_all(&self) {
        let targets = vec![Target::parse(&format!("{}/**", self.process)).unwrap()];
        self.ask(Request::Stop { targets }).await.unwrap();
    }

    async fn rethread(&self, name: &str, execution: Execution) -> Result<Executed, Refusal> {
        self.ask(Request::Configure { id: self.id(name), patch: json!({}), execution: Some(execution) }).await
    }

    fn graph(&self) -> Arc<SystemGraph> {
        self.gcm.graph()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_moves_into_anothers_step_and_out_again_with_its_wires() {
    let g = Governed::new("g_moves").await;
    let lead = g.create("lead", "source", Execution::default(), Walker::default()).await;
    let other = g.create("other", "sink", Execution::default(), Walker::default()).await;
    g.connect("other/in", "lead/out").await;
    g.start_all().await;
    lead.stepped("the lead steps").await;
    other.stepped("the other steps").await;
    assert_ne!(lead.thread(), other.thread());
    let refusal = g.rethread("other", inside(ExecutionModel::ExecOut, &g.id("lead"))).await.unwrap_err();
    assert_eq!(refusal.reason(), "WRONG_STATE", "not while it runs: {refusal}");
    g.stop_all().await;
    g.rethread("other", inside(ExecutionModel::ExecOut, &g.id("lead"))).await.unwrap();
    assert_eq!(g.graph().components[&g.id("other")].state, State::Ready);
    assert_eq!(g.graph().connections.len(), 1);
    g.start_all().await;
    other.stepped("it steps inside").await;
    lead.stepped("the lead steps on").await;
    assert_eq!(lead.thread(), other.thread());
    g.stop_all().await;
    g.rethread("lead", Execution { period_ns: Some(2_000_000), ..Execution::default() }).await.unwrap();
    g.start_all().await;
    other.stepped("it went along with its host").await;
    lead.stepped("the lead steps at its new rate").await;
    assert_eq!(lead.thread(), other.thread());
    g.stop_all().await;
    g.rethread("other", periodic(1000)).await.unwrap();
    g.start_all().await;
    other.stepped("it steps on its own again").await;
    lead.stepped("and the lead too").await;
    assert_ne!(lead.thread(), other.thread());
    let links = g.lcm.links().await.unwrap();
    assert_eq!(links.len(), 1, "the wire is there, in the graph and in the process: {links:?}");
    g.stop_all().await;
    g.lcm.shutdown(PATIENCE).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_that_refuses_to_be_made_anew_is_left_as_it_was() {
    let g = Governed::new("g_refuses").await;
    // Its second configuration is the one on the new thread; the third brings back the old one.
    let fussy =
        g.create("a", "source", Execution::default(), Walker { refuse_at: 2, ..Walker::default() }).await;
    let other = g.create("b", "sink", Execution::default(), Walker::default()).await;
    g.connect("b/in", "a/out").await;
    let before = g.graph();
    let refusal = g.rethread("a", periodic(5000)).await.unwrap_err();
    assert!(refusal.to_string().contains("not a second time"), "{refusal}");
    let after = g.graph();
    let a = g.id("a");
    assert_eq!(after.components[&a].execution, before.components[&a].execution);
    assert_eq!((after.components[&a].state, after.revision), (State::Ready, before.revision));
    assert_eq!(after.connections, before.connections);
    g.start_all().await;
    fussy.stepped("it runs as before").await;
    other.stepped("and so does its client").await;
    g.stop_all().await;
    g.lcm.shutdown(PATIENCE).await;
}
