//! Tests of what is drawn, where, and that nothing is drawn outside.

use super::*;
use crate::view::Shape;

const WHITE: Color = [255; 4];

fn drawn(width: usize, height: usize, draw: impl Fn(&mut ViewMut<'_>)) -> Vec<u8> {
    let shape = Shape { width, height, format: Format::Gray8 };
    let mut bytes = vec![0; width * height];
    draw(&mut ViewMut::packed(shape, &mut bytes).expect("fits"));
    bytes
}

#[test]
fn letters_have_ink_where_they_are_and_differ() {
    let of = |letters: &str| drawn(40, 32, |image| text(image, (2, 3), 24, WHITE, letters));
    let (a, b) = (of("A"), of("B"));
    assert!(a.iter().any(|&p| p > 200) && a != b);
    assert_eq!(of("語"), of("?"), "letters that are not there are asked for");
    assert_eq!(of(""), [0; 40 * 32]);
    // Above, left of and below the letter there is nothing.
    assert!(a.chunks(40).take(3).flatten().all(|&p| p == 0));
    assert!(a.chunks(40).all(|row| row[..2].iter().all(|&p| p == 0)));
    assert!(a.chunks(40).skip(27).flatten().all(|&p| p == 0));
}

#[test]
fn larger_letters_are_larger_and_text_goes_to_the_right() {
    let ink = |size, letters: &str| {
        drawn(200, 40, |image| text(image, (0, 0), size, WHITE, letters))
            .iter()
            .map(|&p| u32::from(p))
            .sum::<u32>()
    };
    assert!(ink(32, "H") > ink(24, "H") && ink(24, "H") > ink(16, "H"));
    assert_eq!(ink(16, "HH"), 2 * ink(16, "H"));
}

#[test]
fn a_line_is_as_wide_as_it_is_said_to_be() {
    for (from, to) in [((5.0, 10.0), (35.0, 10.0)), ((20.0, 2.0), (20.0, 18.0)), ((4.0, 3.0), (30.0, 17.0))] {
        for width in [1.0, 3.0] {
            let image = drawn(40, 20, |image| line(image, from, to, width, WHITE));
            let ink = image.iter().map(|&p| f64::from(p) / 255.0).sum::<f64>();
            let length = f64::hypot(to.0 - from.0, to.1 - from.1);
            // Round ends add a circle.
            let expected = length * width + std::f64::consts::PI * width * width / 4.0;
            assert!(
                (ink - expected).abs() < 0.06 * expected + 0.5,
                "{from:?} {to:?} {width}: {ink} for {expected}"
            );
        }
    }
    let dot = drawn(9, 9, |image| line(image, (4.0, 4.0), (4.0, 4.0), 1.0, WHITE));
    assert_eq!(dot.iter().filter(|&&p| p > 0).count(), 1);
    assert_eq!(dot[40], 255);
}

#[test]
fn colour_and_opacity_mix_with_what_is_below() {
    let shape = Shape { width: 1, height: 1, format: Format::Rgb8 };
    let mut pixel = [100, 100, 100];
    line(
        &mut ViewMut::packed(shape, &mut pixel).expect("fits"),
        (0.0, 0.0),
        (0.0, 0.0),
        1.0,
        [200, 0, 100, 128],
    );
    assert_eq!(pixel, [150, 50, 100]);
    let one = Picture { width: 1, height: 1, rgba: vec![255, 0, 0, 255] };
    picture(&mut ViewMut::packed(shape, &mut pixel).expect("fits"), (0, 0), 255, &one);
    assert_eq!(pixel, [255, 0, 0]);
    picture(&mut ViewMut::packed(shape, &mut pixel).expect("fits"), (0, 0), 0, &one);
    assert_eq!(pixel, [255, 0, 0]);
    assert_eq!((mix(7, 200, 0), mix(7, 200, 255)), (7, 200));
}

#[test]
fn items_beyond_every_side_and_at_any_distance_are_cut_without_a_panic() {
    let dots = Picture { width: 3, height: 2, rgba: vec![255; 24] };
    let far = [i64::from(i32::MIN), -40, -1, 0, 7, 8, 50, i64::from(i32::MAX)];
    for x in far {
        for y in far {
            drawn(8, 6, |image| {
                text(image, (x, y), 16, WHITE, "Wide text that leaves the image");
                picture(image, (x, y), 200, &dots);
                line(image, (x as f64, y as f64), (y as f64, x as f64), 5.0, WHITE);
                line(image, (x as f64, y as f64), (3.0, 3.0), 64.0, WHITE);
            });
        }
    }
    let corner = drawn(8, 6, |image| picture(image, (-2, -1), 255, &dots));
    assert_eq!(corner.iter().filter(|&&p| p == 255).count(), 1);
}
