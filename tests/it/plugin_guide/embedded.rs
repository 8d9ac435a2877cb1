//! The program that `docs/PLUGIN_REFERENCE.md` shows whole: a host of its own, with its own classes linked
//! in.

use std::time::Duration;

use serde_json::json;
use trocar::host::HostError;
use trocar::model::State;
use trocar::{Host, StaticPlugin};
use trocar_sdk::{prelude::*, static_plugin};

/// Hands on what it gets, times two.
#[derive(Component)]
#[component(model = "on_signal")]
struct Doubler {
    #[input(optional)]
    value: In<f64>,
    #[output]
    out: Out<f64>,
    #[event("ctl")]
    doubled: Event<f64>,
    #[state]
    last: f64,
}

#[provides("ctl")]
impl Doubler {
    #[command]
    fn put(&mut self, value: f64) {
        self.last = 2.0 * value;
        self.out.write(&self.last);
        self.doubled.emit(self.last);
    }
    #[read]
    fn last(s: &DoublerState) -> f64 {
        s.last
    }
}

impl Component for Doubler {
    fn step(&mut self, _: &Tick) -> Result {
        if let Some(value) = self.value.fresh() {
            self.put(value);
        }
        Ok(())
    }
}

/// Any number of classes after the name.
const DOUBLERS: StaticPlugin = static_plugin!(name = "doublers", Doubler);

#[tokio::main]
async fn main() -> std::result::Result<(), HostError> {
    let host = Host::builder().name("lab").plugin(DOUBLERS).start().await?;
    host.create("lab/a", "doubler", json!({})).await?;
    host.create("lab/b", "doublers/doubler", json!({})).await?;
    host.connect("lab/b/value", "lab/a/out").await?;
    host.start("lab/**").await?;
    host.wait_for("lab/b", State::Active, Duration::from_secs(10)).await?;
    let done = host
        .invoke_and_wait("lab/a/ctl/put", json!(10.5), "lab/b/ctl/doubled", Duration::from_secs(10))
        .await?;
    assert_eq!(done.value, json!(42.0));
    assert_eq!(host.invoke("lab/b/ctl/last", json!(null)).await?.value, Some(json!(42.0)));
    host.shutdown().await;
    Ok(())
}

#[test]
fn the_program_of_the_guide_runs() {
    main().unwrap();
}
