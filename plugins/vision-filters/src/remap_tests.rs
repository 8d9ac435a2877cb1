//! Remapping by shifts whose result is known, at rims, and with and without AVX2.

use super::*;

fn shape(width: usize, height: usize, format: Format) -> Shape {
    Shape { width, height, format }
}

fn remapped(map: &Remap, shape: Shape, src: &[u8]) -> Vec<u8> {
    let mut out = vec![7; shape.packed_bytes()];
    let done = map.run(
        &View::packed(shape, src).expect("test image fits"),
        &mut ViewMut::packed(shape, &mut out).expect("made to fit"),
    );
    assert!(done);
    out
}

#[test]
fn a_whole_shift_moves_pixels_and_leaves_black_behind() {
    let map = Remap::new(3, 2, |x, y| (x + 1.0, y));
    assert_eq!(remapped(&map, shape(3, 2, Format::Gray8), &[1, 2, 3, 4, 5, 6]), [2, 3, 0, 5, 6, 0]);
    let map = Remap::new(3, 2, |x, y| (x, y - 1.0));
    assert_eq!(remapped(&map, shape(3, 2, Format::Gray8), &[1, 2, 3, 4, 5, 6]), [0, 0, 0, 1, 2, 3]);
}

#[test]
fn a_part_of_a_pixel_is_between_its_neighbours_and_fades_to_black_at_the_rim() {
    let map = Remap::new(2, 2, |x, y| (x + 0.5, y));
    assert_eq!(remapped(&map, shape(2, 2, Format::Gray8), &[10, 20, 30, 51]), [15, 10, 41, 26]);
    let map = Remap::new(2, 2, |x, y| (x, y + 0.25));
    assert_eq!(remapped(&map, shape(2, 2, Format::Gray8), &[40, 0, 80, 255]), [50, 64, 60, 191]);
}

#[test]
fn what_comes_from_nowhere_is_black() {
    for nowhere in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e9, 2.0, -1.0] {
        let map = Remap::new(2, 2, |_, y| (nowhere, y));
        assert_eq!(remapped(&map, shape(2, 2, Format::Gray8), &[9; 4]), [0; 4], "{nowhere}");
        let map = Remap::new(2, 2, |x, _| (x, nowhere));
        assert_eq!(remapped(&map, shape(2, 2, Format::Gray8), &[9; 4]), [0; 4], "{nowhere}");
    }
}

#[test]
fn any_map_is_within_a_level_of_the_formula_and_the_same_with_and_without_wide_instructions() {
    let mut rng = fastrand::Rng::with_seed(5);
    for _ in 0..200 {
        let (w, h) = (rng.usize(1..40), rng.usize(1..12));
        let format = if rng.bool() { Format::Rgb8 } else { Format::Gray8 };
        let shape = shape(w, h, format);
        let (n, stride) = (format.bytes(), shape.row_bytes() + rng.usize(0..5));
        let level = |rng: &mut fastrand::Rng| if rng.bool() { 255 * rng.u8(0..2) } else { rng.u8(..) };
        // As short as it may be: the last row ends where the bytes end.
        let bytes: Vec<u8> =
            std::iter::repeat_with(|| level(&mut rng)).take(stride * (h - 1) + shape.row_bytes()).collect();
        let (a, b, c) = (rng.f64() * 0.4 + 0.8, rng.f64() * 6.0 - 3.0, rng.f64() * 0.4 - 0.2);
        let source = |x: f64, y: f64| (a * x + b + c * y, y * a + c * x + b / 2.0);
        let src = View::new(shape, stride, &bytes).expect("fits");
        let map = Remap::new(w, h, source);
        let mut outs = [vec![1; shape.packed_bytes()], vec![2; shape.packed_bytes()]];
        for (map, out) in [&map, &map.clone().portable()].into_iter().zip(&mut outs) {
            assert!(map.run(&src, &mut ViewMut::packed(shape, out).expect("fits")));
        }
        assert_eq!(outs[0], outs[1], "{w}×{h} {format:?}");
        for y in 0..h {
            for x in 0..w {
                let (u, v) = source(x as f64, y as f64);
                for channel in 0..n {
                    let exact = plainly(&src, (u, v), n, channel);
                    let got = f64::from(outs[0][(y * w + x) * n + channel]);
                    // Half a step of 1/32 px to both sides, 255 levels per pixel; and half a level.
                    assert!(
                        (got - exact).abs() <= 255.0 / 32.0 + 0.5,
                        "({x}, {y}) from ({u}, {v}): {got}, {exact}"
                    );
                }
            }
        }
    }
}

/// Bilinear interpolation in floating point, black outside.
fn plainly(src: &View<'_>, (u, v): (f64, f64), n: usize, channel: usize) -> f64 {
    let Shape { width, height, .. } = src.shape();
    let mut sum = 0.0;
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (x, y) = (u.floor() + dx, v.floor() + dy);
        if x < 0.0 || y < 0.0 || x >= width as f64 || y >= height as f64 {
            continue;
        }
        let weight = (1.0 - (u - x).abs()) * (1.0 - (v - y).abs());
        sum += weight * f64::from(src.row(y as usize)[x as usize * n + channel]);
    }
    sum
}

#[test]
fn another_size_is_not_remapped() {
    let map = Remap::new(2, 2, |x, y| (x, y));
    let other = shape(3, 2, Format::Gray8);
    let mut out = [7; 6];
    assert!(!map.run(
        &View::packed(other, &[0; 6]).expect("fits"),
        &mut ViewMut::packed(other, &mut out).expect("fits")
    ));
    let (grey, colour) = (shape(2, 2, Format::Gray8), shape(2, 2, Format::Rgb8));
    let mut big = [7; 12];
    assert!(!map.run(
        &View::packed(grey, &[0; 4]).expect("fits"),
        &mut ViewMut::packed(colour, &mut big).expect("fits")
    ));
    assert!(out.iter().chain(&big).all(|&b| b == 7));
}
