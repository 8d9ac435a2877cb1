//! Rectification by the calibration of the 13 chessboard pairs, against what OpenCV finds and makes of them.
//!
//! Invariant: the files in `tests/data/calibration` were written by `calibrate.py`; nothing here is fitted.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::path::PathBuf;

use trocar_imaging::Calibration;
use trocar_sdk::data::{PixelFormat, StereoHeader};
use trocar_sdk::testing::Bench;
use trocar_vision_filters::remap::Remap;
use trocar_vision_filters::view::{Format, Shape, View, ViewMut};
use trocar_vision_filters::{RectifiedGeometry, Rectify};

trocar_sdk::testing::count_allocations!();

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// Corners of one picture, px.
type Corners = Vec<[f64; 2]>;

fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/calibration").join(name)
}

fn calibration() -> Calibration {
    Calibration::load(&data("chessboard.json")).unwrap()
}

fn maps() -> [Remap; 2] {
    calibration().cameras.map(|camera| Remap::new(WIDTH, HEIGHT, |u, v| camera.source(u, v)))
}

#[test]
fn rows_of_the_corners_of_all_pairs_agree_to_less_than_a_third_of_a_pixel() {
    let corners: BTreeMap<String, [Corners; 2]> =
        serde_json::from_str(&std::fs::read_to_string(data("corners.json")).unwrap()).unwrap();
    assert_eq!(corners.len(), 13);
    let [left, right] = calibration().cameras;
    let (mut squares, mut count) = (0.0, 0);
    for (pair, [lefts, rights]) in &corners {
        assert_eq!((lefts.len(), rights.len()), (54, 54), "pair {pair}");
        for (l, r) in lefts.iter().zip(rights) {
            let (xl, yl) = left.rectified(l[0], l[1]).unwrap();
            let (xr, yr) = right.rectified(r[0], r[1]).unwrap();
            assert!(xl > xr, "pair {pair}: the board is in front of the cameras");
            let (u, v) = left.source(xl, yl);
            assert!((u - l[0]).hypot(v - l[1]) < 1e-5, "the map leads back to the corner");
            squares += (yl - yr) * (yl - yr);
            count += 1;
        }
    }
    let rms_px = f64::sqrt(squares / f64::from(count));
    assert!(rms_px <= 0.30, "{rms_px} px");
}

/// A picture of the first pair, and what `calibrate.py` made three colours of.
fn picture(eye: &str) -> (Vec<u8>, Vec<u8>) {
    let gray = image::open(data(&format!("reference/{eye}01.png"))).unwrap().into_luma8().into_raw();
    assert_eq!(gray.len(), WIDTH * HEIGHT);
    let upside_down = gray.chunks(WIDTH).rev().flatten();
    let colour = gray.iter().zip(upside_down).flat_map(|(&g, &u)| [g, 255 - g, u]).collect();
    (gray, colour)
}

fn remapped(map: &Remap, format: Format, src: &[u8]) -> Vec<u8> {
    let shape = Shape { width: WIDTH, height: HEIGHT, format };
    let mut out = vec![0; src.len()];
    assert!(map.run(&View::packed(shape, src).unwrap(), &mut ViewMut::packed(shape, &mut out).unwrap()));
    out
}

#[test]
fn remapped_pictures_are_within_a_level_of_those_of_opencv() {
    for (eye, map) in ["left", "right"].into_iter().zip(maps()) {
        let (gray, colour) = picture(eye);
        let (gray, colour) = (remapped(&map, Format::Gray8, &gray), remapped(&map, Format::Rgb8, &colour));
        assert!(gray.iter().zip(colour.chunks(3)).all(|(&g, c)| g == c[0]), "grey is done as colour is");
        let (mut within, mut all) = (0, 0);
        for (x, y) in [(0, 0), (240, 180), (480, 360)] {
            let part = image::open(data(&format!("reference/{eye}01_{x}_{y}.png"))).unwrap().into_rgb8();
            for (px, py, theirs) in part.enumerate_pixels() {
                let at = 3 * ((y + py as usize) * WIDTH + x + px as usize);
                for (ours, theirs) in colour[at..at + 3].iter().zip(theirs.0) {
                    all += 1;
                    within += u32::from(ours.abs_diff(theirs) <= 1);
                }
            }
        }
        assert_eq!(all, 3 * 3 * 160 * 120);
        let share = f64::from(within) / f64::from(all);
        assert!(share >= 0.999, "{eye}: {share}");
    }
}

fn config() -> String {
    format!(r#"{{"calibration": {:?}}}"#, data("chessboard.json"))
}

#[test]
fn the_component_rectifies_both_eyes_and_says_what_the_result_measures() {
    let mut bench = Bench::<Rectify>::new(config());
    let pictures = ["left", "right"].map(|eye| picture(eye).0);
    let header = StereoHeader {
        index: 9,
        width: WIDTH as u32,
        height: HEIGHT as u32,
        stride: WIDTH as u32,
        format: PixelFormat::GRAY8,
        right_offset: (WIDTH * HEIGHT) as u64,
        ..Default::default()
    };
    let bytes = pictures.concat();
    bench.assert_no_alloc(|bench| {
        bench.push_frame("image", header, &bytes);
        bench.step(1);
    });
    let (out, bytes, _) = bench.frames::<StereoHeader>("rectified").remove(0);
    assert_eq!(out, header);
    let expected: Vec<u8> =
        maps().iter().zip(&pictures).flat_map(|(map, p)| remapped(map, Format::Gray8, p)).collect();
    assert!(bytes == expected);
    let geometry = bench.read::<(), RectifiedGeometry>("rectified_camera/geometry", ()).unwrap();
    let c = calibration();
    assert_eq!((geometry.focal, geometry.baseline, geometry.offset), (c.focal_px, c.baseline_m, c.offset_px));
    assert!((0.07..0.1).contains(&geometry.baseline), "{} m between the cameras", geometry.baseline);

    let other = StereoHeader { height: 479, ..header };
    bench.push_frame("image", other, &bytes);
    bench.step(1);
    assert!(
        bench.state().tally.problem.contains("calibrate at this size"),
        "{}",
        bench.state().tally.problem
    );
}

#[test]
fn a_calibration_that_is_missing_or_singular_is_refused_with_what_is_wrong() {
    let refused = |config: String| Bench::<Rectify>::created().configure(config).unwrap_err().reason;
    assert!(refused(r#"{"calibration": "nowhere.json"}"#.into()).contains("nowhere.json: cannot be read"));
    assert!(refused("{}".into()).contains("calibration: is required"));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("singular.json");
    let text = std::fs::read_to_string(data("chessboard.json")).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    json["left"]["projection"][0][0] = 0.0.into();
    std::fs::write(&path, json.to_string()).unwrap();
    let why = refused(format!(r#"{{"calibration": {path:?}}}"#));
    assert!(why.contains("singular.json: left.projection: focal lengths 0 and"), "{why}");
    json["left"]["projection"][0][0] = json["right"]["projection"][0][0].clone();
    json["left"]["projection"][1][2] = 1.0.into();
    std::fs::write(&path, json.to_string()).unwrap();
    let why = refused(format!(r#"{{"calibration": {path:?}}}"#));
    assert!(why.contains("must be equal in cy (1 and "), "{why}");
    std::fs::write(&path, &text[..text.len() / 2]).unwrap();
    assert!(
        refused(format!(r#"{{"calibration": {path:?}}}"#)).contains("singular.json: no calibration: EOF")
    );
}
