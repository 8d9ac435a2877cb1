//! Both methods on pairs made here, whose disparity is known; and with and without AVX2.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::disparity::SCALE;
use trocar_sdk::data::ImageHeader;

/// A rectified pair with texture, whose true disparity at a pixel of the left image is `truth`, px.
struct Scene {
    width: usize,
    height: usize,
    left: Vec<u8>,
    right: Vec<u8>,
    truth: Vec<f64>,
}

impl Scene {
    /// The right image is drawn; the left one looks up where its light comes from. `truth(x, y)` must not let
    /// the left image fold over itself.
    fn of(width: usize, height: usize, seed: u64, truth: impl Fn(f64, f64) -> f64) -> Scene {
        let mut rng = fastrand::Rng::with_seed(seed);
        // Two sizes of detail, so that windows of any size see some.
        let fine: Vec<f64> = std::iter::repeat_with(|| rng.f64()).take(width * height).collect();
        let (cw, ch) = (width / 6 + 2, height / 6 + 2);
        let coarse: Vec<f64> = std::iter::repeat_with(|| rng.f64()).take(cw * ch).collect();
        let sample = |grid: &[f64], w: usize, h: usize, x: f64, y: f64| {
            let (x, y) = (x.clamp(0.0, (w - 2) as f64), y.clamp(0.0, (h - 2) as f64));
            let (c, r) = (x as usize, y as usize);
            let (fx, fy) = (x - c as f64, y - r as f64);
            let at = |c: usize, r: usize| grid[r * w + c];
            (at(c, r) * (1.0 - fx) + at(c + 1, r) * fx) * (1.0 - fy)
                + (at(c, r + 1) * (1.0 - fx) + at(c + 1, r + 1) * fx) * fy
        };
        let light = |x: f64, y: f64| {
            let grey =
                0.5 * sample(&fine, width, height, x, y) + 0.5 * sample(&coarse, cw, ch, x / 6.0, y / 6.0);
            (20.0 + 215.0 * grey) as u8
        };
        let mut scene = Scene { width, height, left: Vec::new(), right: Vec::new(), truth: Vec::new() };
        for y in 0..height {
            for x in 0..width {
                let (fx, fy) = (x as f64, y as f64);
                let disparity = truth(fx, fy);
                scene.truth.push(disparity);
                scene.left.push(light(fx - disparity, fy));
                scene.right.push(light(fx, fy));
            }
        }
        scene
    }

    fn header(&self, format: PixelFormat) -> ImageHeader {
        let (width, height) = (self.width as u32, self.height as u32);
        ImageHeader {
            width,
            height,
            stride: width * format.bytes_per_pixel() as u32,
            format,
            ..Default::default()
        }
    }

    fn matched(&self, mut matcher: Matcher) -> Vec<i16> {
        let header = self.header(PixelFormat::GRAY8);
        let mut map = vec![0; self.width * self.height];
        assert!(matcher.run(
            &header.image(&self.left).unwrap(),
            &header.image(&self.right).unwrap(),
            &mut map
        ));
        map
    }

    /// Judges the pixels at least `rim` from every side and with a true partner in the right image: share
    /// known,
    /// share of those wrong by more than 1 px, mean absolute error of the others in px.
    fn judge(&self, map: &[i16], rim: usize) -> (f64, f64, f64) {
        let (mut asked, mut known, mut wrong, mut error) = (0, 0, 0, 0.0);
        for y in rim..self.height - rim {
            for x in rim..self.width - rim {
                let n = y * self.width + x;
                if self.truth[n] + rim as f64 > x as f64 {
                    continue;
                }
                asked += 1;
                if map[n] < 0 {
                    continue;
                }
                known += 1;
                let off = (f64::from(map[n]) / f64::from(SCALE) - self.truth[n]).abs();
                if off > 1.0 {
                    wrong += 1;
                } else {
                    error += off;
                }
            }
        }
        let (asked, known, wrong) = (f64::from(asked), f64::from(known), f64::from(wrong));
        (known / asked, wrong / known, error / (known - wrong))
    }
}

fn settings(method: Method) -> Settings {
    Settings { method, n_disp: 64, block: 9, ..Settings::default() }
}

#[test]
fn a_slanted_surface_is_found_to_a_fraction_of_a_pixel_by_both_methods() {
    let scene = Scene::of(240, 120, 3, |x, y| 10.0 + 0.05 * x + 0.04 * y);
    for method in [Method::Bm, Method::Sgm] {
        let map = scene.matched(Matcher::new(240, 120, settings(method)).unwrap());
        let (known, wrong, error_px) = scene.judge(&map, 8);
        assert!(known > 0.95 && wrong < 0.01 && error_px < 0.15, "{method:?}: {known} {wrong} {error_px}");
    }
}

#[test]
fn a_step_in_depth_stays_a_step() {
    // Further away on the right: what is hidden is beside the step, in the left image.
    let scene = Scene::of(240, 120, 4, |x, _| if x < 130.0 { 30.0 } else { 12.0 });
    for method in [Method::Bm, Method::Sgm] {
        let map = scene.matched(Matcher::new(240, 120, settings(method)).unwrap());
        let (known, wrong, error_px) = scene.judge(&map, 8);
        assert!(known > 0.85 && wrong < 0.04 && error_px < 0.15, "{method:?}: {known} {wrong} {error_px}");
    }
}

#[test]
fn a_whole_shift_is_found_everywhere() {
    let scene = Scene::of(160, 60, 5, |_, _| 17.0);
    for method in [Method::Bm, Method::Sgm] {
        let map = scene.matched(Matcher::new(160, 60, settings(method)).unwrap());
        let (_, wrong, error_px) = scene.judge(&map, 8);
        assert!(wrong == 0.0 && error_px < 0.12, "{method:?}: {wrong} {error_px}");
    }
}

#[test]
fn colour_and_rows_with_gaps_give_the_map_of_grey_ones() {
    let scene = Scene::of(100, 40, 6, |_, _| 9.0);
    let grey = scene.matched(Matcher::new(100, 40, settings(Method::Bm)).unwrap());
    let stride = 311;
    let colour = |image: &[u8]| -> Vec<u8> {
        let row = |row: &[u8]| {
            let mut bytes: Vec<u8> = row.iter().flat_map(|&p| [p; 3]).collect();
            bytes.resize(stride, 99);
            bytes
        };
        image.chunks(100).flat_map(row).collect()
    };
    let (left, right) = (colour(&scene.left), colour(&scene.right));
    let header = ImageHeader { stride: stride as u32, ..scene.header(PixelFormat::RGB8) };
    let mut map = vec![0; 4000];
    let mut matcher = Matcher::new(100, 40, settings(Method::Bm)).unwrap();
    assert!(matcher.run(&header.image(&left).unwrap(), &header.image(&right).unwrap(), &mut map));
    assert_eq!(map, grey);
}

#[test]
fn a_flat_image_has_no_disparity_where_texture_is_asked_for() {
    let flat = Scene { width: 80, height: 40, left: vec![90; 3200], right: vec![90; 3200], truth: vec![] };
    let map = flat.matched(Matcher::new(80, 40, settings(Method::Bm)).unwrap());
    assert!(map.iter().all(|&d| d < 0));
    let map = flat.matched(Matcher::new(80, 40, settings(Method::Sgm)).unwrap());
    // A pixel that can have one disparity only has nothing to choose from.
    assert!(map.chunks(80).all(|row| row[2..].iter().all(|&d| d < 0)), "no disparity is better than another");
}

#[test]
fn noise_with_and_without_wide_instructions_gives_the_same_bytes() {
    let mut rng = fastrand::Rng::with_seed(8);
    for round in 0..24 {
        let (width, height) = (rng.usize(31..150), rng.usize(31..60));
        let method = if round % 2 == 0 { Method::Bm } else { Method::Sgm };
        let p1 = rng.u8(1..=103);
        let settings = Settings {
            method,
            n_disp: 32 * rng.usize(1..=8),
            block: 2 * rng.usize(2..=15) + 1,
            p1,
            p2: rng.u8(p1..=103),
            uniqueness: rng.u8(0..=50),
            texture: rng.u16(0..2000),
            consistency: rng.i16(-1..4),
            dark: 0,
        };
        let pixels = width * height;
        // Extremes come often: that is where sums are largest.
        let mut image = |contrast: bool| -> Vec<u8> {
            let level = |rng: &mut fastrand::Rng| if contrast { 255 * rng.u8(0..2) } else { rng.u8(..) };
            std::iter::repeat_with(|| level(&mut rng)).take(pixels).collect()
        };
        let scene =
            Scene { width, height, left: image(round % 3 == 0), right: image(round % 3 == 0), truth: vec![] };
        let wide = scene.matched(Matcher::new(width, height, settings).unwrap());
        let plain = scene.matched(Matcher::portable(width, height, settings).unwrap());
        assert_eq!(wide, plain, "{width}×{height} {settings:?}");
        // A pair with an answer, where all of the way through the matchers counts.
        let scene = Scene::of(width, height, round, |x, y| 3.0 + 0.1 * x + 0.02 * y);
        let wide = scene.matched(Matcher::new(width, height, settings).unwrap());
        let plain = scene.matched(Matcher::portable(width, height, settings).unwrap());
        assert_eq!(wide, plain, "{width}×{height} {settings:?}");
    }
}

#[test]
fn a_matcher_used_again_remembers_nothing() {
    let (one, other) = (Scene::of(90, 40, 1, |_, _| 5.0), Scene::of(90, 40, 2, |_, _| 20.0));
    for method in [Method::Bm, Method::Sgm] {
        let mut matcher = Matcher::new(90, 40, settings(method)).unwrap();
        let header = one.header(PixelFormat::GRAY8);
        let mut maps = [vec![0; 3600], vec![0; 3600], vec![0; 3600]];
        for (scene, map) in [&one, &other, &one].into_iter().zip(&mut maps) {
            let [l, r] = [&scene.left, &scene.right].map(|bytes| header.image(bytes).unwrap());
            assert!(matcher.run(&l, &r, map));
        }
        assert_eq!(maps[0], maps[2], "{method:?}");
        assert_ne!(maps[0], maps[1]);
    }
}

#[test]
fn settings_outside_of_their_limits_are_refused_with_what_to_take() {
    let refused = |settings: Settings| Matcher::new(100, 100, settings).map(|_| ()).unwrap_err().to_string();
    let good = Settings::default();
    assert_eq!(
        refused(Settings { n_disp: 80, ..good }),
        "n_disp: 80 is not a multiple of 32 from 32 to 256 px: take 96"
    );
    assert_eq!(refused(Settings { block: 8, ..good }), "block: 8 px is not an odd number from 5 to 31");
    assert!(refused(Settings { block: 33, ..good }).starts_with("block: 33"));
    assert!(refused(Settings { p1: 50, p2: 40, ..good }).contains("1 ≤ p1 ≤ p2 ≤ 103"));
    assert!(refused(Settings { p2: 104, ..good }).starts_with("p1: 8 and p2: 104"));
    assert!(refused(Settings { uniqueness: 51, ..good }).starts_with("uniqueness: 51 %"));
    let small = Matcher::new(10, 100, good).map(|_| ()).unwrap_err().to_string();
    assert_eq!(small, "images of 10 × 100 px: a side must have 15 (the block) to 16384 px");
}

#[test]
fn images_of_another_size_or_format_are_not_matched() {
    let scene = Scene::of(64, 40, 1, |_, _| 4.0);
    let mut matcher = Matcher::new(64, 40, settings(Method::Bm)).unwrap();
    let mut map = vec![7; 64 * 40];
    let good = scene.header(PixelFormat::GRAY8);
    let small = ImageHeader { height: 39, ..good };
    let right = good.image(&scene.right).unwrap();
    assert!(!matcher.run(&small.image(&scene.left).unwrap(), &right, &mut map));
    let bayer = ImageHeader { format: PixelFormat::BAYER_RG8, ..good };
    assert!(!matcher.run(&bayer.image(&scene.left).unwrap(), &right, &mut map));
    assert!(!matcher.run(&good.image(&scene.left).unwrap(), &right, &mut map[1..]));
    assert!(map.iter().all(|&d| d == 7));
}
