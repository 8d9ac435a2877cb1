//! A connection whose optional members are misspelt: it is made, and its answer says that nothing passes
//! through it.

use serde_json::json;
use trocar::model::{ConnectOptions, PortId, Request};
use trocar::{Host as Embedded, StaticPlugin};
use trocar_sdk::{prelude::*, static_plugin};

use super::Done;

/// Holds whatever it is told to hold.
#[derive(Component)]
#[component(provides("ctl"))]
struct Arm {}

#[provides("ctl")]
impl Arm {
    #[command]
    fn hold(&mut self) {}
}

impl Component for Arm {}

/// One name is right, one is not.
#[derive(Component)]
struct Guard {
    #[required(interface = "right", optional)]
    hold: Function,
    #[required(interface = "wrong", optional)]
    hold_w: Function,
}

impl Component for Guard {}

const GUARDS: StaticPlugin = static_plugin!(name = "guards", Arm, Guard);

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_through_which_nothing_passes_is_made_with_a_warning() -> Done {
    let host = Embedded::builder().name("lab").plugin(GUARDS).start().await?;
    host.create("lab/arm", "arm", json!({})).await?;
    host.create("lab/g", "guard", json!({})).await?;
    let mut told = Vec::new();
    for port in ["lab/g/right", "lab/g/wrong"] {
        let (client, server) = (PortId::parse(port)?, PortId::parse("lab/arm/ctl")?);
        let options = ConnectOptions::default();
        let done = host.execute(Request::Connect { client, server, options }).await?;
        told.push(done.reports.into_iter().flat_map(|r| r.warnings).collect::<Vec<_>>().join("; "));
    }
    assert_eq!(told[0], "", "what is found is no news");
    assert!(told[1].contains("so nothing passes through this connection"), "{told:?}");
    assert!(told[1].contains("`hold_w` (did you mean `hold`?), and there is hold"), "{told:?}");
    host.shutdown().await;
    Ok(())
}
