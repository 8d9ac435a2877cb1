//! The operations a program asks of the host inside it: dry runs, earlier rows, events, removal with and
//! without force.
//!
//! Promise: what the command line can ask, the program can, with the same refusals.

mod ending;

use std::time::Duration;

use serde_json::json;
use trocar::Host;
use trocar::StaticPlugin;
use trocar::host::HostError;
use trocar::lcm::When;
use trocar::model::{ComponentId, Execution, Request, State};
use trocar_sdk::{prelude::*, static_plugin};

type Done = std::result::Result<(), HostError>;

const LONG: Duration = Duration::from_secs(20);

/// Counts what it is given and tells of each.
#[derive(Component)]
#[component(model = "on_signal")]
struct Counter {
    #[input(optional)]
    value: In<f64>,
    #[output]
    out: Out<f64>,
    #[event("ctl")]
    counted: Event<u64>,
    #[state]
    count: u64,
}

#[provides("ctl")]
impl Counter {
    #[command]
    fn count(&mut self) {
        self.count += 1;
        self.out.write(&(self.count as f64));
        self.counted.emit(self.count);
    }
}

impl Component for Counter {
    fn step(&mut self, _: &Tick) -> Result {
        let _ = self.value.fresh();
        Ok(())
    }
}

/// Says what a terminal would obey, and what looks like a line of the log.
#[derive(Component)]
#[component(model = "on_signal", provides("ctl"))]
struct Liar {
    #[state]
    lies: u64,
}

const LIE: &str = "\x1b[2J\x1b[31mgone\nERROR lab/other: it burns";
const SHOWN: &str = "\\u{1b}[2J\\u{1b}[31mgone\\nERROR lab/other: it burns";

#[provides("ctl")]
impl Liar {
    #[command]
    fn refuse(&mut self) -> std::result::Result<(), String> {
        self.lies += 1;
        log::error!("{LIE}");
        Err(LIE.to_owned())
    }
    #[command]
    fn panic(&mut self) {
        panic!("{LIE}");
    }
}

impl Component for Liar {}

const LIARS: StaticPlugin = static_plugin!(name = "liars", Liar);

const COUNTERS: StaticPlugin = static_plugin!(name = "counters", Counter);

async fn two() -> std::result::Result<Host, HostError> {
    let host = Host::builder().name("lab").plugin(COUNTERS).start().await?;
    host.create("lab/a", "counter", json!({})).await?;
    host.create("lab/b", "counter", json!({})).await?;
    host.connect("lab/b/value", "lab/a/out").await?;
    host.start("lab/**").await?;
    host.wait_for("lab/b", State::Active, LONG).await?;
    Ok(host)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connected_component_is_removed_only_by_force_or_after_its_connection_was_cut() -> Done {
    let host = two().await?;
    assert_eq!(host.list("lab/**").await?.len(), 2);
    host.stop("lab/**").await?;
    let refused = host.remove("lab/b").await.unwrap_err();
    assert!(refused.to_string().contains("lab/b/value"), "{refused}");
    host.disconnect_pair("lab/b/value", "lab/a/out").await?;
    host.remove("lab/b").await?;
    host.create("lab/b", "counter", json!({})).await?;
    host.connect("lab/b/value", "lab/a/out").await?;
    host.remove_forced("lab/a").await?;
    assert_eq!(host.list("lab/a").await.unwrap_err().reason(), "COMPONENT_NOT_FOUND");
    assert_eq!(host.list("lab/**").await?, [ComponentId::parse("lab/b")?]);
    assert_eq!(host.describe("lab/b").await?.state, State::Ready);
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dry_run_tells_what_would_be_and_changes_nothing() -> Done {
    let host = two().await?;
    let before = host.gcm().unwrap().graph().revision;
    let remove = |path: &str| ComponentId::parse(path).map(|id| Request::Remove { id, force: true });
    let would = host.dry_run(vec![remove("lab/a")?]).await?;
    assert!(!would.plan.changes.is_empty(), "{would:?}");
    assert_eq!(host.dry_run(vec![remove("lab/c")?]).await.unwrap_err().reason(), "COMPONENT_NOT_FOUND");
    assert_eq!((host.gcm().unwrap().graph().revision, host.list("lab/**").await?.len()), (before, 2));
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_event_is_waited_for_and_one_that_does_not_come_is_named() -> Done {
    let host = two().await?;
    let item = host.invoke_and_wait("lab/a/ctl/count", json!(null), "lab/a/ctl/counted", LONG).await?;
    assert_eq!(item.value, json!(1));
    let late = host.wait_for_event("lab/b/ctl/counted", Duration::from_millis(1)).await.unwrap_err();
    assert_eq!(late.reason(), "EVENT_NOT_SEEN", "{late}");
    let none = host.wait_for_event("lab/c/ctl/counted", LONG).await.unwrap_err();
    assert_eq!(none.reason(), "COMPONENT_NOT_FOUND", "{none}");
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn earlier_rows_are_read_and_execution_is_configured() -> Done {
    let host = two().await?;
    for count in 1..=3 {
        let item = host.invoke_and_wait("lab/a/ctl/count", json!(null), "lab/a/ctl/counted", LONG).await?;
        assert_eq!(item.value, json!(count));
    }
    let newest = host.read("lab/a").await?;
    let earlier = host.read_at("lab/a", When::Delayed(1)).await?;
    assert!(earlier.value["count"].as_u64() <= newest.value["count"].as_u64(), "{earlier:?} {newest:?}");
    host.read_at("lab/a", When::Tick(u64::MAX)).await.unwrap_err();
    host.stop("lab/a").await?;
    host.configure_with("lab/a", json!({}), Execution { history: Some(8), ..Execution::default() }).await?;
    assert_eq!(host.describe("lab/a").await?.execution.history, Some(8));
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_component_says_is_one_line_that_no_terminal_obeys() -> Done {
    let host = Host::builder().name("lab").plugin(LIARS).start().await?;
    host.create("lab/liar", "liar", json!({})).await?;
    host.start("lab/liar").await?;
    let harmless = |text: &str| {
        assert!(text.contains(SHOWN), "{text:?}");
        assert!(!text.contains(|c: char| c.is_control()), "{text:?}");
    };
    harmless(&host.invoke("lab/liar/ctl/refuse", json!(null)).await.unwrap_err().to_string());
    harmless(&host.invoke("lab/liar/ctl/panic", json!(null)).await.unwrap_err().to_string());
    let fault = host.wait_for("lab/liar", State::Active, LONG).await.unwrap_err();
    assert_eq!(fault.reason(), "COMPONENT_FAULT");
    harmless(&fault.to_string());
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_output_is_followed_as_often_as_asked_and_a_rate_that_is_none_is_refused() -> Done {
    let host = two().await?;
    let mut samples = host.subscribe_at("lab/a/out", 1000.0).await?;
    host.invoke("lab/a/ctl/count", json!(null)).await?;
    assert_eq!(samples.recv().await.map(|item| item.value), Some(json!(1.0)));
    for none in [-1.0, f64::NAN, f64::INFINITY] {
        let refused = host.subscribe_at("lab/a/out", none).await.unwrap_err();
        assert_eq!(refused.reason(), "ARGUMENT_INVALID", "{refused}");
    }
    host.shutdown().await;
    Ok(())
}
