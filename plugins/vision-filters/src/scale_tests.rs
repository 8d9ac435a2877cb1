//! Axes and bars against their labels.

use super::*;
use crate::view::{Format, Shape};

/// Pixels of a black image that has a scale.
fn drawn((width, height): (usize, usize), rect: Rect, size: PixelSize) -> Vec<u8> {
    let shape = Shape { width, height, format: Format::Gray8 };
    let mut pixels = vec![0; width * height];
    draw(&mut ViewMut::packed(shape, &mut pixels).expect("fits"), rect, size);
    pixels
}

#[test]
fn a_bar_is_as_long_as_its_label_says_and_as_long_as_there_is_room() {
    for pixel_m in [0.3e-6, 2.6e-6, 6e-6, 9.375e-6, 41e-6, 1e-3] {
        let Bar { length_m, px } = bar(pixel_m, 96.0).expect("a bar");
        assert!((px * pixel_m / length_m - 1.0).abs() < 1e-12);
        assert!((96.0 / 2.5 - 1e-9..=96.0).contains(&px), "{px} px of {pixel_m} m");
        let label = Label::of(length_m);
        let (number, unit) = label.as_str().split_once(' ').expect("number and unit");
        let unit_m = if unit == "mm" { 1e-3 } else { 1e-6 };
        let said_m = number.parse::<f64>().expect("a number") * unit_m;
        assert!((said_m / length_m - 1.0).abs() < 1e-9, "{} is {length_m} m", label.as_str());
    }
    for none in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!((bar(none, 96.0), step(none, 48.0)), (None, None));
    }
}

#[test]
fn the_drawn_bar_has_the_pixels_of_its_label() {
    // 500 µm at 6.25 µm are 80 of the 96 px that a bar may have.
    let rect = Rect { x: 0, y: 0, width: 320, height: 240 };
    let pixels = drawn((320, 240), rect, PixelSize { column_m: 6.25e-6, row_m: 0.0 });
    assert_eq!(bar(6.25e-6, 96.0).map(|bar| bar.length_m), Some(500e-6));
    // Above the axis, its letters and the margin.
    let row = 240 - 2 - 5 - 16 - 10 - 2;
    let inked: Vec<usize> = (0..320).filter(|x| pixels[row * 320 + x] == 235).collect();
    assert_eq!((inked.len(), inked.first(), inked.last()), (80, Some(&230), Some(&309)));
}

#[test]
fn ticks_stand_where_their_labels_say() {
    let rect = Rect { x: 10, y: 20, width: 300, height: 200 };
    let pixels = drawn((320, 240), rect, PixelSize { column_m: 10e-6, row_m: 5e-6 });
    // 500 µm are 100 rows, 1 mm is 100 columns; the axis across has the last two lines.
    let inked = |x: usize, y: usize| pixels[y * 320 + x] > 200;
    let down: Vec<usize> = (22..200).filter(|y| inked(14, *y)).collect();
    assert_eq!(down, [120], "one tick of 500 µm");
    let across: Vec<usize> = (12..300).filter(|x| inked(*x, 215)).collect();
    assert_eq!(across, [110, 210], "1 mm and 2 mm");
}

#[test]
fn nothing_is_written_outside_of_the_picture_or_into_one_without_a_scale() {
    let mut rng = fastrand::Rng::with_seed(3);
    for _ in 0..300 {
        let (x, y) = (rng.usize(0..60), rng.usize(0..60));
        let rect = Rect { x, y, width: rng.usize(1..340), height: rng.usize(1..260) };
        let scale = |rng: &mut fastrand::Rng| 10f64.powf(-8.0 + 6.0 * rng.f64());
        let size = PixelSize { column_m: scale(&mut rng), row_m: scale(&mut rng) };
        let pixels = drawn((400, 320), rect, size);
        let outside = pixels.iter().enumerate().filter(|(_, pixel)| **pixel > 0).find(|(n, _)| {
            let (column, row) = (n % 400, n / 400);
            !(x..x + rect.width).contains(&column) || !(y..y + rect.height).contains(&row)
        });
        assert_eq!(outside, None, "{rect:?} {size:?}");
        assert!(drawn((400, 320), rect, PixelSize::default()).iter().all(|pixel| *pixel == 0));
    }
}
