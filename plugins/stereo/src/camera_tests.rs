//! The camera on a machine that may have one or not.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::testing::{Bench, assert_implements, contracts};

use crate::watchdog::Watchdog;

#[path = "../../../tests/src/skip.rs"]
#[allow(unreachable_pub)]
mod skip;

/// The camera of this machine that is tried.
const DEVICE: &str = "/dev/video0";

#[test]
fn the_camera_of_this_machine_sends_whole_pictures_that_get_younger() {
    if !std::path::Path::new(DEVICE).exists() {
        return skip::skip(&format!("there is no {DEVICE}"));
    }
    let mut refused = Vec::new();
    for format in ["yuyv", "mjpg"] {
        let config = format!(r#"{{"device": "{DEVICE}", "format": "{format}", "restart": false}}"#);
        let mut bench = Bench::<Camera>::ready(config);
        if let Err(why) = bench.start() {
            refused.push(why.reason);
            continue;
        }
        let (mut watchdog, mut seen) = (Watchdog::of("three pictures"), Vec::new());
        while seen.len() < 3 {
            bench.step(1);
            seen.extend(bench.frames::<StereoHeader>("image"));
            let state = bench.state().operating_state;
            watchdog.saw(format_args!("{} pictures, {state:?}", seen.len()));
            std::thread::yield_now();
        }
        for (header, bytes, _) in &seen {
            assert_eq!((header.width, header.height), (640, 480));
            header.images(bytes).unwrap();
        }
        for pair in seen.windows(2) {
            assert!(pair[1].0.index > pair[0].0.index && pair[1].0.stamp >= pair[0].0.stamp);
        }
        return bench.stop().unwrap();
    }
    // Somebody else's, busy, no camera for pictures of this size: nothing that the plugin could do better.
    skip::skip(&refused.join("; "));
}

#[test]
fn a_camera_that_is_not_there_is_refused_at_start_and_not_before() {
    let mut bench = Bench::<Camera>::ready(r#"{"device": "/dev/video987"}"#);
    let why = bench.start().unwrap_err().reason;
    assert!(why.starts_with("device: /dev/video987 cannot be opened: No such file"), "{why}");
    assert!(why.contains("there is"), "{why}");
}

#[test]
fn a_file_that_is_no_camera_is_refused() {
    let mut bench = Bench::<Camera>::ready(r#"{"device": "/dev/null"}"#);
    let why = bench.start().unwrap_err().reason;
    assert!(why.starts_with("device: /dev/null is no video device; there is"), "{why}");
}

#[test]
fn sizes_and_formats_that_are_none_are_refused() {
    let refused = |config: &str| Bench::<Camera>::created().configure(config).unwrap_err().reason;
    assert!(refused(r#"{"width": 641}"#).contains("YUYV wants an even width"));
    assert!(refused(r#"{"format": "h264"}"#).contains(r#""h264" is not one of"#));
    assert_eq!(refused(r#"{"width": 0}"#), "width: 0 px is below 1 px");
}

#[test]
fn the_camera_fulfils_the_contract_of_cameras() {
    assert_implements::<Camera>(&contracts::CAMERA);
}
