//! Tests of the picture: curves where their points are, axes, letters, a legend.

use super::*;

fn chart(curves: Vec<Curve>) -> Chart {
    let (y_min, y_max) = (None, None);
    Chart {
        title: "error".into(),
        y_label: "error / um".into(),
        width: 640,
        height: 400,
        y_min,
        y_max,
        curves,
    }
}

fn curve(f: impl Fn(f64) -> f64) -> Curve {
    let points = (0..=200).map(|n| f64::from(n) * 0.05).map(|t| (t, f(t))).collect();
    Curve { label: "a curve".into(), points }
}

fn pixel(picture: &Picture, x: u32, y: u32) -> [u8; 3] {
    let at = 3 * (y * picture.width + x) as usize;
    [picture.rgb[at], picture.rgb[at + 1], picture.rgb[at + 2]]
}

/// Rows of the coloured pixels in a column: axes and letters have none.
fn rows(picture: &Picture, x: u32) -> Vec<u32> {
    let colored = |[r, g, b]: [u8; 3]| r.abs_diff(g) > 30 || g.abs_diff(b) > 30;
    (0..picture.height).filter(|y| colored(pixel(picture, x, *y))).collect()
}

#[test]
fn a_rising_curve_rises_and_a_falling_one_falls() {
    let heights = |curve| {
        let picture = draw(&chart(vec![curve])).unwrap();
        [150, 300].map(|x| rows(&picture, x).first().copied().unwrap_or(0))
    };
    let [up, down] = [heights(curve(|t| t)), heights(curve(|t| 10.0 - t))];
    assert!(up[0] > up[1] + 50 && up[1] > 0, "{up:?}");
    assert!(down[0] + 50 < down[1] && down[0] > 0, "{down:?}");
}

#[test]
fn curves_differ_in_colour() {
    let picture = draw(&chart(vec![curve(|_| 1.0), curve(|_| 2.0)])).unwrap();
    let colors: Vec<[u8; 3]> = rows(&picture, 200).into_iter().map(|y| pixel(&picture, 200, y)).collect();
    assert!(colors.len() == 2 && colors[0][0] > colors[0][2] && colors[1][2] > colors[1][0], "{colors:?}");
}

#[test]
fn there_are_letters_beside_both_axes_a_title_and_a_legend() {
    let full = draw(&chart(vec![curve(|t| t)])).unwrap();
    let bare =
        draw(&Chart { title: String::new(), y_label: String::new(), ..chart(vec![curve(|t| t)]) }).unwrap();
    let ink = |picture: &Picture, xs: Range<u32>, ys: Range<u32>| {
        xs.flat_map(|x| ys.clone().map(move |y| (x, y)))
            .filter(|(x, y)| pixel(picture, *x, *y)[0] < 100)
            .count()
    };
    // Left of the numbers of the vertical axis stands its label, below the horizontal one are numbers and
    // theirs.
    assert!(ink(&full, 0..32, 0..400) > 100 && ink(&bare, 0..32, 0..400) == 0);
    assert!(ink(&full, 100..640, 0..36) > 100);
    assert!(ink(&full, 100..640, 345..370) > 100 && ink(&full, 300..450, 370..400) > 30);
    assert!(ink(&full, 500..620, 40..100) > 50, "the legend stands in the upper right");
}

#[test]
fn gaps_are_left_open() {
    let holed = curve(|t| if (4.0..6.0).contains(&t) { f64::NAN } else { 5.0 });
    let picture = draw(&Chart { y_min: Some(0.0), y_max: Some(10.0), ..chart(vec![holed]) }).unwrap();
    // The plotting area goes from 100 to 615 px.
    assert!(!rows(&picture, 150).is_empty());
    assert_eq!(rows(&picture, 357), [0; 0]);
}

#[test]
fn any_numbers_give_a_picture() {
    let one = |points: Vec<(f64, f64)>| Curve { label: "x".into(), points };
    for curves in [
        vec![],
        vec![one(vec![])],
        vec![one(vec![(1.0, 3.0)])],
        vec![one(vec![(0.0, 3.0), (1.0, 3.0)])],
        vec![one(vec![(0.0, f64::NAN), (1.0, f64::INFINITY)])],
        vec![one(vec![(0.0, -f64::MAX), (1.0, f64::MAX)])],
        vec![one(vec![(0.0, 1e-300), (1.0, 2e-300)])],
        vec![one(vec![(0.0, 1e15), (1.0, 1e15 + 0.25)])],
        (0..4).map(|n| one(vec![(0.0, n as f64), (1.0, 0.0)])).collect(),
    ] {
        for (y_min, y_max) in [
            (None, None),
            (Some(1e6), None),
            (None, Some(-1e6)),
            (Some(-1.0), Some(1.0)),
            (Some(-1e300), Some(1e300)),
        ] {
            let chart = Chart { y_min, y_max, title: "µ é \u{1F600}".into(), ..chart(Vec::new()) };
            let picture =
                draw(&Chart { curves: curves.iter().map(|c| one(c.points.clone())).collect(), ..chart });
            assert_eq!(picture.unwrap().rgb.len(), 3 * 640 * 400);
        }
    }
}
