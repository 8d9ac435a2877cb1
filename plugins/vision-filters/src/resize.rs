//! Resizing: bilinear between pixels, or the mean of the covered area.
//!
//! Invariant: the weights of one output pixel add to exactly 2²³ (2¹² down the columns, 2¹¹ along the rows),
//! so a flat image stays flat and 32 bits never overflow. A [`Resizer`] allocates when it is made, never when
//! it is prepared or runs.

use crate::view::{Format, Shape, View, ViewMut};

const COLUMN_BITS: u32 = 12;
const ROW_BITS: u32 = 11;
const SHIFT: u32 = COLUMN_BITS + ROW_BITS;

/// Method by which output pixels are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Between the four nearest pixels. Smooth when enlarging; aliases when shrinking below one half.
    Bilinear,
    /// Mean over the area an output pixel covers. For shrinking.
    Area,
}

/// Resizes images of one shape to another size.
#[derive(Clone, Debug)]
pub struct Resizer {
    from: Shape,
    to: Shape,
    columns: Taps,
    rows: Taps,
    sums: Vec<u32>,
    /// Longest sides of images and of results, px.
    room: (usize, usize),
}

impl Resizer {
    /// Prepares for `width` × `height` pixels out of images of shape `from`, in the same format. A size of 0
    /// is taken as 1.
    pub fn new(from: Shape, width: usize, height: usize, method: Method) -> Self {
        let side = |a: usize, b: usize| a.max(b).max(1);
        let mut resizer = Resizer::with_room(side(from.width, from.height), side(width, height));
        resizer.fill(from, width, height, method);
        resizer
    }

    /// One that can be [prepared](Self::prepare) without allocating: for images whose sides are up to
    /// `from_side` px, and results whose sides are up to `to_side` px.
    pub fn with_room(from_side: usize, to_side: usize) -> Self {
        let nothing = Shape { width: 1, height: 1, format: Format::Gray8 };
        Resizer {
            from: nothing,
            to: nothing,
            columns: Taps::with_room(from_side, to_side),
            rows: Taps::with_room(from_side, to_side),
            sums: Vec::with_capacity(from_side * Format::Rgb8.bytes()),
            room: (from_side, to_side),
        }
    }

    /// Longest sides of images and of results it has room for, px.
    pub fn room(&self) -> (usize, usize) {
        self.room
    }

    /// Prepares anew, as [`new`](Self::new), within the room there is; allocates nothing. False, with nothing
    /// changed, when a side is longer.
    #[must_use]
    pub fn prepare(&mut self, from: Shape, width: usize, height: usize, method: Method) -> bool {
        let fits = from.width.max(from.height) <= self.room.0 && width.max(height) <= self.room.1;
        if fits {
            self.fill(from, width, height, method);
        }
        fits
    }

    fn fill(&mut self, from: Shape, width: usize, height: usize, method: Method) {
        self.from = from;
        self.to = Shape { width: width.max(1), height: height.max(1), format: from.format };
        self.columns.fill(from.height, self.to.height, method, COLUMN_BITS);
        self.rows.fill(from.width, self.to.width, method, ROW_BITS);
        self.sums.clear();
        self.sums.resize(from.row_bytes(), 0);
    }

    /// Shape this takes.
    pub fn from(&self) -> Shape {
        self.from
    }

    /// Shape this makes.
    pub fn to(&self) -> Shape {
        self.to
    }

    /// Resizes `src` into `dst`. False, with `dst` untouched, when their shapes are not [`from`](Self::from)
    /// and [`to`](Self::to).
    #[must_use]
    pub fn run(&mut self, src: &View<'_>, dst: &mut ViewMut<'_>) -> bool {
        if src.shape() != self.from || dst.shape() != self.to {
            return false;
        }
        for y in 0..self.to.height {
            let (first, weights) = self.columns.of(y);
            self.sums.fill(0);
            for (k, &weight) in weights.iter().enumerate() {
                for (sum, &byte) in self.sums.iter_mut().zip(src.row(first + k)) {
                    *sum += u32::from(weight) * u32::from(byte);
                }
            }
            match self.from.format {
                Format::Gray8 => across::<1>(&self.rows, &self.sums, dst.row_mut(y)),
                Format::Rgb8 => across::<3>(&self.rows, &self.sums, dst.row_mut(y)),
            }
        }
        true
    }
}

/// Weights the column sums of one row into output pixels of `N` bytes.
fn across<const N: usize>(taps: &Taps, sums: &[u32], dst: &mut [u8]) {
    let (pixels, _) = sums.as_chunks::<N>();
    for (x, out) in dst.as_chunks_mut::<N>().0.iter_mut().enumerate() {
        let (first, weights) = taps.of(x);
        let mut total = [1u32 << (SHIFT - 1); N];
        for (pixel, &weight) in pixels[first..].iter().zip(weights) {
            for c in 0..N {
                total[c] += u32::from(weight) * pixel[c];
            }
        }
        *out = total.map(|t| (t >> SHIFT) as u8);
    }
}

/// For each output position along one side: the first input position and the weights from there on.
#[derive(Clone, Debug)]
struct Taps {
    first: Vec<usize>,
    weights: Vec<u16>,
    per_output: usize,
}

impl Taps {
    fn with_room(from_side: usize, to_side: usize) -> Self {
        // An output pixel has at most from / to + 2 weights, or two.
        let weights = Vec::with_capacity(from_side + 2 * to_side);
        Taps { first: Vec::with_capacity(to_side), weights, per_output: 0 }
    }

    fn fill(&mut self, from: usize, to: usize, method: Method, bits: u32) {
        let scale = from as f64 / to as f64;
        let one = f64::from(1u32 << bits);
        let per_output = match method {
            Method::Bilinear => 2,
            Method::Area => scale.ceil() as usize + 1,
        }
        .min(from);
        self.first.clear();
        self.weights.clear();
        self.per_output = per_output;
        for n in 0..to {
            // Edges of this output pixel on the input's axis, pixel i covering i … i + 1.
            let (begin, end) = match method {
                Method::Area => (n as f64 * scale, (n + 1) as f64 * scale),
                Method::Bilinear => {
                    let centre = (n as f64 + 0.5) * scale;
                    (centre - 0.5, centre + 0.5)
                }
            };
            let first = (begin.max(0.0).floor() as usize).min(from - per_output);
            // A bilinear pixel at the rim takes the part outside from the rim's own pixel.
            let share = |i: usize| {
                let low = if i == 0 { begin } else { begin.max(i as f64) };
                let high = if i + 1 == from { end } else { end.min((i + 1) as f64) };
                (high - low).max(0.0) / (end - begin)
            };
            // Differences of the rounded running sum: rounding errors spread out and the total is exact.
            let (mut covered, mut given) = (0.0, 0);
            for i in first..first + per_output {
                covered += share(i);
                let upto = if i + 1 == first + per_output { one } else { (covered * one).round() } as u16;
                self.weights.push(upto - given);
                given = upto;
            }
            self.first.push(first);
        }
    }

    fn of(&self, n: usize) -> (usize, &[u16]) {
        (self.first[n], &self.weights[n * self.per_output..][..self.per_output])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resized(
        format: Format,
        from: (usize, usize),
        src: &[u8],
        to: (usize, usize),
        method: Method,
    ) -> Vec<u8> {
        let shape = Shape { width: from.0, height: from.1, format };
        let mut resizer = Resizer::new(shape, to.0, to.1, method);
        let mut out = vec![0; resizer.to().packed_bytes()];
        let done = resizer.run(
            &View::packed(shape, src).expect("test image fits"),
            &mut ViewMut::packed(resizer.to(), &mut out).expect("made to fit"),
        );
        assert!(done);
        out
    }

    #[test]
    fn halving_by_area_is_the_mean_of_four() {
        let src = [0, 4, 100, 200, 8, 12, 255, 255];
        assert_eq!(resized(Format::Gray8, (4, 2), &src, (2, 1), Method::Area), [6, 203]);
    }

    #[test]
    fn area_weights_pixels_that_are_covered_in_part() {
        // 3 → 2: each output covers one pixel and half of the middle one.
        assert_eq!(resized(Format::Gray8, (3, 1), &[0, 90, 240], (2, 1), Method::Area), [30, 190]);
    }

    #[test]
    fn doubling_bilinear_has_quarter_steps_and_keeps_the_rim() {
        assert_eq!(resized(Format::Gray8, (2, 1), &[0, 100], (4, 1), Method::Bilinear), [0, 25, 75, 100]);
        assert_eq!(resized(Format::Gray8, (1, 2), &[0, 100], (1, 4), Method::Bilinear), [0, 25, 75, 100]);
    }

    #[test]
    fn colours_do_not_mix() {
        let src = [255, 0, 10, 255, 0, 30];
        assert_eq!(resized(Format::Rgb8, (2, 1), &src, (1, 1), Method::Area), [255, 0, 20]);
        let out = resized(Format::Rgb8, (2, 1), &src, (4, 1), Method::Bilinear);
        assert_eq!(out, [255, 0, 10, 255, 0, 15, 255, 0, 25, 255, 0, 30]);
    }

    #[test]
    fn an_area_of_many_thousand_pixels_still_has_its_mean() {
        let src: Vec<u8> = (0..9_000).map(|n| if n < 4_500 { 0 } else { 200 }).collect();
        assert_eq!(resized(Format::Gray8, (9_000, 1), &src, (1, 1), Method::Area), [100]);
        assert_eq!(resized(Format::Gray8, (1, 9_000), &src, (1, 1), Method::Area), [100]);
    }

    #[test]
    fn the_same_size_gives_the_same_image() {
        let src: Vec<u8> = (0..35).map(|n| (n * 7) as u8).collect();
        for method in [Method::Area, Method::Bilinear] {
            assert_eq!(resized(Format::Gray8, (7, 5), &src, (7, 5), method), src, "{method:?}");
        }
    }

    #[test]
    fn a_flat_image_stays_flat_at_any_size() {
        let mut rng = fastrand::Rng::with_seed(4);
        for _ in 0..300 {
            let (from, to) = ((rng.usize(1..40), rng.usize(1..40)), (rng.usize(1..40), rng.usize(1..40)));
            let level = rng.u8(..);
            for method in [Method::Area, Method::Bilinear] {
                let out = resized(Format::Rgb8, from, &vec![level; from.0 * from.1 * 3], to, method);
                assert!(
                    out.iter().all(|&b| b == level),
                    "{from:?} → {to:?} {method:?}: {level} became {out:?}"
                );
            }
        }
    }

    #[test]
    fn both_methods_stay_within_a_level_of_the_formula_in_floating_point() {
        let mut rng = fastrand::Rng::with_seed(8);
        for _ in 0..100 {
            let (w, h) = (rng.usize(1..20), rng.usize(1..20));
            let (tw, th) = (rng.usize(1..20), rng.usize(1..20));
            let src: Vec<u8> = std::iter::repeat_with(|| rng.u8(..)).take(w * h).collect();
            for method in [Method::Area, Method::Bilinear] {
                let out = resized(Format::Gray8, (w, h), &src, (tw, th), method);
                for y in 0..th {
                    for x in 0..tw {
                        let exact = plainly(&src, (w, h), (tw, th), (x, y), method);
                        let got = f64::from(out[y * tw + x]);
                        assert!(
                            (got - exact).abs() <= 1.0,
                            "{w}×{h} → {tw}×{th} {method:?} ({x},{y}): {got} {exact}"
                        );
                    }
                }
            }
        }
    }

    /// The definition, sampled finely: mean of the (clamped) input over the output pixel's footprint.
    fn plainly(
        src: &[u8],
        (w, h): (usize, usize),
        (tw, th): (usize, usize),
        (x, y): (usize, usize),
        m: Method,
    ) -> f64 {
        let weights = |n: usize, from: usize, to: usize| -> Vec<f64> {
            let scale = from as f64 / to as f64;
            let (begin, width) = match m {
                Method::Area => (n as f64 * scale, scale),
                Method::Bilinear => ((n as f64 + 0.5) * scale - 0.5, 1.0),
            };
            let mut shares = vec![0.0; from];
            for k in 0..4000 {
                let at = (begin + (f64::from(k) + 0.5) / 4000.0 * width).clamp(0.0, from as f64 - 1e-9);
                shares[at as usize] += 1.0 / 4000.0;
            }
            shares
        };
        let (across, down) = (weights(x, w, tw), weights(y, h, th));
        (0..h)
            .flat_map(|v| (0..w).map(move |u| (u, v)))
            .map(|(u, v)| down[v] * across[u] * f64::from(src[v * w + u]))
            .sum()
    }

    #[test]
    fn one_prepared_again_does_as_a_new_one_and_refuses_what_it_has_no_room_for() {
        let mut rng = fastrand::Rng::with_seed(11);
        let mut again = Resizer::with_room(24, 16);
        let room = (again.rows.weights.capacity(), again.rows.first.capacity(), again.sums.capacity());
        for n in 0..400 {
            let format = if rng.bool() { Format::Rgb8 } else { Format::Gray8 };
            // The extremes first: all weights there can be.
            let from =
                Shape { width: if n == 0 { 24 } else { rng.usize(1..25) }, height: rng.usize(1..25), format };
            let (width, height) = (if n == 0 { 16 } else { rng.usize(1..17) }, rng.usize(1..17));
            let method = if rng.bool() { Method::Area } else { Method::Bilinear };
            let src: Vec<u8> = std::iter::repeat_with(|| rng.u8(..)).take(from.packed_bytes()).collect();
            assert!(again.prepare(from, width, height, method));
            let mut out = vec![0; again.to().packed_bytes()];
            let src_view = View::packed(from, &src).expect("fits");
            assert!(again.run(&src_view, &mut ViewMut::packed(again.to(), &mut out).expect("fits")));
            let expected = resized(format, (from.width, from.height), &src, (width, height), method);
            assert_eq!(out, expected, "{from} → {width}×{height} {method:?}");
        }
        assert_eq!(
            room,
            (again.rows.weights.capacity(), again.rows.first.capacity(), again.sums.capacity()),
            "nothing was allocated"
        );
        let shape = Shape { width: 25, height: 1, format: Format::Gray8 };
        assert!(!again.prepare(shape, 2, 2, Method::Area), "too wide an image");
        assert!(!again.prepare(Shape { width: 2, ..shape }, 17, 2, Method::Area), "too wide a result");
    }

    #[test]
    fn another_shape_is_not_resized() {
        let shape = Shape { width: 4, height: 4, format: Format::Gray8 };
        let mut resizer = Resizer::new(shape, 2, 2, Method::Area);
        let other = Shape { width: 5, ..shape };
        let mut out = [7; 4];
        let mut dst = ViewMut::packed(resizer.to(), &mut out).expect("fits");
        assert!(!resizer.run(&View::packed(other, &[0; 20]).expect("fits"), &mut dst));
        assert_eq!(out, [7; 4]);
    }
}
