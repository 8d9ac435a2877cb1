//! The source on the bench, on pictures of two pixels.
#![allow(clippy::unwrap_used)]

use super::*;
use image::{GrayImage, RgbImage};
use std::path::PathBuf;
use tempfile::TempDir;
use trocar_sdk::testing::{Bench, assert_behaves_as_camera, assert_implements, contracts};

trocar_sdk::testing::count_allocations!();

/// Two grey pairs of 2×1 pixels; every byte names its picture.
fn folder() -> TempDir {
    let dir = TempDir::new().unwrap();
    for (name, value) in [("left1", 10), ("right1", 11), ("left2", 20), ("right2", 21)] {
        let picture = GrayImage::from_pixel(2, 1, image::Luma([value]));
        picture.save(dir.path().join(name).with_extension("png")).unwrap();
    }
    dir
}

fn config(dir: &TempDir, format: &str) -> String {
    trocar_sdk::serde_json::json!({ "directory": dir.path(), "format": format }).to_string()
}

#[test]
fn pairs_come_in_order_and_begin_again() {
    let dir = folder();
    let mut bench = Bench::<ImageSource>::new(config(&dir, "as_stored"));
    bench.step(3);
    let frames = bench.frames::<StereoHeader>("image");
    let told: Vec<_> = frames.iter().map(|(h, bytes, _)| (h.index, bytes.clone())).collect();
    assert_eq!(told, [(0, vec![10, 10, 11, 11]), (1, vec![20, 20, 21, 21]), (2, vec![10, 10, 11, 11])]);
    let (header, _, stamp) = &frames[2];
    assert_eq!(
        *header,
        StereoHeader {
            stamp: bench.now(),
            index: 2,
            width: 2,
            height: 1,
            stride: 2,
            format: PixelFormat::GRAY8,
            right_offset: 2
        }
    );
    assert_eq!(*stamp, bench.now());
    assert_eq!((bench.state().emitted, bench.state().pairs), (3, 2));
    bench.assert_no_alloc(|bench| bench.step(10));
}

#[test]
fn grey_pictures_become_colour_when_asked() {
    let dir = folder();
    let mut bench = Bench::<ImageSource>::new(config(&dir, "rgb8"));
    bench.step(1);
    let (header, bytes, _) = bench.frames::<StereoHeader>("image").remove(0);
    assert_eq!((header.format, header.stride, header.right_offset), (PixelFormat::RGB8, 6, 6));
    assert_eq!(bytes, [[10; 6], [11; 6]].concat());
}

#[test]
fn the_geometry_tells_size_and_rate() {
    let dir = folder();
    let mut bench = Bench::<ImageSource>::new(config(&dir, "as_stored"));
    bench.step(1);
    let camera: CameraGeometry = bench.read("camera_geometry", ()).unwrap();
    assert_eq!((camera.width, camera.height), (2, 1));
    assert!((camera.fps - 30.0).abs() < 1e-6, "{} Hz", camera.fps);
}

#[test]
fn a_pair_that_finds_no_frame_is_counted_and_its_index_is_missing() {
    let dir = folder();
    let mut bench = Bench::<ImageSource>::new(config(&dir, "as_stored"));
    bench.exhaust("image", true);
    bench.step(2);
    bench.exhaust("image", false);
    bench.step(1);
    assert_eq!((bench.state().emitted, bench.state().left_out), (1, 2));
    assert_eq!(bench.events::<u64>("camera/frame_dropped"), [1, 2]);
    assert_eq!(bench.frames::<StereoHeader>("image")[0].0.index, 2);
}

#[test]
fn a_folder_without_pairs_is_refused_by_name_and_the_former_one_stays() {
    let (dir, empty) = (folder(), TempDir::new().unwrap());
    let mut bench = Bench::<ImageSource>::ready(config(&dir, "as_stored"));
    let refused = bench.configure(config(&empty, "as_stored")).unwrap_err().reason;
    assert!(refused.starts_with(&format!("directory: {}", empty.path().display())), "{refused}");
    assert!(refused.contains("left1.png"), "{refused}");
    bench.start().unwrap();
    bench.step(1);
    assert_eq!(bench.state().emitted, 1);
}

#[test]
fn a_directory_has_no_default() {
    let refused = Bench::<ImageSource>::created().configure("{}").unwrap_err();
    assert_eq!(refused.reason, "directory: is required and has no default");
}

#[test]
fn pairs_of_different_sizes_are_refused() {
    let dir = folder();
    RgbImage::new(3, 1).save(dir.path().join("right2.png")).unwrap();
    let refused = Bench::<ImageSource>::created().configure(config(&dir, "as_stored")).unwrap_err().reason;
    assert!(refused.contains("3×1 px"), "{refused}");
}

#[test]
fn the_shipped_chessboard_pairs_load() {
    let directory = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/chessboard");
    let config = trocar_sdk::serde_json::json!({ "directory": directory }).to_string();
    let bench = Bench::<ImageSource>::ready(config);
    let s = bench.state();
    assert_eq!((s.pairs, s.geometry.width, s.geometry.height), (13, 640, 480));
}

#[test]
fn the_source_fulfils_the_contract_of_cameras() {
    assert_implements::<ImageSource>(&contracts::CAMERA);
}

#[test]
fn the_source_behaves_as_the_contract_of_cameras_says() {
    let dir = folder();
    for format in ["as_stored", "rgb8"] {
        assert_behaves_as_camera(&mut Bench::<ImageSource>::new(config(&dir, format)), "camera");
    }
}
