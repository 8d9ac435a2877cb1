//! Remapping of images by precomputed maps, in fixed point: each output pixel is made of four input pixels.
//!
//! Invariant: positions are in 1/32 px and weights exact, so results are those of OpenCV's `remap` with
//! fixed-point maps: what lies outside of the input counts as black. A pixel of an inside span reads only
//! bytes of the input.

use crate::simd::{self, Avx2};
use crate::tap::{STEPS, Tap};
use crate::view::{Format, Shape, View, ViewMut};

/// Output pixels of a row that are made in the same way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Span {
    /// All four input pixels are there.
    Inside(usize),
    /// Some are.
    Rim(usize),
    /// None is.
    Outside(usize),
}

/// A map for images of one size.
#[derive(Clone, Debug)]
pub struct Remap {
    width: usize,
    height: usize,
    taps: Vec<Tap>,
    spans: Vec<Span>,
    /// First span of each row, and the end of the last one.
    rows: Vec<usize>,
    lanes: Option<Avx2>,
}

impl Remap {
    /// A map from `source(column, row)`, px of the input; not a number means nowhere. Sides are at most 16
    /// 384 px.
    pub fn new(width: usize, height: usize, source: impl Fn(f64, f64) -> (f64, f64)) -> Self {
        let mut map = Remap {
            width,
            height,
            taps: Vec::with_capacity(width * height),
            spans: Vec::new(),
            rows: vec![0],
            lanes: Avx2::detect(),
        };
        for y in 0..height {
            let mut last: Option<Span> = None;
            for x in 0..width {
                let (tap, kind) = map.tap(source(x as f64, y as f64));
                map.taps.push(tap);
                last = Some(match (last, kind) {
                    (Some(Span::Inside(n)), Span::Inside(_)) => Span::Inside(n + 1),
                    (Some(Span::Rim(n)), Span::Rim(_)) => Span::Rim(n + 1),
                    (Some(Span::Outside(n)), Span::Outside(_)) => Span::Outside(n + 1),
                    (other, kind) => {
                        map.spans.extend(other);
                        kind
                    }
                });
            }
            map.spans.extend(last);
            map.rows.push(map.spans.len());
        }
        map
    }

    fn tap(&self, (u, v): (f64, f64)) -> (Tap, Span) {
        let (width, height) = (self.width as i32, self.height as i32);
        // Further away is as black as just outside; not a number becomes that, too.
        let at = |p: f64, side: i32| {
            let far = f64::from(side + 1);
            if p.is_nan() {
                -2 * STEPS
            } else {
                (p.clamp(-2.0, far) * f64::from(STEPS)).round_ties_even() as i32
            }
        };
        let (u, v) = (at(u, width), at(v, height));
        let (x, y) = (u.div_euclid(STEPS), v.div_euclid(STEPS));
        let tap =
            Tap { x: x as i16, y: y as i16, fx: u.rem_euclid(STEPS) as u8, fy: v.rem_euclid(STEPS) as u8 };
        // Eight bytes are read for six: in the last row they must end before the image does.
        let reads_end = if y + 2 == height { 3 } else { 2 };
        let kind = if x >= 0 && y >= 0 && x + reads_end <= width && y + 2 <= height {
            Span::Inside(1)
        } else if x < -1 || y < -1 || x >= width || y >= height {
            Span::Outside(1)
        } else {
            Span::Rim(1)
        };
        (tap, kind)
    }

    /// Width and height of the images, px.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// The same map without special instructions; the result is the same.
    #[must_use]
    pub fn portable(mut self) -> Self {
        self.lanes = None;
        self
    }

    /// Remaps `src` into `dst`. False, with `dst` untouched, when a size is another one or the formats
    /// differ.
    #[must_use]
    pub fn run(&self, src: &View<'_>, dst: &mut ViewMut<'_>) -> bool {
        let Shape { width, height, .. } = src.shape();
        if (width, height) != self.size() || dst.shape() != src.shape() {
            return false;
        }
        for y in 0..height {
            let row = dst.row_mut(y);
            match src.shape().format {
                Format::Gray8 => self.row::<1>(src, y, row),
                Format::Rgb8 => self.row::<3>(src, y, row),
            }
        }
        true
    }

    fn row<const N: usize>(&self, src: &View<'_>, y: usize, row: &mut [u8]) {
        let mut x = 0;
        let taps = &self.taps[y * self.width..][..self.width];
        let pixels = row.as_chunks_mut::<N>().0;
        let (bytes, stride) = (src.bytes(), src.stride());
        for span in &self.spans[self.rows[y]..self.rows[y + 1]] {
            let (Span::Inside(n) | Span::Rim(n) | Span::Outside(n)) = *span;
            let (taps, to) = (&taps[x..x + n], &mut pixels[x..x + n]);
            match span {
                Span::Inside(_) => {
                    let done = match self.lanes {
                        Some(lanes) if N == 3 => {
                            simd::remap_rgb(lanes, bytes, stride, taps, to.as_flattened_mut())
                        }
                        _ => 0,
                    };
                    for (tap, to) in taps.iter().zip(to).skip(done) {
                        *to = inside(bytes, stride, tap);
                    }
                }
                Span::Rim(_) => taps.iter().zip(to).for_each(|(tap, to)| *to = rim(src, tap)),
                Span::Outside(_) => to.fill([0; N]),
            }
            x += n;
        }
    }
}

/// Between four pixels, all of which are there; rows of `bytes` begin every `stride` bytes.
#[inline]
fn inside<const N: usize>(bytes: &[u8], stride: usize, tap: &Tap) -> [u8; N] {
    let at = tap.y as usize * stride + tap.x as usize * N;
    let two = |at: usize| {
        let (one, rest) = bytes.get(at..)?.split_first_chunk::<N>()?;
        Some((one, rest.first_chunk::<N>()?))
    };
    match two(at).zip(two(at + stride)) {
        Some((above, below)) => blend([*above.0, *above.1, *below.0, *below.1], tap),
        // Not reached: an inside span has all four.
        None => [0; N],
    }
}

/// Between four pixels, of which some are black because they lie outside.
fn rim<const N: usize>(src: &View<'_>, tap: &Tap) -> [u8; N] {
    let Shape { width, height, .. } = src.shape();
    let pixel = |dx: i32, dy: i32| {
        let (x, y) = (i32::from(tap.x) + dx, i32::from(tap.y) + dy);
        let there = (0..width as i32).contains(&x) && (0..height as i32).contains(&y);
        let pixel = || src.row(y as usize)[x as usize * N..].first_chunk::<N>().copied();
        there.then(pixel).flatten().unwrap_or([0; N])
    };
    blend([pixel(0, 0), pixel(1, 0), pixel(0, 1), pixel(1, 1)], tap)
}

#[inline]
fn blend<const N: usize>(pixels: [[u8; N]; 4], tap: &Tap) -> [u8; N] {
    let (fx, fy) = (u32::from(tap.fx), u32::from(tap.fy));
    let steps = STEPS as u32;
    core::array::from_fn(|c| {
        let [a, b, d, e] = pixels.map(|p| u32::from(p[c]));
        let (above, below) = (a * (steps - fx) + b * fx, d * (steps - fx) + e * fx);
        ((above * (steps - fy) + below * fy + steps * steps / 2) / (steps * steps)) as u8
    })
}

#[cfg(test)]
#[path = "remap_tests.rs"]
mod tests;
