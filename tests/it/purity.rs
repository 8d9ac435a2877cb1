//! Ten thousand steps of every execution model, with everything a step may do.
//!
//! Promise: a thread that steps allocates nothing, calls nothing of the system inside a step, and between
//! steps only its own sleep and its wakes.

mod book;
mod classes;
mod trap;

use std::cell::RefCell;

use serde_json::json;
use trocar::Host;
use trocar::host::HostError;
use trocar::model::{ConnectOptions, Execution, ExecutionModel};
use trocar_tests::{eventually, skip};

use book::{Excused, STEPS, Watch};

type Done = Result<(), HostError>;

/// A host with a watched component in it.
struct Scene {
    host: Host,
    number: u64,
    watch: &'static Watch,
    /// What carries its connections; empty = the best there is.
    carrier: &'static str,
    /// What has to have happened: components and their counts that are not 0 in the end.
    evidence: RefCell<Vec<(String, &'static str)>>,
}

impl Scene {
    async fn new() -> Result<Scene, HostError> {
        Scene::over("").await
    }

    /// All its connections go over this carrier.
    async fn over(carrier: &'static str) -> Result<Scene, HostError> {
        let host = Host::builder().name("host").plugin(classes::CLASSES).start().await?;
        let (number, watch) = book::watch();
        Ok(Scene { host, number, watch, carrier, evidence: RefCell::default() })
    }

    /// A component whose thread is watched.
    async fn watched(&self, name: &str, class: &str, execution: Execution) -> Done {
        let config = json!({ "watch": self.number });
        self.host.create_with(&format!("host/{name}"), class, config, execution).await?;
        Ok(())
    }

    /// One beside it.
    async fn beside(&self, name: &str, class: &str, execution: Execution) -> Done {
        self.host.create_with(&format!("host/{name}"), class, json!({}), execution).await?;
        Ok(())
    }

    async fn connect(&self, client: &str, server: &str) -> Done {
        self.connect_with(client, server, ConnectOptions::default()).await
    }

    async fn connect_with(&self, client: &str, server: &str, options: ConnectOptions) -> Done {
        let options = ConnectOptions { carrier: self.carrier.into(), ..options };
        self.host.connect_with(&format!("host/{client}"), &format!("host/{server}"), options).await?;
        Ok(())
    }

    /// All that two workers can be to each other.
    async fn pair(&self, client: &str, server: &str) -> Done {
        for input in ["latest", "queue"] {
            self.connect(&format!("{client}/{input}"), &format!("{server}/out")).await?;
        }
        self.connect(&format!("{client}/peer"), &format!("{server}/ctl")).await?;
        self.bridge(client, server, server).await?;
        self.connect(&format!("{client}/any_peer"), &format!("{server}/ctl")).await?;
        self.proved_by(client, &["at_once", "adapted"]);
        self.proved_by(server, &["added"]);
        self.adapted(client, server).await
    }

    /// `client` hands on what it gets from `server` without knowing its type.
    async fn bridge(&self, client: &str, server: &str, to: &str) -> Done {
        self.connect(&format!("{client}/any"), &format!("{server}/out")).await?;
        self.connect(&format!("{to}/back"), &format!("{client}/any_out")).await?;
        self.proved_by(to, &["came_back"]);
        Ok(())
    }

    async fn adapted(&self, client: &str, server: &str) -> Done {
        let options = ConnectOptions { adapt: true, ..ConnectOptions::default() };
        self.connect_with(&format!("{client}/turned"), &format!("{server}/pair"), options).await
    }

    /// These counts of a component must not be 0 in the end.
    fn proved_by(&self, component: &str, counts: &[&'static str]) {
        let component = format!("host/{component}");
        self.evidence.borrow_mut().extend(counts.iter().map(|count| (component.clone(), *count)));
    }

    /// Starts all, lets the steps pass and looks at the book; how many threads were watched.
    async fn proves_pure(self, what: &str, excused: Excused) -> Result<usize, HostError> {
        self.host.start("host/**").await?;
        self.runs_pure(what, excused).await
    }

    /// The same without the start.
    async fn runs_pure(self, what: &str, excused: Excused) -> Result<usize, HostError> {
        let (watch, waits) = (self.watch, format!("{STEPS} steps {what}"));
        let passed = tokio::task::spawn_blocking(move || {
            // A free-running component lets others run at each step: beside many it takes as long as they
            // like, but it goes on.
            while !watch.is_done() {
                let before = watch.steps();
                eventually(&waits, || match watch.steps() {
                    steps if steps >= before + STEPS / 20 || watch.is_done() => Ok(()),
                    steps => Err(format!("it stands at {steps} steps")),
                });
            }
        });
        passed.await.unwrap();
        for (component, count) in self.evidence.take() {
            let row = self.host.read(&component).await?.value;
            let counted = row["done"][count].as_f64().unwrap_or_default();
            assert!(counted > 0.0, "in {STEPS} steps {what}, `{count}` of {component} stayed 0: {row}");
        }
        self.host.shutdown().await;
        if let Some(why) = watch.untrapped() {
            skip(&format!("system calls in steps {what}: this kernel tells nobody of them ({why})"));
        }
        let stains = watch.stains(excused);
        assert!(stains.is_empty(), "in {STEPS} steps {what}: {}", stains.join("\n"));
        Ok(watch.threads())
    }
}

fn model(model: ExecutionModel) -> Execution {
    Execution { model: Some(model), ..Execution::default() }
}

fn periodic() -> Execution {
    Execution { period_ns: Some(100_000), ..model(ExecutionModel::Periodic) }
}

fn inside(how: ExecutionModel, of: &str) -> Execution {
    Execution { inside: Some(format!("host/{of}")), ..model(how) }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_periodic_component_with_others_inside_its_steps_and_one_on_another_thread() -> Done {
    let scene = Scene::new().await?;
    scene.watched("head", "worker", periodic()).await?;
    scene.beside("before", "worker", inside(ExecutionModel::ExecIn, "head")).await?;
    scene.beside("after", "worker", inside(ExecutionModel::ExecOut, "head")).await?;
    scene.beside("other", "worker", model(ExecutionModel::OnSignal)).await?;
    scene.pair("before", "head").await?;
    scene.pair("after", "before").await?;
    scene.pair("head", "other").await?;
    scene.pair("other", "after").await?;
    // In one thread calls are answered, and direct handlers run inside `emit`.
    scene.proved_by("before", &["any_called"]);
    scene.proved_by("after", &["any_called"]);
    scene.proves_pure("of periodic, exec_in and exec_out", book::SLEEP_AND_WAKE).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_free_running_component_that_wakes_another_thread() -> Done {
    let scene = Scene::new().await?;
    scene.watched("free", "worker", model(ExecutionModel::Continuous)).await?;
    scene.beside("woken", "worker", model(ExecutionModel::OnSignal)).await?;
    scene.pair("free", "woken").await?;
    scene.pair("woken", "free").await?;
    scene.proves_pure("of continuous", book::AND_YIELD).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_that_sleeps_until_it_is_signalled() -> Done {
    let scene = Scene::new().await?;
    scene.beside("source", "worker", periodic()).await?;
    scene.watched("woken", "worker", model(ExecutionModel::OnSignal)).await?;
    scene.pair("woken", "source").await?;
    scene.pair("source", "woken").await?;
    scene.proves_pure("of on_signal", book::SLEEP_AND_WAKE).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_whose_peer_is_behind_memory_that_processes_share() -> Done {
    let scene = Scene::over("memfd").await?;
    scene.watched("head", "worker", periodic()).await?;
    scene.beside("other", "worker", model(ExecutionModel::OnSignal)).await?;
    scene.pair("head", "other").await?;
    scene.pair("other", "head").await?;
    scene.proves_pure("of periodic, over memfd", book::AND_BELLS).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_that_is_signalled_through_memory_that_processes_share() -> Done {
    let scene = Scene::over("memfd").await?;
    scene.beside("source", "worker", periodic()).await?;
    scene.watched("woken", "worker", model(ExecutionModel::OnSignal)).await?;
    scene.pair("woken", "source").await?;
    scene.pair("source", "woken").await?;
    scene.proves_pure("of on_signal, over memfd", book::AND_BELLS).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_and_a_filter_whose_frames_lie_in_memory_that_processes_share() -> Done {
    for watches_camera in [true, false] {
        let scene = Scene::over("memfd").await?;
        let head = Execution { period_ns: Some(100_000), ..model(ExecutionModel::Stream) };
        let on_signal = model(ExecutionModel::OnSignal);
        if watches_camera {
            scene.watched("camera", "camera", head).await?;
            scene.beside("filter", "filter", on_signal).await?;
        } else {
            scene.beside("camera", "camera", head).await?;
            scene.watched("filter", "filter", on_signal).await?;
        }
        scene.connect("filter/frame", "camera/frame").await?;
        scene.proves_pure("of frames over memfd", book::AND_BELLS).await?;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_device_thread_that_calls_back() -> Done {
    let scene = Scene::new().await?;
    scene.watched("device", "device", model(ExecutionModel::OnCallback)).await?;
    scene.beside("woken", "worker", model(ExecutionModel::OnSignal)).await?;
    scene.connect("woken/queue", "device/out").await?;
    scene.bridge("device", "woken", "woken").await?;
    scene.adapted("device", "woken").await?;
    // Entered by the device's own thread: a handler that runs at once, and a command by an untyped function.
    scene.beside("ear", "worker", model(ExecutionModel::None)).await?;
    scene.connect("ear/peer", "device/ctl").await?;
    scene.beside("sum", "worker", model(ExecutionModel::None)).await?;
    scene.connect("device/any_peer", "sum/ctl").await?;
    scene.proved_by("ear", &["at_once"]);
    scene.proved_by("sum", &["added"]);
    scene.proves_pure("of on_callback", book::SLEEP_AND_WAKE).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_whose_filters_share_their_work_between_threads() -> Done {
    let scene = Scene::new().await?;
    let head = Execution { period_ns: Some(100_000), threads: Some(3), ..model(ExecutionModel::Stream) };
    scene.beside("camera", "camera", head).await?;
    let filter = Execution { stream_of: Some("host/camera".into()), ..model(ExecutionModel::Stream) };
    scene.watched("filter", "filter", filter.clone()).await?;
    scene.beside("second", "filter", filter).await?;
    scene.beside("branch", "filter", model(ExecutionModel::OnSignal)).await?;
    scene.connect("filter/frame", "camera/frame").await?;
    scene.connect("second/frame", "filter/frame_out").await?;
    scene.connect("branch/frame", "filter/frame_out").await?;
    let aside = Execution { stream_of: Some("host/camera".into()), ..model(ExecutionModel::Stream) };
    scene.beside("aside", "worker", aside.clone()).await?;
    scene.beside("behind", "worker", aside).await?;
    scene.connect("aside/peer", "camera/ctl").await?;
    scene.connect("aside/any_peer", "camera/ctl").await?;
    scene.adapted("aside", "camera").await?;
    scene.bridge("aside", "camera", "behind").await?;
    scene.proved_by("aside", &["at_once", "adapted", "any_called"]);
    let threads = scene.proves_pure("of a stream with three threads and a branch", book::AND_TEAM).await?;
    assert!(threads > 1, "only the stream's first thread was seen at work");
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_passive_component_in_its_callers_step() -> Done {
    let scene = Scene::new().await?;
    scene.watched("caller", "worker", periodic()).await?;
    scene.beside("passive", "worker", model(ExecutionModel::None)).await?;
    scene.connect("caller/peer", "passive/ctl").await?;
    scene.connect("caller/any_peer", "passive/ctl").await?;
    scene.beside("ear", "worker", model(ExecutionModel::None)).await?;
    scene.connect("ear/peer", "caller/ctl").await?;
    scene.proved_by("caller", &["any_called"]);
    scene.proved_by("passive", &["added"]);
    scene.proved_by("ear", &["at_once"]);
    scene.proves_pure("that call a passive component", book::SLEEP_AND_WAKE).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_whose_rows_events_and_commands_are_told_to_taps() -> Done {
    for carrier in ["", "memfd"] {
        let scene = Scene::over(carrier).await?;
        scene.watched("caller", "worker", periodic()).await?;
        scene.beside("passive", "worker", model(ExecutionModel::None)).await?;
        // A command that runs in the caller's thread is not carried over memory.
        let options = ConnectOptions::default();
        scene.host.connect_with("host/caller/peer", "host/passive/ctl", options).await?;
        for (ear, tap) in [
            ("rows", "caller/tap_rows"),
            ("events", "caller/tap_events"),
            ("commands", "passive/tap_commands"),
        ] {
            scene.beside(ear, "worker", periodic()).await?;
            scene.connect(&format!("{ear}/any"), tap).await?;
            scene.proved_by(ear, &["any_came"]);
        }
        scene.proves_pure("that are told to taps", book::AND_BELLS).await?;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_whose_peer_does_not_run_and_has_full_queues() -> Done {
    let scene = Scene::new().await?;
    scene.watched("head", "worker", periodic()).await?;
    scene.beside("stuck", "worker", model(ExecutionModel::OnSignal)).await?;
    scene.beside("idle", "worker", model(ExecutionModel::OnSignal)).await?;
    let options = ConnectOptions { mailbox: Some(2), ..ConnectOptions::default() };
    scene.host.connect_with("host/head/peer", "host/stuck/ctl", options).await?;
    scene.connect("idle/queue", "head/out").await?;
    scene.connect("head/any_peer", "stuck/ctl").await?;
    scene.connect("idle/back", "head/any_out").await?;
    scene.connect("head/any", "idle/out").await?;
    scene.adapted("idle", "head").await?;
    scene.adapted("head", "idle").await?;
    scene.host.start("host/head").await?;
    scene.runs_pure("beside components that do not run", book::SLEEP_AND_WAKE).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_whose_connections_are_replaced_while_it_steps() -> Done {
    let scene = Scene::new().await?;
    scene.watched("head", "worker", periodic()).await?;
    scene.beside("other", "worker", model(ExecutionModel::OnSignal)).await?;
    scene.pair("head", "other").await?;
    scene.pair("other", "head").await?;
    scene.host.start("host/**").await?;
    while !scene.watch.is_done() {
        let options = ConnectOptions { replace: true, ..ConnectOptions::default() };
        scene.host.connect_with("host/head/peer", "host/other/ctl", options.clone()).await?;
        scene.host.connect_with("host/head/latest", "host/other/out", options.clone()).await?;
        scene.host.connect_with("host/other/queue", "host/head/out", options.clone()).await?;
        scene.host.connect_with("host/head/any", "host/other/out", options.clone()).await?;
        scene.host.connect_with("host/head/any_peer", "host/other/ctl", options.clone()).await?;
        scene.host.connect_with("host/other/back", "host/head/any_out", options.clone()).await?;
        let adapt = ConnectOptions { adapt: true, ..options };
        scene.host.connect_with("host/head/turned", "host/other/pair", adapt).await?;
        scene.host.read("host/head").await?;
    }
    scene.runs_pure("while its connections are replaced and its state is read", book::AND_ORDERS).await?;
    Ok(())
}
