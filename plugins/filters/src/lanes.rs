//! Payloads as the numbers in them, for filters that treat each number alike.
//!
//! Invariant: the numbers of a payload are always the same ones in the same order; its stamp is none of them.

use trocar_sdk::data::{Scalar, Wrench};

/// A payload of `N` numbers.
pub(crate) trait Lanes<const N: usize>: Copy {
    fn numbers(&self) -> [f64; N];
    /// The same payload with other numbers.
    fn with(self, numbers: [f64; N]) -> Self;

    fn is_finite(&self) -> bool {
        self.numbers().iter().all(|n| n.is_finite())
    }
}

impl Lanes<1> for Scalar {
    fn numbers(&self) -> [f64; 1] {
        [self.value]
    }
    fn with(self, [value]: [f64; 1]) -> Self {
        Scalar { value, ..self }
    }
}

impl Lanes<6> for Wrench {
    fn numbers(&self) -> [f64; 6] {
        let ([a, b, c], [d, e, f]) = (self.force, self.torque);
        [a, b, c, d, e, f]
    }
    fn with(self, [a, b, c, d, e, f]: [f64; 6]) -> Self {
        Wrench { force: [a, b, c], torque: [d, e, f], ..self }
    }
}
