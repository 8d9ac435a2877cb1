//! The camera on a machine that may have one or not.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::testing::{Bench, assert_implements, contracts};

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
