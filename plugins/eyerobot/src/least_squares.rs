//! Constrained least squares: of all joint velocities inside half-spaces the one nearest to what is wanted.
//!
//! Invariant: fixed size, no allocation, bounded rounds; what is returned satisfies every half-space within
//! [`TOLERANCE`], or nothing is returned. Method: D. Goldfarb, A. Idnani, *A numerically stable dual method
//! for solving strictly convex quadratic programs*, Mathematical Programming 27 (1983), after the change of
//! variables that makes the objective a plain distance; as control of a robot with virtual fixtures: A.
//! Kapoor, M. Li, R. H. Taylor, *Constrained control for surgical assistant robots*, ICRA 2006.

use nalgebra::{SMatrix, Vector6};

use crate::joints::{COUNT, Joints};

/// Most half-spaces of one problem: two per joint, and four for each of eight fixtures and a guard.
pub const MOST: usize = 2 * COUNT + 36;

/// Most that a half-space may be left, in the scaled variables (m/s at the tip).
pub const TOLERANCE: f64 = 1e-12;

/// Half-spaces are added one at a time and seldom dropped again; this many are never needed.
const ROUNDS: usize = 4 * MOST;

/// Sine below which a normal lies in the span of the active ones.
const DEPENDENT: f64 = 1e-9;

/// Positive definite 5 × 5 matrix of an objective.
pub type Square = SMatrix<f64, COUNT, COUNT>;

/// A set of half-spaces `normal · q̇ ≤ bound`.
#[derive(Clone, Copy, Debug)]
pub struct HalfSpaces {
    normals: [Joints; MOST],
    bounds: [f64; MOST],
    len: usize,
}

impl Default for HalfSpaces {
    fn default() -> Self {
        HalfSpaces { normals: [Joints::zeros(); MOST], bounds: [0.0; MOST], len: 0 }
    }
}

impl HalfSpaces {
    /// Adds `normal · q̇ ≤ bound`; tells whether there was room.
    pub fn push(&mut self, normal: Joints, bound: f64) -> bool {
        if self.len == MOST {
            return false;
        }
        (self.normals[self.len], self.bounds[self.len]) = (normal, bound);
        self.len += 1;
        true
    }

    /// Lower and upper bounds of each joint: half-spaces 2 i (upper) and 2 i + 1 (lower) of an empty set.
    pub fn within(lower: &Joints, upper: &Joints) -> HalfSpaces {
        let mut set = HalfSpaces::default();
        for i in 0..COUNT {
            let mut along = Joints::zeros();
            along[i] = 1.0;
            set.push(along, upper[i]);
            set.push(-along, -lower[i]);
        }
        set
    }

    /// Number of half-spaces.
    pub fn len(&self) -> usize {
        self.len
    }

    /// No half-space at all.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The half-spaces: normal and bound.
    pub fn iter(&self) -> impl Iterator<Item = (&Joints, f64)> {
        self.normals.iter().zip(self.bounds).take(self.len)
    }

    /// Every half-space holds at `velocity`, within a rounding of its own size.
    pub fn hold(&self, velocity: &Joints) -> bool {
        self.iter().all(|(normal, bound)| normal.dot(velocity) <= bound + TOLERANCE)
    }
}

/// The nearest velocities, and which half-spaces hold them back.
#[derive(Clone, Copy, Debug)]
pub struct Nearest {
    /// Joint velocities, m/s and rad/s.
    pub velocity: Joints,
    active: Active,
}

impl Nearest {
    /// The half-space holds the velocities back: without it they were others.
    pub fn is_held_by(&self, half_space: usize) -> bool {
        (0..self.active.len).any(|i| self.active.index[i] == half_space && self.active.force[i] > 0.0)
    }
}

/// Why there is no solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsolved {
    /// The objective is not positive definite, or not finite.
    Objective,
    /// The half-spaces have no common point, or none was found in the bounded number of rounds.
    Infeasible,
}

/// Minimises `½ q̇ᵀ H q̇ − gᵀ q̇` over `half_spaces`; for `‖A q̇ − b‖²` that is `H = AᵀA`, `g = Aᵀb`.
///
/// # Errors
/// An objective that is not positive definite; half-spaces without a common point.
pub fn nearest(h: &Square, g: &Joints, half_spaces: &HalfSpaces) -> Result<Nearest, Unsolved> {
    let l = h.cholesky().ok_or(Unsolved::Objective)?.unpack();
    // In y = Lᵀ q̇ the objective is ½‖y − L⁻¹g‖²; half-spaces become `normal · y ≥ offset` with unit normals.
    let scaled = |v: &Joints| l.solve_lower_triangular(v).ok_or(Unsolved::Objective);
    let mut y = scaled(g)?;
    if !y.iter().all(|v| v.is_finite()) {
        return Err(Unsolved::Objective);
    }
    let mut set = Scaled { normals: [Joints::zeros(); MOST], offsets: [f64::NEG_INFINITY; MOST] };
    for (i, (normal, bound)) in half_spaces.iter().enumerate() {
        let inward = -scaled(normal)?;
        let length = inward.norm();
        if length > 0.0 {
            (set.normals[i], set.offsets[i]) = (inward / length, -bound / length);
        } else if bound < 0.0 {
            return Err(Unsolved::Infeasible);
        }
    }
    let mut active = Active::default();
    for _ in 0..ROUNDS {
        let Some(violated) = set.most_violated(&y, half_spaces.len) else {
            let velocity = l.transpose().solve_upper_triangular(&y).ok_or(Unsolved::Objective)?;
            return Ok(Nearest { velocity, active });
        };
        active.add(violated, &set, &mut y)?;
    }
    Err(Unsolved::Infeasible)
}

/// Half-spaces in the scaled variables.
struct Scaled {
    normals: [Joints; MOST],
    offsets: [f64; MOST],
}

impl Scaled {
    fn slack(&self, i: usize, y: &Joints) -> f64 {
        self.normals[i].dot(y) - self.offsets[i]
    }

    fn most_violated(&self, y: &Joints, len: usize) -> Option<usize> {
        let mut worst = (-TOLERANCE, None);
        for i in 0..len {
            let slack = self.slack(i, y);
            if slack < worst.0 {
                worst = (slack, Some(i));
            }
        }
        worst.1
    }
}

/// Half-spaces on whose border the point lies, and the force with which each pushes it. Their normals are
/// independent, so there are no more of them than joints.
#[derive(Clone, Copy, Debug, Default)]
struct Active {
    index: [usize; COUNT],
    force: [f64; COUNT],
    len: usize,
}

impl Active {
    /// Moves `y` onto the border of half-space `new`, along the borders it lies on; those that would pull
    /// instead of push on the way there are dropped.
    fn add(&mut self, new: usize, set: &Scaled, y: &mut Joints) -> Result<(), Unsolved> {
        let mut force = 0.0;
        // Each turn drops one or ends.
        for _ in 0..=COUNT {
            let (across, shares) = self.split(&set.normals[new], set);
            let steep = across.norm_squared();
            let full = if steep > DEPENDENT * DEPENDENT { -set.slack(new, y) / steep } else { f64::INFINITY };
            let mut first = (f64::INFINITY, None);
            for (i, (force, share)) in self.force.iter().zip(&shares).take(self.len).enumerate() {
                if *share > DEPENDENT && force / share < first.0 {
                    first = (force / share, Some(i));
                }
            }
            let step = full.min(first.0);
            if step.is_infinite() {
                return Err(Unsolved::Infeasible);
            }
            if full.is_finite() {
                *y += across * step;
            }
            for (force, share) in self.force.iter_mut().zip(&shares).take(self.len) {
                *force -= step * share;
            }
            force += step;
            match first.1 {
                Some(drop) if first.0 < full => self.remove(drop),
                _ => {
                    // `full` is finite here, so the new normal is independent of less than COUNT others.
                    (self.index[self.len], self.force[self.len]) = (new, force);
                    self.len += 1;
                    return Ok(());
                }
            }
        }
        Err(Unsolved::Infeasible)
    }

    fn remove(&mut self, at: usize) {
        self.len -= 1;
        self.index.copy_within(at + 1..=self.len, at);
        self.force.copy_within(at + 1..=self.len, at);
    }

    /// `normal` as a part across all active normals and a sum of these: the part and the shares of the sum.
    fn split(&self, normal: &Joints, set: &Scaled) -> (Joints, [f64; COUNT]) {
        let mut basis = [Joints::zeros(); COUNT];
        let mut triangle = [[0.0; COUNT]; COUNT];
        for column in 0..self.len {
            let mut rest = set.normals[self.index[column]];
            // Twice is enough: the second pass takes away what rounding left of the first.
            for _ in 0..2 {
                for row in 0..column {
                    let along = basis[row].dot(&rest);
                    rest -= basis[row] * along;
                    triangle[row][column] += along;
                }
            }
            let length = rest.norm();
            triangle[column][column] = length;
            basis[column] = rest / length;
        }
        let (mut across, mut along) = (*normal, [0.0; COUNT]);
        for _ in 0..2 {
            for row in 0..self.len {
                let part = basis[row].dot(&across);
                across -= basis[row] * part;
                along[row] += part;
            }
        }
        for row in (0..self.len).rev() {
            for column in row + 1..self.len {
                along[row] -= triangle[row][column] * along[column];
            }
            along[row] /= triangle[row][row];
        }
        (across, along)
    }
}

/// The objective of joint velocities alone: their distance from `wanted`, each joint scaled by `scale`.
pub fn near(wanted: &Joints, scale: &Joints) -> (Square, Joints) {
    let squares = scale.component_mul(scale);
    (Square::from_diagonal(&squares), squares.component_mul(wanted))
}

/// Returns the objective `‖jacobian · q̇ − wanted‖²`, damped by `damping · scale` per joint so that it always
/// has one minimum.
pub fn track(
    jacobian: &SMatrix<f64, 6, COUNT>,
    wanted: &Vector6<f64>,
    scale: &Joints,
    damping: f64,
) -> (Square, Joints) {
    let damped = scale.map(|s| (damping * s).powi(2));
    (jacobian.tr_mul(jacobian) + Square::from_diagonal(&damped), jacobian.tr_mul(wanted))
}

#[cfg(test)]
#[path = "least_squares_tests.rs"]
mod tests;
