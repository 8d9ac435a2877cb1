//! The bench of the SDK and the host, side by side: the same class, the same mishaps, the same standing
//! afterwards.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};

use serde_json::json;
use trocar::Host as Embedded;
use trocar::StaticPlugin;
use trocar_sdk::testing::Bench;
use trocar_sdk::{prelude::*, static_plugin};

use super::Done;

/// A camera whose library calls back.
#[derive(Component)]
#[component(model = "on_callback", safety = "sensor", provides("ctl"))]
struct Camera {
    #[host]
    host: Host,
    #[state]
    asked: u64,
}

#[provides("ctl")]
impl Camera {
    #[command]
    fn ask(&mut self) -> u64 {
        self.asked += 1;
        self.asked
    }
}

/// What the library of the camera holds on to.
static LIBRARY: Mutex<Option<Host>> = Mutex::new(None);

impl Component for Camera {
    fn start(&mut self) -> Result {
        *LIBRARY.lock().unwrap_or_else(PoisonError::into_inner) = Some(self.host.clone());
        Ok(())
    }
}

/// Outcome of a sample with a mistake in it and two good ones: the thread of the library is the author's,
/// and so is its panic.
fn three_samples() -> Vec<String> {
    let host = LIBRARY.lock().unwrap_or_else(PoisonError::into_inner).clone().unwrap();
    let sample = move |good: bool| {
        let done = catch_unwind(AssertUnwindSafe(|| {
            host.callback(|| assert!(good, "a sample with a mistake in it"))
        }));
        done.map_or("panicked".to_owned(), |outcome| format!("{outcome:?}"))
    };
    std::thread::spawn(move || [false, true, true].map(sample).to_vec()).join().unwrap()
}

/// Its shutter sticks.
#[derive(Component)]
#[component(model = "none", safety = "sensor")]
struct Light {}

/// Its brake sticks.
#[derive(Component)]
#[component(model = "none", safety = "actuator")]
struct Motor {}

impl Component for Light {
    fn make_safe(&mut self) -> Result {
        Err("it sticks".into())
    }
}

impl Component for Motor {
    fn make_safe(&mut self) -> Result {
        Err("it sticks".into())
    }
}

const DEVICES: StaticPlugin = static_plugin!(name = "devices", Camera, Light, Motor);

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_a_callback_is_its_threads_own_on_the_bench_as_in_a_host() -> Done {
    let told = ["panicked", "Ok(())", "Ok(())"];
    let host = Embedded::builder().plugin(DEVICES).start().await?;
    host.create("host/camera", "camera", json!({})).await?;
    host.start("host/camera").await?;
    assert_eq!(tokio::task::spawn_blocking(three_samples).await.unwrap(), told);
    assert_eq!(host.invoke("host/camera/ctl/ask", json!(null)).await?.value, Some(json!(1)));
    let in_host = format!("{:?}", host.state("host/camera").await?).to_uppercase();
    assert_eq!(host.detail("host/camera").await?.warnings, Vec::<String>::new());
    host.shutdown().await;

    let mut bench = Bench::<Camera>::new("{}");
    assert_eq!(three_samples(), told);
    assert_eq!(bench.command::<(), u64>("ask", ()), Ok(1));
    assert_eq!((bench.life().to_string(), bench.made_safe()), (in_host, 0));
    assert_eq!(bench.warnings(), Vec::<String>::new());
    assert_eq!(bench.callbacks(), (3, 0), "the one that panicked came in, and left again");
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refused_make_safe_is_a_warning_of_a_sensor_and_a_fault_of_an_actuator_on_both() -> Done {
    let host = Embedded::builder().plugin(DEVICES).start().await?;
    for name in ["light", "motor"] {
        let path = format!("host/{name}");
        host.create(&path, name, json!({})).await?;
        host.start(&path).await?;
    }
    let (light, motor) = (host.stop("host/light").await, host.stop("host/motor").await);
    assert_eq!(host.detail("host/light").await?.warnings, ["make_safe: it sticks"]);
    assert_eq!(host.detail("host/motor").await?.warnings, ["make_safe: it sticks"]);
    let standing = |state| format!("{state:?}").to_uppercase();
    let in_host = [standing(host.state("host/light").await?), standing(host.state("host/motor").await?)];
    let goes_on = [host.resume("host/light").await.is_ok(), host.resume("host/motor").await.is_ok()];
    host.shutdown().await;

    let (mut a, mut b) = (Bench::<Light>::new("{}"), Bench::<Motor>::new("{}"));
    assert_eq!([a.stop().is_ok(), b.stop().is_ok()], [light.is_ok(), motor.is_ok()]);
    assert_eq!(a.warnings(), ["make_safe: it sticks"]);
    assert_eq!(b.warnings(), ["make_safe: it sticks"]);
    for (bench, host) in [a.life(), b.life()].iter().zip(in_host) {
        assert!(host.starts_with(&bench.to_string()), "{bench} on the bench, {host} in the host");
    }
    assert_eq!([a.resume().is_ok(), b.resume().is_ok()], goes_on);
    assert_eq!(goes_on, [true, false]);
    assert_eq!((a.reset(), a.warnings().len()), (Ok(()), 0));
    Ok(())
}
