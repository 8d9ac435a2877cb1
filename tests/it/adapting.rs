//! Connections whose ends lay the same fields out in two ways, nested as deep as payloads are.
//!
//! Promise: with `adapt` every value arrives under its own name; what cannot be copied so is refused with the
//! reason.

use std::time::Duration;

use serde_json::json;
use trocar::Host;
use trocar::StaticPlugin;
use trocar::host::HostError;
use trocar::model::ConnectOptions;
use trocar_sdk::{prelude::*, static_plugin};

/// A scan as its scanner has it, and as its reader has it: the same names, no two of them at the same place.
mod scanner {
    use trocar_sdk::prelude::*;

    #[derive(Payload, Clone, Copy, Default)]
    #[repr(C)]
    pub(super) struct Point {
        #[unit("m")]
        pub(super) at: [f64; 2],
        #[unit("N")]
        pub(super) load: f64,
    }

    #[derive(Payload, Clone, Copy, Default)]
    #[repr(C)]
    pub(super) struct Scan {
        pub(super) number: u64,
        pub(super) tip: Point,
        pub(super) edge: [Point; 2],
        pub(super) marks: List<Point, 3>,
        pub(super) name: Text<8>,
    }

    /// More points than are copied one by one.
    #[derive(Payload, Clone, Copy)]
    #[repr(C)]
    pub(super) struct Cloud {
        pub(super) points: [Point; 600],
    }
}

mod reader {
    use trocar_sdk::prelude::*;

    #[derive(Payload, Clone, Copy, Default)]
    #[repr(C)]
    pub(super) struct Point {
        #[unit("N")]
        pub(super) load: f64,
        #[unit("m")]
        pub(super) at: [f64; 2],
    }

    #[derive(Payload, Clone, Copy, Default)]
    #[repr(C)]
    pub(super) struct Scan {
        pub(super) name: Text<8>,
        pub(super) marks: List<Point, 3>,
        pub(super) edge: [Point; 2],
        pub(super) tip: Point,
        pub(super) number: u64,
    }

    #[derive(Payload, Clone, Copy)]
    #[repr(C)]
    pub(super) struct Cloud {
        pub(super) points: [Point; 600],
    }
}

/// Gives scans.
#[derive(Component)]
#[component(model = "on_signal")]
struct Scanner {
    #[output]
    scan: Out<scanner::Scan>,
    #[output]
    cloud: Out<scanner::Cloud>,
    #[event("ctl")]
    scanned: Event<u64>,
    #[state]
    sent: scanner::Scan,
}

#[provides("ctl")]
impl Scanner {
    #[command]
    fn shoot(&mut self) {
        let n = self.sent.number as f64;
        let point = |k: f64| scanner::Point { at: [n + k, n + k + 0.25], load: -n - k };
        self.sent = scanner::Scan {
            number: self.sent.number + 1,
            tip: point(1.0),
            edge: [point(2.0), point(3.0)],
            marks: List::of(&[point(4.0), point(5.0)]),
            name: Text::new("retina"),
        };
        self.scan.write(&self.sent);
        self.scanned.emit(self.sent.number);
    }
}

impl Component for Scanner {}

/// Reads them.
#[derive(Component)]
#[component(model = "on_signal", provides("out"))]
struct Reader {
    #[input(optional)]
    scan: In<reader::Scan>,
    #[input(optional)]
    cloud: In<reader::Cloud>,
    #[event("out")]
    seen: Event<u64>,
    #[state]
    came: reader::Scan,
}

impl Component for Reader {
    fn step(&mut self, _: &Tick) -> Result {
        let _ = self.cloud.fresh();
        if let Some(scan) = self.scan.fresh() {
            self.came = scan;
            self.seen.emit(scan.number);
        }
        Ok(())
    }
}

/// Two plugins: in one a name stands for one type.
const SCANNERS: StaticPlugin = static_plugin!(name = "scanners", Scanner);
const READERS: StaticPlugin = static_plugin!(name = "readers", Reader);

type Done = std::result::Result<(), HostError>;

async fn lab() -> std::result::Result<Host, HostError> {
    let host = Host::builder().name("lab").plugin(SCANNERS).plugin(READERS).start().await?;
    host.create("lab/scanner", "scanner", json!({})).await?;
    host.create("lab/reader", "reader", json!({})).await?;
    Ok(host)
}

fn adapt() -> ConnectOptions {
    ConnectOptions { adapt: true, ..ConnectOptions::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn nested_structs_arrays_and_lists_arrive_under_their_own_names() -> Done {
    let host = lab().await?;
    let refused = host.connect("lab/reader/scan", "lab/scanner/scan").await.unwrap_err();
    assert!(refused.to_string().ends_with("adapt: true would copy it by name"), "{refused}");
    host.connect_with("lab/reader/scan", "lab/scanner/scan", adapt()).await?;
    host.start("lab/**").await?;
    for round in 1..=3_u64 {
        let long = Duration::from_secs(20);
        let seen =
            host.invoke_and_wait("lab/scanner/ctl/shoot", json!(null), "lab/reader/out/seen", long).await?;
        assert_eq!(seen.value, json!(round));
        let (sent, came) = (host.read("lab/scanner").await?.value, host.read("lab/reader").await?.value);
        assert_eq!(sent["sent"], came["came"], "round {round}");
        assert_eq!(came["came"]["marks"][1]["load"], json!(-(round as f64) - 4.0), "{came}");
    }
    host.shutdown().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn more_pieces_than_a_step_can_copy_are_refused_with_that_reason() -> Done {
    let host = lab().await?;
    let refused = host.connect_with("lab/reader/cloud", "lab/scanner/cloud", adapt()).await.unwrap_err();
    assert_eq!(refused.reason(), "TYPE_MISMATCH");
    let told = refused.to_string();
    assert!(told.contains("points[…].load"), "{told}");
    assert!(told.ends_with("more than 1024 runs of bytes for each sample"), "{told}");
    host.shutdown().await;
    Ok(())
}
