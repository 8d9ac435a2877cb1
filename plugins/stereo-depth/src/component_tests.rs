//! The component on the bench, on small pairs of random dots.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::{NONE, SCALE};
use trocar_sdk::testing::Bench;

trocar_sdk::testing::count_allocations!();

const CONFIG: &str = r#"{"method": "bm", "n_disp": 32, "block": 7, "width": 96, "height": 40,
    "focal_px": 400, "baseline_m": 0.005}"#;

/// Random dots, the left image shifted by `shift` px.
fn pair(shift: usize, index: u64) -> (StereoHeader, Vec<u8>) {
    let mut rng = fastrand::Rng::with_seed(index);
    let mut dots: Vec<Vec<u8>> = Vec::new();
    for _ in 0..40 {
        dots.push(std::iter::repeat_with(|| rng.u8(..)).take(96 + shift).collect());
    }
    let left = dots.iter().flat_map(|row| row[..96].to_vec());
    let right = dots.iter().flat_map(|row| row[shift..].to_vec());
    let header = StereoHeader {
        index,
        width: 96,
        height: 40,
        stride: 96,
        format: PixelFormat::GRAY8,
        right_offset: 96 * 40,
        ..Default::default()
    };
    (header, left.chain(right).collect())
}

fn push(bench: &mut Bench<StereoDepth>, shift: usize, index: u64) {
    let (header, bytes) = pair(shift, index);
    bench.push_frame("rectified", header, &bytes);
    bench.step(1);
}

#[test]
fn disparity_and_depth_come_with_index_and_stamp_of_the_pair() {
    let mut bench = Bench::<StereoDepth>::new(CONFIG);
    let (header, bytes) = pair(8, 5);
    bench.push_frame("rectified", header, &bytes);
    let pushed = bench.now();
    bench.step(1);
    let (header, bytes, stamp) = bench.frames::<ImageHeader>("disparity").remove(0);
    assert_eq!(
        (header.index, header.format, header.stride, stamp),
        (5, PixelFormat::DISPARITY16, 192, pushed)
    );
    let at = |u: usize, v: usize| 2 * (96 * v + u);
    let disparity = |u, v| i16::from_ne_bytes([bytes[at(u, v)], bytes[at(u, v) + 1]]);
    // Dots have no slope: to a fraction of a pixel their place is not certain.
    assert!((disparity(50, 20) - 8 * SCALE).abs() <= 4, "{}", disparity(50, 20));
    assert_eq!(disparity(0, 0), NONE);
    let (header, bytes, _) = bench.frames::<ImageHeader>("depth").remove(0);
    assert_eq!((header.format, header.stride), (PixelFormat::DEPTH32F, 384));
    let depth = |u, v| f32::from_ne_bytes(bytes[2 * at(u, v)..][..4].try_into().unwrap());
    // 400 px · 5 mm over the disparity.
    let exact = 400.0 * 0.005 * f32::from(SCALE) / f32::from(disparity(50, 20));
    assert!((depth(50, 20) - exact).abs() < 1e-6);
    assert!(depth(0, 0).is_nan());
    let state = bench.state();
    assert_eq!((state.frames, state.rejected), (1, 0));
    assert!(state.density > 0.5 && state.density < 0.9, "{}", state.density);
}

#[test]
fn depth_at_answers_for_a_pixel_and_says_when_it_cannot() {
    let mut bench = Bench::<StereoDepth>::new(CONFIG);
    let at = |bench: &mut Bench<StereoDepth>, u, v| {
        bench.command::<Pixel, Distance>("map/depth_at", Pixel { u, v })
    };
    assert!(at(&mut bench, 1, 1).unwrap_err().to_string().contains("no pair has come yet"));
    push(&mut bench, 8, 1);
    let there = at(&mut bench, 50, 20).unwrap();
    assert!(there.valid.get() && there.stamp.is_valid() && (there.distance - 0.25).abs() < 0.01, "{there:?}");
    let nothing = at(&mut bench, 0, 0).unwrap();
    assert!(!nothing.valid.get() && !nothing.stamp.is_valid());
    let outside = at(&mut bench, 96, 3).unwrap_err().to_string();
    assert!(outside.contains("(96, 3) px is outside of the image: u is 0 to 95, v 0 to 39"), "{outside}");
}

#[test]
fn a_refused_configuration_leaves_the_cameras_as_they_were() {
    let mut bench = Bench::<StereoDepth>::new(CONFIG);
    bench.stop().unwrap();
    let other = CONFIG.replace("0.005", "0.010").replace("\"n_disp\": 32", "\"n_disp\": 80");
    let refused = bench.configure(other).unwrap_err();
    assert!(refused.reason.contains("80"), "{}", refused.reason);
    bench.start().unwrap();
    push(&mut bench, 8, 1);
    let there = bench.command::<Pixel, Distance>("map/depth_at", Pixel { u: 50, v: 20 }).unwrap();
    assert!((there.distance - 0.25).abs() < 0.01, "{there:?}");
}

#[test]
fn without_cameras_there_is_disparity_only() {
    let mut bench =
        Bench::<StereoDepth>::new(r#"{"method": "sgm", "n_disp": 32, "width": 96, "height": 40}"#);
    push(&mut bench, 8, 1);
    assert_eq!(bench.frames::<ImageHeader>("disparity").len(), 1);
    assert_eq!(bench.frames::<ImageHeader>("depth").len(), 0);
    let why =
        bench.command::<Pixel, Distance>("map/depth_at", Pixel { u: 50, v: 20 }).unwrap_err().to_string();
    assert!(why.contains("focal_px and baseline_m"), "{why}");
}

#[test]
fn method_and_range_change_while_it_runs() {
    let mut bench = Bench::<StereoDepth>::new(CONFIG);
    push(&mut bench, 40, 1);
    let known = |bench: &mut Bench<StereoDepth>| {
        let (_, bytes, _) = bench.frames::<ImageHeader>("disparity").pop().unwrap();
        bytes.as_chunks::<2>().0.iter().filter(|d| (i16::from_ne_bytes(**d) - 40 * SCALE).abs() <= 8).count()
    };
    assert_eq!(known(&mut bench), 0, "40 px are beyond 32");
    bench.configure(CONFIG.replace("32", "64")).unwrap();
    push(&mut bench, 40, 2);
    assert!(known(&mut bench) > 1000);
    bench.configure(CONFIG.replace("32", "64").replace("bm", "sgm")).unwrap();
    push(&mut bench, 40, 3);
    assert!(known(&mut bench) > 1500);
}

#[test]
fn frames_of_wrong_sizes_and_formats_are_counted_and_the_next_one_is_taken() {
    let mut bench = Bench::<StereoDepth>::new(CONFIG);
    let (good, bytes) = pair(8, 1);
    let all = bytes.len();
    let (size, lie, format) = ("configure the size", "right_offset", "GRAY8 or RGB8");
    let right = |right_offset| StereoHeader { right_offset, ..good };
    let of = |format| StereoHeader { format, ..good };
    let mut bad = vec![
        (StereoHeader { width: 95, ..good }, all, size),
        (StereoHeader { height: 39, ..good }, all, size),
        (StereoHeader { width: 1, height: 1, ..good }, all, size),
        (good, all - 1, lie),
        (good, all / 2, lie),
        (good, 0, lie),
        (StereoHeader::default(), all, format),
    ];
    bad.extend([0, 97, 1 << 31, u32::MAX].map(|width| (StereoHeader { width, ..good }, all, lie)));
    bad.extend([0, 41, 1 << 31, u32::MAX].map(|height| (StereoHeader { height, ..good }, all, lie)));
    bad.extend([0, 95, 97, u32::MAX].map(|stride| (StereoHeader { stride, ..good }, all, lie)));
    bad.extend([96 * 40 + 1, all as u64, 1 << 63, u64::MAX].map(|offset| (right(offset), all, lie)));
    let formats = [PixelFormat::YUYV, PixelFormat::GRAY16, PixelFormat::DEPTH32F, PixelFormat(u32::MAX)];
    bad.extend(formats.map(|f| (of(f), all, format)));
    for (n, (header, there, says)) in (1..).zip(bad) {
        bench.assert_no_alloc(|bench| {
            bench.push_frame("rectified", header, &bytes[..there]);
            bench.step(1);
        });
        let state = bench.state();
        assert_eq!((state.frames, state.rejected), (n - 1, n), "{header:?} with {there} B");
        assert!(state.problem.contains(says), "{} for {header:?}", state.problem);
        assert!(bench.frames::<ImageHeader>("disparity").is_empty(), "{header:?}");
        push(&mut bench, 8, 2);
        assert_eq!(bench.state().frames, n, "behind {header:?}");
        assert_eq!(bench.frames::<ImageHeader>("disparity").len(), 1);
    }
    let mut bench = Bench::<StereoDepth>::new(CONFIG);
    push(&mut bench, 8, 2);
    assert_eq!(bench.state().frames, 1);
    bench.exhaust("depth", true);
    push(&mut bench, 8, 3);
    assert!(bench.state().problem.contains("held by readers"));
}

#[test]
fn pairs_side_by_side_give_the_same_map_and_one_image_for_both_eyes_is_infinitely_far() {
    let mut bench = Bench::<StereoDepth>::new(CONFIG);
    let (header, bytes) = pair(8, 1);
    let map = |bench: &mut Bench<StereoDepth>, header, bytes: &[u8]| {
        bench.push_frame("rectified", header, bytes);
        bench.step(1);
        bench.frames::<ImageHeader>("disparity").pop().unwrap().1
    };
    let stacked = map(&mut bench, header, &bytes);
    let (left, right) = bytes.split_at(96 * 40);
    let beside: Vec<u8> = left.chunks(96).zip(right.chunks(96)).flat_map(|(l, r)| [l, r].concat()).collect();
    let laid = StereoHeader { stride: 192, right_offset: 96, ..header };
    assert!(map(&mut bench, laid, &beside) == stacked);
    let one = map(&mut bench, StereoHeader { right_offset: 0, ..header }, left);
    assert!(one.as_chunks::<2>().0.iter().all(|d| i16::from_ne_bytes(*d) <= 4), "no disparity at all");
}

#[test]
fn configurations_that_cannot_be_are_refused_with_the_reason() {
    let refused = |config: &str| Bench::<StereoDepth>::created().configure(config).unwrap_err().reason;
    assert!(refused(r#"{"n_disp": 80}"#).contains("take 96"));
    assert!(refused(r#"{"p1": 50}"#).contains("p1 ≤ p2"));
    assert!(refused(r#"{"focal_px": 400}"#).contains("needs both above 0"));
    assert!(
        refused(r#"{"calibration": "nowhere.json"}"#)
            .starts_with("calibration: nowhere.json: cannot be read")
    );
    assert!(refused(r#"{"calibration": "x", "focal_px": 1}"#).contains("one or the other"));
    assert!(refused(r#"{"method": "ncc"}"#).contains(r#""bm", "sgm""#));
}

#[test]
fn a_calibration_whose_rows_differ_is_refused_with_its_file_and_what_differs() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("pair.json");
    let side = |cy: f64, last: f64| {
        serde_json::json!({
            "matrix": [[90.0, 0.0, 48.0], [0.0, 90.0, 20.0], [0.0, 0.0, 1.0]],
            "distortion": [0.0, 0.0, 0.0, 0.0],
            "rectification": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "projection": [[90.0, 0.0, 48.0, last], [0.0, 90.0, cy, 0.0], [0.0, 0.0, 1.0, 0.0]],
        })
    };
    let configured = |cy: f64| {
        let file = serde_json::json!({
            "format": "trocar-stereo-calibration", "version": 1, "image_size": [96, 40],
            "left": side(20.0, 0.0), "right": side(cy, -0.45),
        });
        std::fs::write(&path, file.to_string()).unwrap();
        let config = format!(r#"{{"n_disp": 32, "width": 96, "height": 40, "calibration": {path:?}}}"#);
        Bench::<StereoDepth>::created().configure(config).map_err(|refused| refused.reason)
    };
    assert_eq!(configured(20.0), Ok(()));
    let why = configured(21.5).unwrap_err();
    assert!(
        why.contains("pair.json: projection: left and right must be equal in cy (20 and 21.5 px)"),
        "{why}"
    );
}

#[test]
fn a_step_allocates_nothing() {
    for method in ["bm", "sgm"] {
        let mut bench = Bench::<StereoDepth>::new(CONFIG.replace("bm", method));
        bench.assert_no_alloc(|bench| {
            let (header, bytes) = pair(8, 1);
            bench.push_frame("rectified", header, &bytes);
            bench.step(1);
        });
        assert_eq!(bench.state().frames, 1);
    }
}
