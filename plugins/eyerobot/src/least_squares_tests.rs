//! The solver against brute force over all sets of active half-spaces, and its corner cases.
//!
//! Invariant: random problems are small enough that every set of active half-spaces can be tried.

use super::*;
use proptest::prelude::*;

/// Returns the best feasible point of all that lie on the borders of some half-spaces; none if there is no
/// feasible one.
fn brute_force(h: &Square, g: &Joints, set: &HalfSpaces) -> Option<(f64, Joints)> {
    let rows: Vec<(Joints, f64)> = set.iter().map(|(normal, bound)| (*normal, bound)).collect();
    let inverse = h.try_inverse().expect("positive definite");
    let mut best: Option<(f64, Joints)> = None;
    for chosen in 0u32..1 << rows.len() {
        if chosen.count_ones() as usize > COUNT {
            continue;
        }
        let on: Vec<&(Joints, f64)> =
            rows.iter().enumerate().filter(|(i, _)| chosen >> i & 1 == 1).map(|(_, row)| row).collect();
        let n = on.len();
        // Minimise on the borders: (N H⁻¹ Nᵀ) u = N H⁻¹ g − b, q̇ = H⁻¹ (g − Nᵀ u).
        let gram = nalgebra::DMatrix::from_fn(n, n, |i, j| on[i].0.dot(&(inverse * on[j].0)));
        let right = nalgebra::DVector::from_fn(n, |i, _| on[i].0.dot(&(inverse * g)) - on[i].1);
        let u = if n == 0 { Some(right) } else { gram.lu().solve(&right) };
        let Some(u) = u else { continue };
        let pushed = on.iter().zip(u.iter()).fold(*g, |sum, (row, u)| sum - row.0 * *u);
        let q = inverse * pushed;
        if !q.iter().all(|v| v.is_finite())
            || rows.iter().any(|(normal, bound)| normal.dot(&q) > bound + 1e-9)
        {
            continue;
        }
        let cost = cost(h, g, &q);
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, q));
        }
    }
    best
}

fn cost(h: &Square, g: &Joints, q: &Joints) -> f64 {
    0.5 * q.dot(&(h * q)) - g.dot(q)
}

fn vector() -> impl Strategy<Value = Joints> {
    prop::array::uniform5(-1.0..1.0).prop_map(|v| Joints::from_column_slice(&v))
}

fn objective() -> impl Strategy<Value = (Square, Joints)> {
    (prop::array::uniform5(vector()), vector()).prop_map(|(rows, g)| {
        let a = Square::from_columns(&rows);
        (a.tr_mul(&a) + Square::identity() * 0.01, g)
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_solution_is_that_of_brute_force(
        (h, g) in objective(),
        rows in prop::collection::vec((vector(), -0.2..1.0), 0..9),
    ) {
        let mut set = HalfSpaces::default();
        for (normal, bound) in rows {
            prop_assert!(set.push(normal, bound));
        }
        match (nearest(&h, &g, &set), brute_force(&h, &g, &set)) {
            (Ok(found), Some((least, best))) => {
                prop_assert!(set.iter().all(|(n, b)| n.dot(&found.velocity) <= b + 1e-9));
                prop_assert!(cost(&h, &g, &found.velocity) <= least + 1e-9, "{} for {least}", cost(&h, &g, &found.velocity));
                prop_assert!((found.velocity - best).norm() < 1e-3);
            }
            (Err(Unsolved::Infeasible), None) => {}
            (found, best) => prop_assert!(false, "{found:?} instead of {best:?}"),
        }
    }

    #[test]
    fn inside_a_box_that_holds_zero_there_is_always_a_solution(
        (h, g) in objective(),
        upper in prop::array::uniform5(0.0..0.1),
        rows in prop::collection::vec((vector(), 0.0..0.1), 0..32),
    ) {
        let upper = Joints::from_column_slice(&upper);
        let mut set = HalfSpaces::within(&(-upper * 0.5), &upper);
        for (normal, bound) in rows {
            prop_assert!(set.push(normal, bound));
        }
        let found = nearest(&h, &g, &set);
        let found = found.map_err(|why| TestCaseError::fail(format!("{why:?}")))?;
        prop_assert!(set.iter().all(|(n, b)| n.dot(&found.velocity) <= b + 1e-9));
    }
}

#[test]
fn without_half_spaces_it_is_the_solution_of_the_normal_equations() {
    let (h, g) = near(&Joints::from_column_slice(&[1.0, -2.0, 3.0, 0.5, 0.0]), &Joints::repeat(0.3));
    let found = nearest(&h, &g, &HalfSpaces::default()).expect("solvable");
    let off = found.velocity - Joints::from_column_slice(&[1.0, -2.0, 3.0, 0.5, 0.0]);
    assert!(off.norm() < 1e-12, "{off:?}");
}

#[test]
fn a_bound_that_is_passed_is_kept_exactly_and_named() {
    let wanted = Joints::from_column_slice(&[1.0, -2.0, 0.0, 0.0, 0.0]);
    let (h, g) = near(&wanted, &Joints::repeat(1.0));
    let found = nearest(&h, &g, &HalfSpaces::within(&Joints::repeat(-1.0), &Joints::repeat(3.0)));
    let found = found.expect("solvable");
    assert!((found.velocity - Joints::from_column_slice(&[1.0, -1.0, 0.0, 0.0, 0.0])).norm() < 1e-12);
    assert!(found.is_held_by(3) && !found.is_held_by(2) && !found.is_held_by(0), "{found:?}");
}

#[test]
fn half_spaces_without_a_common_point_are_told() {
    let (h, g) = near(&Joints::zeros(), &Joints::repeat(1.0));
    let mut set = HalfSpaces::within(&Joints::repeat(-1.0), &Joints::repeat(1.0));
    set.push(Joints::repeat(1.0), -6.0);
    assert!(matches!(nearest(&h, &g, &set), Err(Unsolved::Infeasible)));
    let mut nowhere = HalfSpaces::default();
    nowhere.push(Joints::zeros(), -1.0);
    assert!(matches!(nearest(&h, &g, &nowhere), Err(Unsolved::Infeasible)));
}

#[test]
fn the_same_half_space_many_times_is_one() {
    let (h, g) = near(&Joints::repeat(1.0), &Joints::repeat(1.0));
    let mut set = HalfSpaces::default();
    while set.push(Joints::repeat(1.0), 1.0) {}
    assert_eq!(set.len(), MOST);
    let found = nearest(&h, &g, &set).expect("solvable");
    assert!((found.velocity - Joints::repeat(0.2)).norm() < 1e-12, "{found:?}");
}

#[test]
fn an_objective_that_is_no_number_or_flat_is_refused() {
    let nan = Joints::repeat(f64::NAN);
    assert!(matches!(nearest(&Square::identity(), &nan, &HalfSpaces::default()), Err(Unsolved::Objective)));
    let flat = nearest(&Square::zeros(), &Joints::zeros(), &HalfSpaces::default());
    assert!(matches!(flat, Err(Unsolved::Objective)));
}
