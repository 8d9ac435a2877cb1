//! Blur of the microscope outside of its focal plane, and the blur of the retina at rest.
//!
//! Invariant: what lies within the depth of field of the nominal apex is not touched at all; beyond it the
//! blur grows with height and then stays, since a surgeon focuses anew before it is larger.

use crate::camera::{Camera, FIELD_M, WORKING_DISTANCE_M};

/// Nothing is blurred that is no further than this from the focal plane, z = 0, m.
const SHARP_M: f64 = 0.2e-3;
/// Beyond it the blur grows over about this height, m,
const GROWS_M: f64 = 2e-3;
/// to this standard deviation, px of a picture that is 1024 px wide.
const MOST_PX: f64 = 2.4;
/// Half the width of the edge of what is in focus, px: that of a pixel, smoothed.
const EDGE_PX: f64 = 0.8;
/// The kernels reach this many pixels to each side, and differ by this part of a pixel.
const REACH: usize = 7;
const STEPS_PER_PX: f32 = 8.0;
/// Less blur than this is none, px.
const LEAST_PX: f32 = 0.2;

/// Standard deviation of the blur at height `z` (m, world), px.
pub(crate) fn blur_px(camera: &Camera, z: f64) -> f64 {
    let per_1024 = camera.focal_px * FIELD_M / WORKING_DISTANCE_M / 1024.0;
    let beyond = (z.abs() - SHARP_M).max(0.0);
    MOST_PX * per_1024 * (1.0 - (-beyond / GROWS_M).exp())
}

/// Half the width of the soft edge of a tool at height `z` (m, world), px.
pub(crate) fn edge_px(camera: &Camera, z: f64) -> f64 {
    EDGE_PX + 1.5 * blur_px(camera, z)
}

/// Blurs a picture of rows of `width` pixels, red, green, blue: each pixel by its own standard deviation, px.
/// First along x, then along y; the blur of neighbours is nearly the same.
pub(crate) fn blur(colour: &mut [u8], blurs_px: &[f32], width: usize) {
    let most = blurs_px.iter().copied().fold(0.0, f32::max);
    let kernels: Vec<_> =
        (0..=(most * STEPS_PER_PX) as usize + 1).map(|n| kernel(n as f32 / STEPS_PER_PX)).collect();
    let height = blurs_px.len() / width.max(1);
    let mut between = colour.to_vec();
    pass(colour, &mut between, blurs_px, &kernels, 1, |at| (at % width, width));
    pass(&between, colour, blurs_px, &kernels, width, |at| (at / width, height));
}

/// Weights of a Gaussian with this standard deviation, px, from its middle on; of both sides together they
/// sum to 1.
fn kernel(deviation_px: f32) -> [f32; REACH + 1] {
    let raw: [f32; REACH + 1] =
        std::array::from_fn(|n| (-((n * n) as f32) / (2.0 * deviation_px * deviation_px).max(1e-6)).exp());
    let sum = 2.0 * raw.iter().sum::<f32>() - raw[0];
    raw.map(|weight| weight / sum)
}

/// Blurs along one axis, on which pixels are `apart` places apart; `place` tells a pixel's place on it and
/// how many there are.
fn pass(
    from: &[u8],
    to: &mut [u8],
    blurs_px: &[f32],
    kernels: &[[f32; REACH + 1]],
    apart: usize,
    place: impl Fn(usize) -> (usize, usize),
) {
    let (from, _) = from.as_chunks::<3>();
    let (to, _) = to.as_chunks_mut::<3>();
    for (at, (to, blur_px)) in to.iter_mut().zip(blurs_px).enumerate() {
        if *blur_px < LEAST_PX {
            *to = from[at];
            continue;
        }
        let kernel = &kernels[(blur_px * STEPS_PER_PX + 0.5) as usize];
        let (here, of) = place(at);
        let reach = ((3.0 * blur_px) as usize + 1).min(REACH);
        let mut sum = from[at].map(|value| f32::from(value) * kernel[0]);
        for (n, weight) in kernel.iter().enumerate().take(reach + 1).skip(1) {
            let before = from[at - n.min(here) * apart];
            let after = from[at + n.min(of - 1 - here) * apart];
            for ((sum, before), after) in sum.iter_mut().zip(before).zip(after) {
                *sum += weight * f32::from(u16::from(before) + u16::from(after));
            }
        }
        *to = sum.map(|value| (value + 0.5) as u8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Rig;

    #[test]
    fn the_apex_is_sharp_and_the_blur_grows_with_height_to_a_limit() {
        let camera = Rig::rectified(1024, 768).cameras[0];
        assert_eq!([0.0, 0.1e-3, -0.15e-3].map(|z| blur_px(&camera, z)), [0.0; 3]);
        let heights = [-0.3e-3, -1e-3, -3e-3, -10e-3, -0.1].map(|z| blur_px(&camera, z));
        assert!(heights.is_sorted_by(|a, b| a < b) && heights[4] <= MOST_PX, "{heights:?}");
        assert!((0.5..1.5).contains(&heights[1]), "{heights:?}: at the rim of the field");
    }

    #[test]
    fn a_blurred_point_keeps_its_light_and_a_sharp_one_its_place() {
        let mut colour = vec![0; 3 * 31 * 31];
        colour[3 * (15 * 31 + 15)..][..3].fill(255);
        let sharp = colour.clone();
        blur(&mut colour, &[0.0; 31 * 31], 31);
        assert_eq!(colour, sharp);
        blur(&mut colour, &[1.5; 31 * 31], 31);
        let (middle, light) = (colour[3 * (15 * 31 + 15)], colour.iter().map(|v| u32::from(*v)).sum::<u32>());
        assert!((10..30).contains(&middle), "{middle}");
        assert!((600..900).contains(&light), "{light} of 765");
        let [left, right] = [14, 16].map(|x| colour[3 * (15 * 31 + x)]);
        assert_eq!(left, right);
    }
}
