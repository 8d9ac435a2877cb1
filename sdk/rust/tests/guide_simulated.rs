//! The component the plugin guide shows for simulated devices: what its ports are tagged.
#![allow(clippy::unwrap_used)]

use trocar_plugin_api::manifest::Manifest;
use trocar_sdk::data::Pose;
use trocar_sdk::testing::Bench;
use trocar_sdk::{StaticPlugin, prelude::*, static_plugin};

/// A simulated range finder at the tip of a simulated arm.
#[derive(Component)]
#[component(rate_hz = 1000, safety = "sensor", provides("truth"))]
struct RangeFinder {
    /// Where the tip really is: for simulated devices only.
    #[input(tag = "sim")]
    tip: In<Pose>,
    #[output]
    range: Out<f64>,
    #[state]
    really_m: f64,
}

#[provides("truth", tag = "truth")]
impl RangeFinder {
    /// The distance without noise.
    #[read(unit = "m")]
    fn distance(s: &RangeFinderState) -> f64 {
        s.really_m
    }
}

impl Component for RangeFinder {
    fn step(&mut self, _: &Tick) -> Result {
        let Some(tip) = self.tip.latest() else { return Ok(()) };
        self.really_m = -tip.position[2];
        self.range.write(&(self.really_m + 1e-6));
        Ok(())
    }
}

const CLASSES: StaticPlugin = static_plugin!(name = "simulated", RangeFinder);

#[test]
fn tags_are_in_the_manifest() {
    let manifest = Manifest::parse(CLASSES.manifest.as_bytes()).unwrap();
    let class = &manifest.classes[0];
    let tags = (class.inputs[0].tag.as_str(), class.outputs[0].tag.as_str(), class.provided[0].tag.as_str());
    assert_eq!(tags, ("sim", "", "truth"));
}

#[test]
fn a_test_is_told_the_truth() {
    let mut bench = Bench::<RangeFinder>::new("{}");
    bench.push("tip", Pose { position: [0.0, 0.0, -1e-3], ..Pose::default() });
    bench.step(1);
    assert_eq!(bench.outputs::<f64>("range"), [1e-3 + 1e-6]);
    assert_eq!(bench.read::<(), f64>("truth/distance", ()).unwrap(), 1e-3);
}
