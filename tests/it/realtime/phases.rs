//! The place in its period at which a component steps: behind what feeds it, as GetState shows it.
//!
//! Promise: the place follows the connections, a place that was set is kept, and no cycle is lost for either.

use serde_json::{Value, json};
use trocar_tests::{Grpcurl, HostProcess, World, eventually, number};

/// A robot and a force sensor that takes its tip, each on a thread of its own at 1 kHz, as their classes say.
pub(super) struct Pair {
    pub(super) grpc: Grpcurl,
    _host: HostProcess,
    _world: World,
}

impl Pair {
    pub(super) fn new() -> Pair {
        let world = World::with_plugins(&["eyerobot", "force_sensor"]);
        let host = HostProcess::start(&world);
        let grpc = host.grpcurl();
        grpc.await_class("host", "force_sensor");
        Pair { grpc, _host: host, _world: world }
    }

    /// `host/robotN` and `host/sensorN`, connected and running.
    pub(super) fn add(&self, n: u32, robot: Value, sensor: Value) {
        let [source, reader] = [format!("host/robot{n}"), format!("host/sensor{n}")];
        self.grpc.create_with(&source, "eyerobot/eyerobot", json!({}), robot);
        self.grpc.create_with(&reader, "force-sensor/force_sensor", json!({}), sensor);
        self.connect(n);
        for path in [source, reader] {
            self.grpc.start(&path);
        }
    }

    fn connect(&self, n: u32) {
        let ends = json!({ "client": format!("host/sensor{n}/tip"), "server": format!("host/robot{n}/tip") });
        self.grpc.ok("GcmService/Connect", ends);
    }

    /// Waits until it steps there, µs.
    fn steps_at(&self, path: &str, us: u64, auto: bool) {
        eventually(&format!("{path} steps at {us} µs"), || {
            let stats = self.grpc.component(path)["stats"].clone();
            let at = (number(&stats["phaseNs"]), stats["phaseAuto"] == true);
            if at == (us * 1_000, auto) { Ok(()) } else { Err(stats) }
        });
    }
}

#[test]
fn a_reader_steps_behind_what_feeds_it_until_they_are_parted() {
    let pair = Pair::new();
    pair.add(1, json!({}), json!({}));
    pair.steps_at("host/robot1", 0, true);
    pair.steps_at("host/sensor1", 500, true);
    pair.grpc.ok("GcmService/Disconnect", json!({ "id": "1" }));
    pair.steps_at("host/sensor1", 0, true);
}

#[test]
fn a_place_that_was_set_is_kept_and_the_other_end_goes_by_it() {
    let pair = Pair::new();
    pair.add(1, json!({ "phase": "0.0003s" }), json!({}));
    pair.steps_at("host/robot1", 300, false);
    pair.steps_at("host/sensor1", 800, true);
    pair.add(2, json!({}), json!({ "phase": "0s" }));
    pair.steps_at("host/sensor2", 0, false);
    // As much is kept between the reader and the next step of the robot as behind its step.
    pair.steps_at("host/robot2", 375, true);
}
