//! Phasors over the pixels of a spectrum: `exp(j way k)` by multiplication from pixel to pixel.
//!
//! Invariant: a field has, for each pixel of a run, one value per run, so that runs lie side by side; the
//! number of pixels is a multiple of [`BLOCK`]. Nothing here allocates but `lying`.

use std::f64::consts::TAU;

/// Pixels that follow one phasor; their number in a line must be a multiple of it.
pub(crate) const RUN: usize = 32;
/// Runs that are computed side by side.
pub(crate) const LANES: usize = 4;
/// The number of pixels is a multiple of this.
pub(crate) const BLOCK: usize = RUN * LANES;

/// First wavenumber of each run of pixels, and its first and second difference, rad/m.
#[derive(Clone, Debug)]
pub(crate) struct Runs(Vec<[f64; 3]>);

/// Real and imaginary parts, as a field lies.
pub(crate) type Field = [Vec<f32>; 2];

impl Runs {
    /// Makes runs of the wavenumbers of all pixels, rad/m.
    pub(crate) fn of(wavenumber: &[f64]) -> Runs {
        Runs(wavenumber.chunks_exact(RUN).map(differences).collect())
    }

    /// Runs of a line.
    pub(crate) fn rows(&self) -> usize {
        self.0.len()
    }

    /// The values of all pixels, as a field lies.
    pub(crate) fn lying(&self, of: impl Fn(usize) -> f64) -> Vec<f32> {
        let rows = self.rows();
        (0..rows * RUN).map(|at| of(at % rows * RUN + at / rows) as f32).collect()
    }

    /// Gives `amplitude · exp(j way k)` to `each`, `LANES` values at a time, with their first place in a
    /// field; `way` in m.
    pub(crate) fn each(
        &self,
        way: f64,
        amplitude: f32,
        mut each: impl FnMut(usize, &[f32; LANES], &[f32; LANES]),
    ) {
        let rows = self.rows();
        for (chunk, runs) in self.0.chunks_exact(LANES).enumerate() {
            let [mut er, mut ei, mut dr, mut di, mut cr, mut ci] = [[0.0f32; LANES]; 6];
            for (lane, run) in runs.iter().enumerate() {
                let (start, step) = (unit(way * run[0]), unit(way * run[1]));
                (er[lane], ei[lane]) = (amplitude * start[0], amplitude * start[1]);
                [dr[lane], di[lane]] = step;
                // Less than 0.01 rad: two terms are exact in f32.
                let bend = (way * run[2]) as f32;
                (cr[lane], ci[lane]) = (1.0 - 0.5 * bend * bend, bend);
            }
            for pixel in 0..RUN {
                each(pixel * rows + chunk * LANES, &er, &ei);
                // e ← e d, d ← d c.
                for lane in 0..LANES {
                    let (r, i) = (er[lane], ei[lane]);
                    er[lane] = r * dr[lane] - i * di[lane];
                    ei[lane] = r * di[lane] + i * dr[lane];
                    let (r, i) = (dr[lane], di[lane]);
                    dr[lane] = r * cr[lane] - i * ci[lane];
                    di[lane] = r * ci[lane] + i * cr[lane];
                }
            }
        }
    }

    /// Adds `amplitude · exp(j way k)` to a field; `way` in m.
    pub(crate) fn add(&self, re: &mut [f32], im: &mut [f32], way: f64, amplitude: f32) {
        self.each(way, amplitude, |at, er, ei| {
            let (Some(re), Some(im)) = (lanes_mut(re, at), lanes_mut(im, at)) else { return };
            for lane in 0..LANES {
                re[lane] += er[lane];
                im[lane] += ei[lane];
            }
        });
    }
}

/// The values from a place on, as many as there are lanes.
pub(crate) fn lanes(of: &[f32], at: usize) -> Option<&[f32; LANES]> {
    of.get(at..).and_then(<[f32]>::first_chunk)
}

/// As [`lanes`], to be changed.
pub(crate) fn lanes_mut(of: &mut [f32], at: usize) -> Option<&mut [f32; LANES]> {
    of.get_mut(at..).and_then(<[f32]>::first_chunk_mut)
}

fn unit(phase: f64) -> [f32; 2] {
    let (sin, cos) = ((phase - TAU * (phase / TAU).round()) as f32).sin_cos();
    [cos, sin]
}

/// The parabola through first, middle and last wavenumber of a run: value, and first and second difference at
/// its begin. Between them it errs by less than 0.02 rad/m, 1e-4 rad at 2 mm.
fn differences(run: &[f64]) -> [f64; 3] {
    let (middle, last) = (RUN / 2, RUN - 1);
    let (m, l) = (middle as f64, last as f64);
    let (to_middle, to_last) = ((run[middle] - run[0]) / m, (run[last] - run[0]) / l);
    // k_j = k_0 + j d + j (j − 1) / 2 q
    let q = 2.0 * (to_last - to_middle) / (l - m);
    [run[0], to_middle - 0.5 * (m - 1.0) * q, q]
}
