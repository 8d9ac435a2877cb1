//! Colours, bar and gaps of pictures of depth.

use super::*;
use trocar_sdk::data::{PixelFormat, StereoHeader};

/// An image of depths, m, with so many columns.
fn drawn(depths: &[f32], columns: u32, settings: Settings) -> (Picture, Scale) {
    let bytes: Vec<u8> = depths.iter().flat_map(|depth| depth.to_ne_bytes()).collect();
    let (height, stride) = (depths.len() as u32 / columns, 4 * columns);
    let format = PixelFormat::DEPTH32F;
    let header = StereoHeader { width: columns, height, stride, format, ..StereoHeader::default() };
    let images = &header.images(&bytes).expect("fits")[..1];
    (draw(images, &settings), Scale::of(images, &settings))
}

fn at(picture: &Picture, x: usize, y: usize) -> [u8; 3] {
    *picture.rgb[3 * (y * picture.width as usize + x)..].first_chunk().expect("a pixel")
}

/// Brightness as people see it (CIE 1931, of sRGB).
fn brightness(color: [u8; 3]) -> f64 {
    let linear = color.map(|level| (f64::from(level) / 255.0).powf(2.2));
    0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
}

#[test]
fn nearer_is_brighter_all_the_way() {
    let all: Vec<f64> = (0..=200).map(|n| brightness(viridis(f64::from(n) / 200.0))).collect();
    assert!(all.is_sorted(), "{all:?}");
    assert_eq!([viridis(0.0), viridis(1.0)], [VIRIDIS[0], VIRIDIS[8]]);
}

#[test]
fn the_ends_of_the_bar_are_the_colours_of_the_ends_of_the_range() {
    let ramp: Vec<f32> = (0..200 * 160).map(|n| 0.199 + 0.002 * (n % 200) as f32 / 199.0).collect();
    let settings = Settings { plane_m: Some(0.2), range_m: None };
    let (picture, scale) = drawn(&ramp, 200, settings);
    let [near, far] = scale.range_m;
    assert!((near + 1e-3).abs() < 1e-9 && (far - 1e-3).abs() < 1e-9, "{scale:?}");
    let (x, first, last) = (200 + BESIDE + 3, ABOVE, 160 - BELOW - 1);
    assert_eq!(at(&picture, x, first), scale.color(0.2 + near));
    assert_eq!(at(&picture, x, last), scale.color(0.2 + far));
    assert_eq!([at(&picture, x, first), at(&picture, x, last)], [VIRIDIS[8], VIRIDIS[0]]);
    assert_eq!([at(&picture, x, first - 1), at(&picture, x, last + 1)], [PAPER; 2]);
    // The picture has the colours of the bar: its middle column is on the plane.
    assert_eq!(at(&picture, 0, 5), VIRIDIS[8]);
    assert!(at(&picture, 100, 5).iter().zip(VIRIDIS[4]).all(|(a, b)| a.abs_diff(b) <= 1));
    // Ticks stand at both ends.
    let tick = 200 + BESIDE + BAR + 2;
    assert_eq!([at(&picture, tick, first), at(&picture, tick, last)], [INK; 2]);
}

#[test]
fn a_range_that_is_configured_is_that_of_the_bar_and_what_lies_beyond_has_its_ends() {
    let settings = Settings { plane_m: Some(0.2), range_m: Some([-300e-6, 450e-6]) };
    let (picture, scale) = drawn(&[0.1, 0.1997, 0.2, 0.3], 4, settings);
    assert_eq!(scale.range_m, [-300e-6, 450e-6]);
    assert_eq!(
        [at(&picture, 0, 0), at(&picture, 1, 0), at(&picture, 3, 0)],
        [VIRIDIS[8], VIRIDIS[8], VIRIDIS[0]]
    );
    assert_eq!([figure(-300e-6 * 1e6), figure(450e-6 * 1e6), figure(-0.0)], ["-300", "450", "0"]);
}

#[test]
fn gaps_are_hatched_in_greys_that_no_depth_has_whatever_lies_beside_them() {
    let mut depths = vec![0.2f32; 40 * 40];
    for y in 10..30 {
        for x in 10..30 {
            depths[y * 40 + x] = [f32::NAN, 0.0, -1.0, f32::INFINITY][(x + y) % 4];
        }
    }
    let (picture, scale) = drawn(&depths, 40, Settings::default());
    for y in 0..40 {
        for x in 0..40 {
            let gap = (10..30).contains(&x) && (10..30).contains(&y);
            assert_eq!(GAP.contains(&at(&picture, x, y)), gap, "{x} {y}");
        }
    }
    assert!((scale.plane_m - 0.2).abs() < 1e-8, "the median: {scale:?}");
    assert!(GAP.iter().all(|gap| (0..=1000).all(|n| viridis(f64::from(n) / 1000.0) != *gap)));
}

#[test]
fn images_without_any_depth_and_of_one_depth_are_pictures_too() {
    let (picture, scale) = drawn(&[f32::NAN; 6], 3, Settings::default());
    assert!((0..3).all(|x| GAP.contains(&at(&picture, x, 0))));
    assert!(scale.range_m[1] > scale.range_m[0]);
    let (picture, scale) = drawn(&[0.25; 6], 3, Settings::default());
    assert_eq!((at(&picture, 0, 0), scale.plane_m), (scale.color(0.25), 0.25));
}
