//! The SDK and the host draw the line at the same place: what just compiles is listed, and one step further
//! is refused.

use trocar::lcm::Lcm;
use trocar::{Host, StaticPlugin};
use trocar_sdk::{prelude::*, static_plugin};

use super::Done;

type Row = [f64; 8192];

type Four<T> = [[[[T; 1]; 1]; 1]; 1];
type Sixteen<T> = Four<Four<Four<Four<T>>>>;

#[derive(Config)]
struct Settings {
    #[config(one_of = ["a", "b"])]
    choice: Option<String>,
    some: Vec<Option<f64>>,
    #[config(default = 18446744073709551615)]
    large: u64,
    #[config(min = 0, max = 4, default = [[1, 2], [3, 4]])]
    matrix: [[f64; 2]; 2],
    #[config(default = 00.5)]
    half: f64,
    #[config(default = "x")]
    r#type: String,
}

/// Every number as large as the SDK lets it be.
#[derive(Component)]
#[component(name = "a23456789012345678901234567890123456789012345678901234567890123")]
#[component(rate_hz = 1000000, max_step_ms = 3600000, provides("ctl"))]
struct Most {
    #[input(fifo = 65536)]
    r#type: In<Row>,
    #[output(max_bytes = 1073741824)]
    image: Out<Frame<Row>>,
    #[output(name = "b23456789012345678901234567890123456789012345678901234567890123")]
    deep: Out<Sixteen<Sixteen<f64>>>,
    #[event("ctl")]
    told: Event<Row>,
    #[state]
    row: Row,
    #[config]
    settings: Settings,
}

#[provides("ctl")]
impl Most {
    #[command]
    fn set(&mut self, all: Row) {
        self.row = all;
        let s = &self.settings;
        self.row[0] = s.large as f64 + s.half + s.matrix[0][0] + s.some.len() as f64;
        let _ = (&s.choice, &s.r#type);
    }
}

impl Component for Most {}

#[derive(Component)]
#[component(rate_hz = 0.000278, max_step_ms = 0.1)]
struct Least {}

impl Component for Least {}

/// Anew each time: a host links the table of a plugin once in the life of a program.
macro_rules! limits {
    () => {
        static_plugin!(name = "limits", Most, Least)
    };
}

#[tokio::test(flavor = "multi_thread")]
async fn what_just_compiles_is_listed_and_one_step_further_is_refused() -> Done {
    let host = Host::builder().plugin(limits!()).start().await?;
    let listed = host.gcm().unwrap().graph().processes.values().next().unwrap().classes.len();
    assert_eq!(listed, 2);
    host.shutdown().await;
    let long = "\"name\":\"b23456789012345678901234567890123456789012345678901234567890123";
    let arg = "\"name\":\"all\",\"type\":{\"array\":\"f64\",\"n\":819";
    for (plugin, from, to, why) in [
        (limits!(), "\"period_ns\":1000,", "\"period_ns\":999,", "period of 999 ns"),
        (
            limits!(),
            "\"period_ns\":3597122302158",
            "\"period_ns\":3600000000001",
            "is outside 1 µs to 3600 s",
        ),
        (limits!(), "\"max_step_ns\":3600000000000", "\"max_step_ns\":3600000000001", "max_step"),
        (limits!(), "\"max_step_ns\":100000}", "\"max_step_ns\":99999}", "max_step"),
        (limits!(), "\"fifo\":65536", "\"fifo\":65537", "a queue of 65537 samples is longer than 65536"),
        (limits!(), "\"max_bytes\":1073741824", "\"max_bytes\":1073741825", "frames of 1073741825 bytes"),
        (limits!(), &format!("{arg}2"), &format!("{arg}3"), "a payload of 65544 bytes is larger than 65536"),
        (limits!(), long, &format!("{long}4"), "is not a valid name"),
        (limits!(), "\"name\":\"type\"", "\"name\":\"system\"", "may not be named system"),
        (limits!(), "\"name\":\"type\"", "\"name\":\"tap_rows\"", "may not be named tap_rows"),
        (
            limits!(),
            "\"model\":\"periodic\"",
            "\"model\":\"on_signal\"",
            "a rate means nothing to model on_signal",
        ),
        (limits!(), "\"default\":0.5", "\"default\":\"x\"", "its own defaults are not valid: half"),
    ] {
        assert!(plugin.manifest.contains(from), "{from} is not in {}", plugin.manifest);
        let manifest: &'static str = plugin.manifest.replace(from, to).leak();
        let beyond = StaticPlugin { manifest, entry: plugin.entry };
        let said = match Host::builder().plugin(beyond).start().await {
            Ok(host) => {
                let plugins = host.lcm().unwrap().plugins().await?;
                host.shutdown().await;
                format!("{plugins:?}")
            }
            Err(e) => e.to_string(),
        };
        assert!(said.contains(why), "{to}: {why:?} is not in: {said}");
    }
    Ok(())
}
