//! Trajectories for `move_jp`: a trapezoid of velocity per joint, stretched so that all joints arrive
//! together.
//!
//! Invariant: a planned trajectory never exceeds the speed and acceleration it was planned with (unless it
//! starts faster, then it brakes at once) and ends exactly at its goal, at rest. A profile has at most three
//! phases of constant acceleration, joined by d = (v₀ + v₁)/2 · t and v₁² = v₀² + 2 a d; `at` is closed form,
//! only `plan` iterates (bounded).

use crate::joints::{COUNT, Joints, Limits};

/// Halvings when a joint's cruise speed is fitted to the slowest joint's time; 2⁻⁵⁰ of the speed is left.
const HALVINGS: usize = 50;

/// A motion of all joints to a goal.
#[derive(Clone, Copy, Debug)]
pub struct Trajectory {
    profiles: [Profile; COUNT],
    duration_s: f64,
}

impl Trajectory {
    /// Plans from `position` with `velocity` to rest at `goal`. From rest all joints arrive together; a joint
    /// that already moves may overshoot by its own braking distance, and come back.
    pub fn plan(position: &Joints, velocity: &Joints, goal: &Joints, limits: &Limits) -> Self {
        let plan = |i: usize, speed: f64| {
            Profile::plan(position[i], velocity[i], goal[i], speed, limits.acceleration[i])
        };
        let mut profiles: [Profile; COUNT] = std::array::from_fn(|i| plan(i, limits.speed[i]));
        let duration_s = profiles.iter().map(Profile::duration_s).fold(0.0, f64::max);
        for (i, profile) in profiles.iter_mut().enumerate() {
            let (mut slow, mut fast) = (0.0, limits.speed[i]);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (slow + fast);
                let tried = plan(i, middle);
                if tried.duration_s() <= duration_s {
                    (fast, *profile) = (middle, tried)
                } else {
                    slow = middle
                }
            }
        }
        Trajectory { profiles, duration_s }
    }

    /// Time from start to rest, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Returns position (m, rad) and velocity (m/s, rad/s) at `t_s` seconds after the start; the goal at rest
    /// once it is over.
    pub fn at(&self, t_s: f64) -> (Joints, Joints) {
        let at = self.profiles.map(|profile| profile.at(t_s));
        (Joints::from_fn(|i, _| at[i].0), Joints::from_fn(|i, _| at[i].1))
    }
}

/// Part of the acceleration with which `approach` means to brake; the rest is for what the period rounds.
const BRAKING: f64 = 0.8;

/// Returns the velocity of one joint for the next period of `dt_s` that brings it to `goal` soon and at rest,
/// within `speed` and `acceleration`, from `position` with `velocity`: for goals that may be another one in
/// each period.
pub fn approach(position: f64, velocity: f64, goal: f64, speed: f64, acceleration: f64, dt_s: f64) -> f64 {
    let way = goal - position;
    let stoppable = (2.0 * BRAKING * acceleration * way.abs()).sqrt();
    let wanted = (way.abs() / dt_s).min(stoppable).min(speed).copysign(way);
    let most = acceleration * dt_s;
    wanted.max(velocity - most).min(velocity + most)
}

/// One joint's motion: change to the cruise velocity, cruise, brake.
#[derive(Clone, Copy, Debug)]
struct Profile {
    start: f64,
    start_velocity: f64,
    cruise_velocity: f64,
    goal: f64,
    acceleration: f64,
    change_s: f64,
    cruise_s: f64,
    brake_s: f64,
}

impl Profile {
    fn plan(start: f64, start_velocity: f64, goal: f64, speed: f64, acceleration: f64) -> Self {
        let way = goal - start;
        // The place where the joint would rest if it braked now decides in which direction it has to go.
        let to_go = way - start_velocity * start_velocity.abs() / (2.0 * acceleration);
        let side = if to_go < 0.0 { -1.0 } else { 1.0 };
        let mut cruise_velocity = side * speed;
        let phases =
            |cruise: f64| ((cruise - start_velocity).abs() / acceleration, cruise.abs() / acceleration);
        let (mut change_s, mut brake_s) = phases(cruise_velocity);
        let left =
            way - 0.5 * (start_velocity + cruise_velocity) * change_s - 0.5 * cruise_velocity * brake_s;
        let mut cruise_s = left / cruise_velocity;
        if left * side <= 0.0 {
            // Too short to reach the speed: peak where accelerating and braking together cover the way.
            let peak = side * way * acceleration + 0.5 * start_velocity * start_velocity;
            cruise_velocity = side * peak.max(0.0).sqrt();
            (change_s, brake_s) = phases(cruise_velocity);
            cruise_s = 0.0;
        }
        Profile { start, start_velocity, cruise_velocity, goal, acceleration, change_s, cruise_s, brake_s }
    }

    fn duration_s(&self) -> f64 {
        self.change_s + self.cruise_s + self.brake_s
    }

    fn at(&self, t: f64) -> (f64, f64) {
        let left = self.duration_s() - t;
        if left <= 0.0 {
            return (self.goal, 0.0);
        }
        if left < self.brake_s {
            // Seen from the goal backwards, so that the end is exact.
            let brake = self.acceleration.copysign(self.cruise_velocity);
            return (self.goal - 0.5 * brake * left * left, brake * left);
        }
        if t < self.change_s {
            let a = self.acceleration.copysign(self.cruise_velocity - self.start_velocity);
            return (self.start + (self.start_velocity + 0.5 * a * t) * t, self.start_velocity + a * t);
        }
        let changed = self.start + 0.5 * (self.start_velocity + self.cruise_velocity) * self.change_s;
        (changed + self.cruise_velocity * (t - self.change_s), self.cruise_velocity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::joints::per_kind;

    #[test]
    fn an_approach_reaches_its_goal_exactly_at_rest_without_passing_it_by_more_than_a_micrometre() {
        let mut rng = fastrand::Rng::with_seed(8);
        for _ in 0..200 {
            let (mut q, mut v) = (0.0, 0.01 * (2.0 * rng.f64() - 1.0));
            let goal = 0.01 * (2.0 * rng.f64() - 1.0);
            let braking_way = v * v;
            for _ in 0..2_500 {
                let after = approach(q, v, goal, 0.01, 0.5, 1e-3);
                assert!(after.abs() <= 0.01 + 1e-12 && (after - v).abs() <= 0.5e-3 + 1e-12);
                (q, v) = (q + after * 1e-3, after);
                let passed = if goal > 0.0 { q - goal } else { goal - q };
                assert!(passed < 1e-6 + braking_way, "{passed} m beyond");
            }
            assert!((q - goal).abs() < 1e-15 && v.abs() < 1e-12, "{q} instead of {goal}, {v} m/s");
        }
    }

    fn random(rng: &mut fastrand::Rng, lower: &Joints, upper: &Joints) -> Joints {
        Joints::from_fn(|i, _| lower[i] + rng.f64() * (upper[i] - lower[i]))
    }

    #[test]
    fn a_long_move_of_one_joint_is_the_textbook_trapezoid() {
        let goal = per_kind(0.02, 0.0);
        let t = Trajectory::plan(&Joints::zeros(), &Joints::zeros(), &goal, &Limits::default());
        // 20 mm at 10 mm/s with 0.5 m/s²: 2 s of way plus 20 ms for one ramp.
        assert!((t.duration_s() - 2.02).abs() < 1e-12, "{}", t.duration_s());
        let (q, v) = t.at(0.02);
        assert!((q[0] - 1e-4).abs() < 1e-12 && (v[0] - 0.01).abs() < 1e-12, "{} {}", q[0], v[0]);
        assert_eq!(t.at(2.03), (goal, Joints::zeros()));
    }

    #[test]
    fn a_move_to_where_the_arm_stands_takes_no_time() {
        let here = per_kind(0.01, -0.2);
        let t = Trajectory::plan(&here, &Joints::zeros(), &here, &Limits::default());
        assert_eq!((t.duration_s(), t.at(0.0)), (0.0, (here, Joints::zeros())));
    }

    #[test]
    fn from_rest_all_joints_stay_between_start_and_goal_and_arrive_together() {
        let limits = Limits::default();
        let mut rng = fastrand::Rng::with_seed(3);
        for _ in 0..500 {
            let (from, to) = (
                random(&mut rng, &limits.lower, &limits.upper),
                random(&mut rng, &limits.lower, &limits.upper),
            );
            let t = Trajectory::plan(&from, &Joints::zeros(), &to, &limits);
            for n in 0..=200 {
                let (q, _) = t.at(t.duration_s() * f64::from(n) / 200.0);
                for i in 0..COUNT {
                    let (low, high) = (from[i].min(to[i]) - 1e-12, from[i].max(to[i]) + 1e-12);
                    assert!((low..=high).contains(&q[i]), "joint {i} at {} left {low} … {high}", q[i]);
                }
            }
            let (late, _) = t.at(t.duration_s() * 0.999);
            for i in 0..COUNT {
                assert!(
                    (late[i] - to[i]).abs() > 0.0 || from[i] == to[i],
                    "joint {i} arrived before the others"
                );
            }
        }
    }

    #[test]
    fn speed_and_acceleration_stay_inside_the_limits_whatever_the_start() {
        let limits = Limits::default();
        let mut rng = fastrand::Rng::with_seed(5);
        let dt = 1e-3;
        for _ in 0..300 {
            let (from, to) = (
                random(&mut rng, &limits.lower, &limits.upper),
                random(&mut rng, &limits.lower, &limits.upper),
            );
            let v0 = random(&mut rng, &-limits.speed, &limits.speed);
            let t = Trajectory::plan(&from, &v0, &to, &limits);
            let (mut q, mut v) = t.at(0.0);
            assert!((q - from).norm() < 1e-12 && (v - v0).norm() < 1e-12, "starts where it was planned from");
            let mut n = 1.0;
            while n * dt < t.duration_s() + 2.0 * dt {
                let (next, next_v) = t.at(n * dt);
                for i in 0..COUNT {
                    assert!(next_v[i].abs() <= limits.speed[i] * (1.0 + 1e-9), "joint {i} too fast");
                    let a = (next_v[i] - v[i]).abs() / dt;
                    assert!(a <= limits.acceleration[i] * (1.0 + 1e-6), "joint {i} accelerates with {a}");
                    let jump = (next[i] - q[i] - 0.5 * (v[i] + next_v[i]) * dt).abs();
                    assert!(jump <= 0.5 * limits.acceleration[i] * dt * dt, "joint {i} jumps by {jump}");
                }
                (q, v, n) = (next, next_v, n + 1.0);
            }
            assert_eq!((q, v), (to, Joints::zeros()), "ends at the goal at rest");
        }
    }
}
