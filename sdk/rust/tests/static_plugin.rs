//! Plugins without a file: several in one executable, each with its manifest and its tables.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use trocar_plugin_api::manifest::Manifest;
use trocar_sdk::prelude::*;
use trocar_sdk::{StaticPlugin, static_plugin};

/// Has direct and queued handlers and a bound on its step.
#[derive(Component)]
#[component(requires("alarm", "robot"), model = "on_signal", max_step_ms = 2.5)]
struct Listener {}

#[handles("alarm", direct)]
impl Listener {
    #[on]
    fn rang(&mut self) {}
}

#[handles("robot")]
impl Listener {
    #[on(direct)]
    fn moved(&mut self, _to: f64) {}
    #[on]
    fn stopped(&mut self) {}
}

impl Component for Listener {}

#[derive(Component)]
#[component(safety = "actuator", hardware, safe_from_any_thread, rate_hz = 250)]
struct Motor {
    brake: Arc<Brake>,
}

#[derive(Default)]
struct Brake {}

impl MakeSafe for Brake {
    fn make_safe(&self) -> Result {
        Ok(())
    }
}

impl SafeFromAnyThread for Motor {
    fn safe_handle(&self) -> Arc<dyn MakeSafe> {
        self.brake.clone()
    }
}

impl Component for Motor {}

pub const FIRST: StaticPlugin = static_plugin!(Listener, Motor);
static SECOND: StaticPlugin = static_plugin!(name = "second", Motor);

fn manifest(plugin: &StaticPlugin) -> Manifest {
    Manifest::parse(plugin.manifest.as_bytes()).unwrap()
}

#[test]
fn two_plugins_live_in_one_executable_each_under_its_name() {
    let (first, second) = (manifest(&FIRST), manifest(&SECOND));
    assert_eq!((first.name.as_str(), second.name.as_str()), ("sdk", "second"));
    assert_eq!(first.classes.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["listener", "motor"]);
    assert_eq!(second.classes.len(), 1);
}

#[test]
fn the_entry_gives_the_tables_in_the_order_of_the_manifest() {
    // SAFETY: the entry of a static plugin may be called at any time; its tables are static.
    let names: Vec<String> = unsafe {
        let table = &*(FIRST.entry)();
        let classes = core::slice::from_raw_parts(table.classes, table.class_count as usize);
        let name = |b: trocar_plugin_api::abi::Bytes| core::slice::from_raw_parts(b.ptr, b.len).to_vec();
        assert_eq!(name(table.name), b"sdk");
        classes.iter().map(|c| String::from_utf8(name((**c).name)).unwrap()).collect()
    };
    assert_eq!(names, ["listener", "motor"]);
}

#[test]
fn direct_handlers_and_the_bound_of_a_step_are_in_the_manifest() {
    let class = &manifest(&FIRST).classes[0];
    let direct: Vec<(&str, bool)> =
        class.required.iter().flat_map(|r| r.handlers.iter().map(|h| (h.name.as_str(), h.direct))).collect();
    assert_eq!(direct, [("rang", true), ("moved", true), ("stopped", false)]);
    assert_eq!(class.execution.max_step_ns, 2_500_000);
    assert_eq!(class.execution.model, "on_signal");
}

#[test]
fn what_a_device_class_says_of_its_safety_is_in_the_manifest() {
    let class = &manifest(&FIRST).classes[1];
    assert_eq!((class.safety.as_str(), class.hardware, class.safe_from_any_thread), ("actuator", true, true));
    assert_eq!((class.execution.period_ns, class.execution.max_step_ns), (4_000_000, 0));
}
