//! A host inside a program: `Host::builder()`, classes linked in, no port, no plugin file.
//!
//! Promise: a linked class is a class like any other; everything grpcurl can ask, the program can ask without
//! gRPC.

mod bench;
mod limits;
mod optional;
mod threads;

use std::time::Duration;

use serde_json::json;
use trocar::host::HostError;
use trocar::lcm::{LINKED_IN, Lcm};
use trocar::model::{ComponentId, State, StopReason};
use trocar::{Host, StaticPlugin};
use trocar_sdk::data::Scalar;
use trocar_sdk::{prelude::*, static_plugin};
use trocar_tests::{Built, HostProcess, Watchdog, World, eventually};

type Done = std::result::Result<(), HostError>;

/// Hands on what it gets, times two.
#[derive(Component)]
#[component(model = "on_signal", provides("ctl"))]
struct Doubler {
    #[input(optional)]
    value: In<Scalar>,
    #[output]
    out: Out<Scalar>,
    #[state]
    last: f64,
}

#[provides("ctl")]
impl Doubler {
    #[command]
    fn put(&mut self, value: f64) {
        self.last = 2.0 * value;
        self.out.write(&Scalar { value: self.last, ..Scalar::default() });
    }

    #[read]
    fn last(s: &DoublerState) -> f64 {
        s.last
    }
}

impl Component for Doubler {
    fn step(&mut self, _: &Tick) -> Result {
        if let Some(sample) = self.value.fresh() {
            self.put(sample.value);
        }
        Ok(())
    }
}

const DOUBLERS: StaticPlugin = static_plugin!(name = "doublers", Doubler);
/// The name of a plugin that is in a file as well.
const OTHER_ARCHITECT: StaticPlugin = static_plugin!(name = "fixture-architect", Doubler);

/// The sum of what a program writes to run two connected components of its own.
#[tokio::test(flavor = "multi_thread")]
async fn a_program_runs_its_own_classes_without_port_or_plugin_file() -> Done {
    let host = Host::builder().name("lab").plugin(DOUBLERS).start().await?;
    assert_eq!(host.addr(), None, "nobody listens");
    host.create("lab/a", "doubler", json!({})).await?;
    host.create("lab/b", "doublers/doubler", json!({})).await?;
    let wire = host.connect("lab/b/value", "lab/a/out").await?;
    host.start("lab/**").await?;
    host.wait_for("lab/b", State::Active, Duration::from_secs(10)).await?;
    host.invoke("lab/a/ctl/put", json!(10.5)).await?;
    let mut watchdog = Watchdog::of("lab/b has what it was given");
    let row = loop {
        let row = host.read("lab/b").await?.value;
        if row["last"] != json!(0.0) {
            break row;
        }
        watchdog.saw(&row);
        tokio::task::yield_now().await;
    };
    assert_eq!(row["last"], json!(42.0));
    assert_eq!(host.invoke("lab/b/ctl/last", json!(null)).await?.value, Some(json!(42.0)));
    host.disconnect(wire).await?;
    host.stop("lab/b").await?;
    assert_eq!(host.state("lab/b").await?, State::Stopped(StopReason::Requested));
    host.resume("lab/b").await?;
    host.reset("lab/b").await?;
    assert_eq!(host.state("lab/b").await?, State::Ready);
    host.remove("lab/b").await?;
    assert_eq!(host.state("lab/b").await.unwrap_err().reason(), "COMPONENT_NOT_FOUND");
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_linked_class_is_listed_as_linked_in_without_a_hash() -> Done {
    let host = Host::builder().plugin(DOUBLERS).start().await?;
    let plugins = host.lcm().unwrap().plugins().await?;
    assert_eq!(plugins.len(), 1);
    assert_eq!((plugins[0].file.as_str(), plugins[0].hash.as_str()), (LINKED_IN, ""));
    assert!(plugins[0].loaded && plugins[0].classes == ["doubler"], "{:?}", plugins[0]);
    let graph = host.gcm().unwrap().graph();
    let process = graph.processes.values().next().unwrap();
    assert_eq!(process.classes.iter().map(|c| c.full_name()).collect::<Vec<_>>(), ["doublers/doubler"]);
    assert_eq!(process.classes[0].hash, "");
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_embedded_host_may_listen_and_is_then_controlled_from_outside() -> Done {
    let host = Host::builder().plugin(DOUBLERS).listen("127.0.0.1:0").start().await?;
    let grpc = trocar_tests::Grpcurl::new(&host.addr().unwrap().to_string());
    let outside = tokio::task::spawn_blocking(move || {
        grpc.create("host/a", "doubler", json!({}));
        grpc.start("host/a");
        grpc.plugins()
    });
    let plugins = outside.await.unwrap();
    assert_eq!(plugins[0]["file"], json!(LINKED_IN));
    assert_eq!(host.state("host/a").await?, State::Active);
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn linked_classes_and_those_of_files_live_side_by_side() -> Done {
    let world = World::with_plugins(&["fixture_architect"]);
    let host =
        Host::builder().plugin(DOUBLERS).plugins(world.plugins()).vet_with(Built::trocar()).start().await?;
    host.create("host/linked", "doubler", json!({})).await?;
    host.create("host/filed", "brick", json!({})).await?;
    host.connect("host/filed/value", "host/linked/out").await?;
    host.create("host/architect", "architect", json!({})).await?;
    host.start("host/**").await?;
    let asked = json!(json!({ "verb": "Create", "path": "host/asked", "class": "doubler" }).to_string());
    assert_eq!(host.invoke("host/architect/ctl/ask", asked).await?.value, Some(json!("Queued")));
    let asked = ComponentId::parse("host/asked")?;
    let mut graphs = host.gcm().unwrap().watch();
    graphs.wait_for(|graph| graph.components.contains_key(&asked)).await.unwrap();
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_with_the_name_of_a_linked_plugin_is_refused_and_says_why() -> Done {
    let world = World::with_plugins(&["fixture_architect"]);
    let builder = Host::builder().plugin(OTHER_ARCHITECT).plugins(world.plugins());
    let host = builder.vet_with(Built::trocar()).start().await?;
    let plugins = host.lcm().unwrap().plugins().await?;
    let file = plugins.iter().find(|p| p.file.ends_with(".so")).unwrap();
    assert!(file.refused.contains("linked into the program"), "{file:?}");
    assert_eq!(host.create("host/b", "brick", json!({})).await.unwrap_err().reason(), "CLASS_NOT_FOUND");
    host.create("host/d", "doubler", json!({})).await?;
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_linked_plugin_that_is_damaged_or_named_twice_is_told_at_the_start() {
    let refused = async |builder: trocar::HostBuilder| match builder.start().await {
        Err(e) => (e.reason(), e.to_string()),
        Ok(_) => panic!("it was started"),
    };
    let twice = refused(Host::builder().plugin(DOUBLERS).plugin(DOUBLERS)).await;
    assert!(twice.0 == "PLUGIN_LINKED" && twice.1.contains("doublers is linked in twice"), "{twice:?}");
    let broken = StaticPlugin { manifest: "{", ..DOUBLERS };
    let broken = refused(Host::builder().plugin(broken)).await;
    assert!(broken.0 == "PLUGIN_LINKED" && broken.1.contains("manifest"), "{broken:?}");
    let foreign = StaticPlugin { manifest: OTHER_ARCHITECT.manifest, ..DOUBLERS };
    let foreign = refused(Host::builder().plugin(foreign)).await;
    assert!(foreign.0 == "PLUGIN_LINKED" && foreign.1.contains("fixture-architect"), "{foreign:?}");
    let unnamed = refused(Host::builder().name("9 lives")).await;
    assert!(unnamed.0 == "BAD_NAME" && unnamed.1.contains("9 lives"), "{unnamed:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_host_attached_elsewhere_says_so_when_it_is_asked_itself() -> Done {
    let world = World::new();
    let gcm = HostProcess::start_gcm(&world);
    let host = Host::builder().name("left").plugin(DOUBLERS).gcm(gcm.address()).start().await?;
    let refused = host.create("left/a", "doubler", json!({})).await.unwrap_err();
    assert!(
        refused.reason() == "MANAGED_ELSEWHERE" && refused.to_string().contains(gcm.address()),
        "{refused}"
    );
    let grpc = gcm.grpcurl();
    let made = tokio::task::spawn_blocking(move || {
        grpc.await_class("left", "doubler");
        grpc.create("left/a", "doubler", json!({}));
        grpc.start("left/a");
        eventually("it is listed", || if grpc.state("left/a") == "ACTIVE" { Ok(()) } else { Err("not yet") });
    });
    made.await.unwrap();
    host.invoke("left/a/ctl/put", json!(1.0)).await?;
    host.shutdown().await;
    Ok(())
}
