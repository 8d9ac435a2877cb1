//! Calls of a component in another process.

use serde_json::json;
use trocar::model::ExecutionModel;

use super::bare;
use super::site::Site;
use crate::lab::model;
use crate::table::{Goal, Table, median};

/// Round trips per round, and rounds of each in turn; the median counts.
const TRIPS: usize = 5000;
const ROUNDS: usize = 9;

pub(super) fn measure(table: &mut Table) {
    let site = Site::new();
    let lab = &site.lab;
    lab.create("far/target", "target", model(ExecutionModel::OnSignal));
    lab.create("near/caller", "gauge", model(ExecutionModel::None));
    lab.connect("near/caller/peer", "far/target/ctl");
    lab.start();
    let (mut trips, mut bares) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        trips.push(lab.invoke("near/caller/time/trip", json!(TRIPS)).as_f64().unwrap_or(f64::NAN));
        bares.push(bare::ping_pong(TRIPS));
    }
    table.title("A call of a component in another process");
    let beside = "two bare ways, there and back";
    table.row(
        "blocking round trip to a sleeping component",
        median(trips),
        Goal::Times(1.15),
        beside,
        median(bares),
    );
}
