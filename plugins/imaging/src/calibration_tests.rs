//! Calibrations that are taken and those that are refused.

use super::*;
use serde_json::{Value, json};

fn good() -> Value {
    let side = |shift: f64| {
        json!({
            "matrix": [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]],
            "distortion": [-0.25, 0.1, 0.001, -0.002, 0.01],
            "rectification": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "projection": [[490.0, 0.0, 300.0, shift], [0.0, 490.0, 250.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        })
    };
    json!({"format": FORMAT, "version": 1, "image_size": [640, 480], "left": side(0.0), "right": side(-24.5)})
}

/// The sentence for a calibration in which the value at `pointer` is another one; without a value it is taken
/// away.
fn refused(pointer: &str, value: Option<Value>) -> String {
    let mut file = good();
    match value {
        Some(value) => *file.pointer_mut(pointer).expect("a key of the good one") = value,
        None => {
            let (parent, key) = pointer.rsplit_once('/').expect("begins with /");
            file.pointer_mut(parent).and_then(Value::as_object_mut).expect("an object").remove(key);
        }
    }
    Calibration::parse(&file.to_string()).expect_err("it is bad").to_string()
}

#[test]
fn a_good_calibration_says_what_rectified_images_measure() {
    let calibration = Calibration::parse(&good().to_string()).expect("good");
    assert_eq!((calibration.width, calibration.height), (640, 480));
    assert_eq!((calibration.focal_px, calibration.offset_px), (490.0, 0.0));
    assert!((calibration.baseline_m - 0.05).abs() < 1e-12);
}

#[test]
fn a_missing_key_is_named() {
    for key in ["image_size", "left", "right", "format"] {
        let why = refused(&format!("/{key}"), None);
        assert!(why.contains(&format!("missing field `{key}`")) && why.contains("calibrate.py"), "{why}");
    }
    assert!(refused("/left/projection", None).contains("missing field `projection`"));
}

#[test]
fn singular_matrices_no_rotations_and_no_baseline_are_refused_with_the_key() {
    assert_eq!(
        refused("/left/matrix/0/0", Some(json!(0.0))),
        "left.matrix: focal lengths 0 and 510 px are not both at least 0.001 px: it is singular"
    );
    assert!(
        refused("/right/projection/1/1", Some(json!(0.0))).starts_with("right.projection: focal lengths")
    );
    assert!(refused("/left/matrix/2/2", Some(json!(0.0))).contains("0 0 1"));
    assert!(
        refused("/left/rectification/0/0", Some(json!(0.5)))
            .starts_with("left.rectification: it is no rotation")
    );
    let mirror = refused("/right/rectification/2/2", Some(json!(-1.0)));
    assert!(mirror.contains("determinant is -1"), "{mirror}");
    assert!(refused("/right/projection/0/3", Some(json!(0.0))).contains("baseline of -0 m is not above 0"));
    assert!(refused("/right/projection/0/3", Some(json!(9.8))).contains("left and right are swapped"));
    assert!(refused("/right/projection/0/0", Some(json!(1e-300))).contains("it is singular"));
    assert!(
        refused("/left/rectification/1/2", Some(json!(1e308)))
            .contains("left.rectification: number 5 is 1e308, not between -1e9 and 1e9")
    );
}

#[test]
fn projections_whose_rows_or_scales_differ_are_refused_with_what_differs() {
    for (pointer, other, says) in [
        ("/right/projection/0/0", 480.0, "fx (490 and 480 px)"),
        ("/left/projection/1/1", 480.0, "fy (480 and 490 px)"),
        ("/right/projection/1/2", 251.0, "cy (250 and 251 px)"),
        ("/left/projection/0/1", 2.0, "skew (2 and 0 px)"),
        // Cameras one above the other.
        ("/right/projection/1/3", -24.5, "row of the camera (0 and -24.5 px)"),
    ] {
        let why = refused(pointer, Some(json!(other)));
        assert_eq!(
            why,
            format!(
                "projection: left and right must be equal in {says}, or rows of the rectified images do not agree: \
                 calibrate again"
            )
        );
    }
    let mut both = good();
    both["right"]["projection"][1] = json!([0.0, 489.0, 251.0, 0.0]);
    let why = Calibration::parse(&both.to_string()).expect_err("two differ").to_string();
    assert!(why.contains("in fy (490 and 489 px), cy (250 and 251 px), or"), "{why}");
    // A fit differs in the last places, which is no difference, and columns of principal points may differ.
    let mut near = good();
    near["right"]["projection"][1][2] = json!(250.0 + 1e-9);
    near["right"]["projection"][0][2] = json!(330.0);
    assert!((Calibration::parse(&near.to_string()).expect("near").offset_px - 30.0).abs() < 1e-9);
    assert!(refused("/right/projection/2/3", Some(json!(0.1))).contains("another place than beside"));
    assert!(refused("/left/projection/0/3", Some(json!(3.0))).contains("another place than beside"));
}

#[test]
fn whatever_numbers_stand_in_the_file_it_is_refused_or_can_rectify() {
    let extremes = [0.0, -0.0, 1.0, -1.0, 1e-308, 1e308, -1e308, 5e-324, 1e154, 490.0];
    let mut rng = fastrand::Rng::with_seed(17);
    let mut taken = 0;
    for _ in 0..4_000 {
        let mut file = good();
        for _ in 0..rng.usize(1..3) {
            let side = if rng.bool() { "left" } else { "right" };
            let value = json!(extremes[rng.usize(..extremes.len())]);
            match rng.usize(..4) {
                0 => file[side]["matrix"][rng.usize(..3)][rng.usize(..3)] = value,
                1 => file[side]["distortion"][rng.usize(..5)] = value,
                2 => file[side]["rectification"][rng.usize(..3)][rng.usize(..3)] = value,
                _ => file[side]["projection"][rng.usize(..3)][rng.usize(..4)] = value,
            }
        }
        let Ok(calibration) = Calibration::parse(&file.to_string()) else { continue };
        taken += 1;
        let numbers = [calibration.focal_px, calibration.baseline_m, calibration.offset_px];
        assert!(numbers.iter().all(|n| n.is_finite()) && calibration.baseline_m > 0.0, "{file}");
        for camera in &calibration.cameras {
            for (u, v) in [(0.0, 0.0), (639.0, 479.0), (320.0, 1.0)] {
                let _ = (camera.source(u, v), camera.rectified(u, v));
            }
        }
    }
    assert!(taken > 100, "{taken}");
}

#[test]
fn wrong_shapes_and_sizes_are_refused() {
    assert!(refused("/left/distortion", Some(json!([0.0, 0.0, 0.0]))).contains("3 numbers; give 4"));
    assert!(refused("/image_size", Some(json!([640, 0]))).contains("640 × 0 px"));
    assert!(refused("/image_size", Some(json!([640]))).starts_with("no calibration: invalid length 1"));
    assert!(refused("/left/matrix", Some(json!([[1.0]]))).contains("invalid length"));
    assert!(refused("/version", Some(json!(2))).contains("version 2, not"));
    // The largest that JSON can say is beyond a double: serde refuses it, and so it never comes to us.
    let huge = good().to_string().replacen("0.001", "1e999", 1);
    assert!(Calibration::parse(&huge).is_err());
}

#[test]
fn a_file_that_is_not_there_or_cannot_be_used_is_named() {
    let why = Calibration::load(Path::new("nowhere/at/all.json")).expect_err("missing").to_string();
    assert!(why.starts_with("nowhere/at/all.json: cannot be read"), "{why}");
    let dir = tempfile::tempdir().expect("a directory");
    let path = dir.path().join("singular.json");
    let mut file = good();
    file["right"]["matrix"][1][1] = json!(0.0);
    std::fs::write(&path, file.to_string()).expect("written");
    let why = Calibration::load(&path).expect_err("singular").to_string();
    assert_eq!(
        why,
        format!(
            "{}: right.matrix: focal lengths 500 and 0 px are not both at least 0.001 px: it is singular",
            path.display()
        )
    );
}

#[test]
fn a_pixel_taken_to_the_rectified_image_and_back_is_the_same_pixel() {
    let camera = &Calibration::parse(&good().to_string()).expect("good").cameras[0];
    for v in (0..480).step_by(37) {
        for u in (0..640).step_by(41) {
            let (u, v) = (f64::from(u), f64::from(v));
            let (x, y) = camera.rectified(u, v).expect("this lens has an inverse");
            let (back_u, back_v) = camera.source(x, y);
            assert!(
                (back_u - u).abs() < 1e-5 && (back_v - v).abs() < 1e-5,
                "({u}, {v}) came back as ({back_u}, {back_v})"
            );
        }
    }
}

#[test]
fn the_centre_of_the_lens_has_no_distortion() {
    let camera = &Calibration::parse(&good().to_string()).expect("good").cameras[0];
    assert_eq!(camera.source(300.0, 250.0), (320.0, 240.0));
}
