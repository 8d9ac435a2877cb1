//! Components that are given another thread, and the system as it stays when that is refused.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use trocar::lcm::Lcm;
use trocar::model::{Execution, ExecutionModel};

use super::*;

/// The number of the calling thread, from 1.
fn thread() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    thread_local!(static MINE: u64 = NEXT.fetch_add(1, Ordering::Relaxed));
    MINE.with(|mine| *mine)
}

/// Writes in each step, and tells which thread it came from.
#[derive(Component)]
#[component(rate_hz = 1000)]
struct Source {
    #[output]
    out: Out<Scalar>,
    #[state]
    steps: u64,
    #[state]
    thread: u64,
}

impl Component for Source {
    fn step(&mut self, _: &Tick) -> Result {
        self.out.write(&Scalar::default());
        (self.steps, self.thread) = (self.steps + 1, thread());
        Ok(())
    }
}

/// Tells which thread its steps come from.
#[derive(Component)]
#[component(rate_hz = 1000)]
struct Sink {
    #[input(optional)]
    value: In<Scalar>,
    #[state]
    steps: u64,
    #[state]
    thread: u64,
}

impl Component for Sink {
    fn step(&mut self, _: &Tick) -> Result {
        let _ = self.value.fresh();
        (self.steps, self.thread) = (self.steps + 1, thread());
        Ok(())
    }
}

/// Refuses the second configuration of all its instances together: the one on another thread.
#[derive(Component)]
#[component(rate_hz = 1000)]
struct Fussy {
    #[output]
    out: Out<Scalar>,
    #[state]
    steps: u64,
}

impl Component for Fussy {
    fn configure(&mut self) -> Result {
        static CONFIGURED: AtomicUsize = AtomicUsize::new(0);
        match CONFIGURED.fetch_add(1, Ordering::SeqCst) {
            1 => Err("not a second time".into()),
            _ => Ok(()),
        }
    }

    fn step(&mut self, _: &Tick) -> Result {
        self.out.write(&Scalar::default());
        self.steps += 1;
        Ok(())
    }
}

const WALKERS: StaticPlugin = static_plugin!(name = "walkers", Source, Sink, Fussy);

fn inside(model: ExecutionModel, whose: &str) -> Execution {
    Execution { model: Some(model), inside: Some(whose.into()), ..Execution::default() }
}

/// The thread of the newest of its steps, after it has stepped on.
async fn steps(host: &Host, path: &str, what: &str) -> std::result::Result<u64, HostError> {
    let before = host.read(path).await?.value["steps"].as_u64().unwrap();
    let mut watchdog = Watchdog::of(what);
    loop {
        let row = host.read(path).await?.value;
        if row["steps"].as_u64().unwrap() > before + 2 {
            return Ok(row["thread"].as_u64().unwrap_or(0));
        }
        watchdog.saw(&row);
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_moves_into_anothers_step_and_out_again_with_its_connections() -> Done {
    let host = Host::builder().name("lab").plugin(WALKERS).start().await?;
    host.create("lab/lead", "source", json!({})).await?;
    host.create("lab/other", "sink", json!({})).await?;
    host.connect("lab/other/value", "lab/lead/out").await?;
    let both = async |what: &str| -> std::result::Result<[u64; 2], HostError> {
        host.start("lab/**").await?;
        let lead = steps(&host, "lab/lead", what).await?;
        Ok([lead, steps(&host, "lab/other", what).await?])
    };
    let [lead, other] = both("each steps on its own").await?;
    assert_ne!(lead, other);
    let into = inside(ExecutionModel::ExecOut, "lab/lead");
    let refusal = host.configure_with("lab/other", json!({}), into.clone()).await.unwrap_err();
    assert_eq!(refusal.reason(), "WRONG_STATE", "not while it runs: {refusal}");
    host.stop("lab/**").await?;
    host.configure_with("lab/other", json!({}), into).await?;
    let graph = host.gcm().unwrap().graph();
    assert_eq!(graph.components[&ComponentId::parse("lab/other")?].state, State::Ready);
    assert_eq!(graph.connections.len(), 1);
    let [lead, other] = both("one steps inside the other").await?;
    assert_eq!(lead, other);
    host.stop("lab/**").await?;
    let slower = Execution { period_ns: Some(2_000_000), ..Execution::default() };
    host.configure_with("lab/lead", json!({}), slower).await?;
    let [lead, other] = both("it goes along with its host").await?;
    assert_eq!(lead, other);
    host.stop("lab/**").await?;
    let alone = Execution {
        model: Some(ExecutionModel::Periodic),
        period_ns: Some(1_000_000),
        ..Execution::default()
    };
    host.configure_with("lab/other", json!({}), alone).await?;
    let [lead, other] = both("each steps on its own again").await?;
    assert_ne!(lead, other);
    let links = host.lcm().unwrap().links().await?;
    assert_eq!(links.len(), 1, "the connection is there, in the graph and in the process: {links:?}");
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_component_that_refuses_to_be_made_anew_is_left_as_it_was() -> Done {
    let host = Host::builder().name("lab").plugin(WALKERS).start().await?;
    host.create("lab/a", "fussy", json!({})).await?;
    host.create("lab/b", "sink", json!({})).await?;
    host.connect("lab/b/value", "lab/a/out").await?;
    let before = host.gcm().unwrap().graph();
    let slower = Execution { period_ns: Some(5_000_000), ..Execution::default() };
    let refusal = host.configure_with("lab/a", json!({}), slower).await.unwrap_err();
    assert!(refusal.to_string().contains("not a second time"), "{refusal}");
    let after = host.gcm().unwrap().graph();
    let a = ComponentId::parse("lab/a")?;
    assert_eq!(after.components[&a].execution, before.components[&a].execution);
    assert_eq!((after.components[&a].state, after.revision), (State::Ready, before.revision));
    assert_eq!(after.connections, before.connections);
    host.start("lab/**").await?;
    steps(&host, "lab/a", "it runs as before").await?;
    steps(&host, "lab/b", "and so does its client").await?;
    host.shutdown().await;
    Ok(())
}
