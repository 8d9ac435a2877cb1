//! Payloads as the numbers in them, for filters that treat each number alike.
//!
//! Invariant: the numbers of a payload are always the same ones in the same order; its stamp is none of them,
//! and stays.
use trocar_sdk::data::{Scalar, Wrench};
use trocar_sdk::prelude::*;

use crate::good;

/// A payload of `N` numbers.
pub(crate) trait Lanes<const N: usize>: Copy {
    fn numbers(&self) -> [f64; N];
    /// The same payload with other numbers.
    fn with(self, numbers: [f64; N]) -> Self;

    fn is_good(&self) -> bool {
        self.numbers().iter().all(|n| good::number(*n))
    }
}

/// Filters all samples that wait; tells how many were left out.
pub(crate) fn pass<T: Payload + Lanes<N>, const N: usize>(
    from: &mut In<T>,
    to: &Out<T>,
    mut filter: impl FnMut([f64; N], &Sample<T>) -> [f64; N],
) -> u64 {
    let mut rejected = 0;
    while let Some(sample) = from.next_sample() {
        if sample.value.is_good() {
            let numbers = filter(sample.value.numbers(), &sample);
            to.write_at(&sample.value.with(numbers), sample.stamp);
        } else {
            rejected += 1;
        }
    }
    rejected
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
