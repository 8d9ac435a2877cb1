//! Brightness, contrast and gamma by a table of all levels.
//!
//! Invariant: a table is monotonic; with gain 1, offset 0 and gamma 1 it changes nothing.

use crate::view::ViewMut;

/// The new value of each level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Curve([u8; 256]);

impl Curve {
    /// out = 255 · (gain · in / 255 + offset) ^ (1 / gamma), cut to 0 … 255. `gain` is at least 0, `gamma`
    /// above 0.
    pub fn new(gain: f64, offset: f64, gamma: f64) -> Self {
        Curve(core::array::from_fn(|level| {
            let light = (gain * level as f64 / 255.0 + offset).clamp(0.0, 1.0);
            (255.0 * light.powf(1.0 / gamma)).round() as u8
        }))
    }

    /// Whether it leaves every level as it is.
    pub fn is_identity(&self) -> bool {
        self.0.iter().enumerate().all(|(from, &to)| from == usize::from(to))
    }

    /// Changes all levels of an image, all colours alike.
    pub fn apply(&self, image: &mut ViewMut<'_>) {
        for y in 0..image.shape().height {
            image.row_mut(y).iter_mut().for_each(|level| *level = self.0[usize::from(*level)]);
        }
    }
}

impl Default for Curve {
    fn default() -> Self {
        Curve::new(1.0, 0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::{Format, Shape};

    #[test]
    fn nothing_asked_changes_nothing_and_everything_else_does() {
        assert!(Curve::default().is_identity());
        for (gain, offset, gamma) in [(1.1, 0.0, 1.0), (1.0, 0.1, 1.0), (1.0, 0.0, 2.2)] {
            assert!(!Curve::new(gain, offset, gamma).is_identity());
        }
    }

    #[test]
    fn gain_and_offset_are_cut_at_both_ends_and_gamma_keeps_them() {
        let level = |curve: Curve, from| curve.0[from];
        assert_eq!(level(Curve::new(2.0, 0.0, 1.0), 100), 200);
        assert_eq!(level(Curve::new(2.0, 0.0, 1.0), 200), 255);
        assert_eq!(level(Curve::new(1.0, -0.2, 1.0), 40), 0);
        assert_eq!(level(Curve::new(1.0, 0.0, 2.0), 64), 128);
        assert_eq!((level(Curve::new(1.0, 0.0, 2.2), 0), level(Curve::new(1.0, 0.0, 2.2), 255)), (0, 255));
    }

    #[test]
    fn any_curve_is_monotonic() {
        let mut rng = fastrand::Rng::with_seed(9);
        for _ in 0..500 {
            let curve = Curve::new(8.0 * rng.f64(), 2.0 * rng.f64() - 1.0, 0.1 + 7.9 * rng.f64());
            assert!(curve.0.is_sorted());
        }
    }

    #[test]
    fn padding_is_left_alone() {
        let shape = Shape { width: 1, height: 2, format: Format::Gray8 };
        let mut bytes = [10, 77, 20];
        Curve::new(2.0, 0.0, 1.0).apply(&mut ViewMut::new(shape, 2, &mut bytes).expect("fits"));
        assert_eq!(bytes, [20, 77, 40]);
    }
}
