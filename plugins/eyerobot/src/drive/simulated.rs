//! Simulated motors and encoders of five joints.
//!
//! Invariant: a function of the seed and the calls only: no clock. `truth` is what the joints do, `cycle`
//! returns what the encoders see of it.

use super::{Drive, Lost, Measured};
use crate::joints::{Joints, per_kind};

/// Behaviour of the simulated motors. Defaults are design values, not those of a real device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Simulation {
    /// Time constant of the velocity loop, s.
    pub lag_s: f64,
    /// Highest acceleration, m/s² or rad/s².
    pub acceleration: Joints,
    /// Step of the encoders, m or rad.
    pub quantum: Joints,
    /// Commanded speeds below this do not overcome friction, m/s or rad/s.
    pub stick_speed: Joints,
    /// Play between motor and joint, from one side to the other, m or rad. Encoders sit at the motors and do
    /// not see it.
    pub backlash: Joints,
    /// A joint that stands whatever is commanded; its place in `joints::NAMES`.
    pub blocked: Option<usize>,
    /// Decides where the encoders' steps lie.
    pub seed: u64,
}

impl Default for Simulation {
    /// 8 ms lag (20 Hz), 0.5 m/s² and 6 rad/s², encoders of 0.5 µm and 9 µrad, friction below 2 µm/s and 36
    /// µrad/s, no backlash.
    fn default() -> Self {
        Simulation {
            lag_s: 0.008,
            acceleration: per_kind(0.5, 6.0),
            quantum: per_kind(0.5e-6, 9e-6),
            stick_speed: per_kind(2e-6, 36e-6),
            backlash: Joints::zeros(),
            blocked: None,
            seed: 1,
        }
    }
}

/// Five simulated motors: velocity loop `v̇ = (v_cmd − v)/τ` with limited acceleration, one period of
/// transport delay, friction at standstill, play behind the motor, and encoders of finite step. The brake is
/// no part of the loop: it knows no lag, but the same highest acceleration.
#[derive(Clone, Debug)]
pub struct SimulatedDrive {
    setup: Simulation,
    /// Position of the motors.
    position: Joints,
    velocity: Joints,
    /// Position and velocity of the joints, behind the play.
    truth: Measured,
    on_the_way: Joints,
    phase: Joints,
    braking: bool,
}

impl SimulatedDrive {
    /// Motors at rest at `position` (m, rad).
    pub fn new(setup: Simulation, position: Joints) -> Self {
        let mut rng = fastrand::Rng::with_seed(setup.seed);
        let phase = setup.quantum.map(|quantum| quantum * rng.f64());
        let (velocity, on_the_way) = (Joints::zeros(), Joints::zeros());
        SimulatedDrive {
            setup,
            position,
            velocity,
            truth: Measured { position, velocity },
            on_the_way,
            phase,
            braking: false,
        }
    }

    /// Time goes by without cycles: what brakes comes to its end.
    pub fn settle(&mut self) {
        // Half a minute brakes any speed of a drive.
        for _ in 0..30_000 {
            if !self.braking {
                return;
            }
            self.brake(1e-3);
        }
    }

    fn brake(&mut self, dt_s: f64) {
        for i in 0..self.velocity.len() {
            let most = self.setup.acceleration[i] * dt_s;
            let before = self.velocity[i];
            self.go(i, before - before.clamp(-most, most), dt_s);
        }
        self.braking = self.velocity.iter().any(|v| *v != 0.0);
    }

    /// Motor `i` goes on for a period, at whose end it has velocity `after`.
    fn go(&mut self, i: usize, after: f64, dt_s: f64) {
        let after = if self.setup.blocked == Some(i) { 0.0 } else { after };
        self.position[i] += 0.5 * (self.velocity[i] + after) * dt_s;
        self.velocity[i] = after;
        // A motor that turns back first goes through the play; the joint stands meanwhile.
        let play = 0.5 * self.setup.backlash[i];
        let joint = self.truth.position[i].max(self.position[i] - play).min(self.position[i] + play);
        let carried = play == 0.0 || joint != self.truth.position[i];
        self.truth.position[i] = joint;
        self.truth.velocity[i] = if carried { after } else { 0.0 };
    }

    /// Returns the true positions and velocities of the joints, m, rad and per second: no encoder shows them.
    pub fn truth(&self) -> Measured {
        self.truth
    }

    /// Returns the encoders' readings at the end of the last cycle, m, rad and per second.
    pub fn measured(&self) -> Measured {
        let position = Joints::from_fn(|i, _| {
            let (q, phase, step) = (self.position[i], self.phase[i], self.setup.quantum[i]);
            if step > 0.0 { ((q + phase) / step).round() * step - phase } else { q }
        });
        Measured { position, velocity: self.velocity }
    }
}

impl Drive for SimulatedDrive {
    fn cycle(&mut self, velocity: &Joints, dt_s: f64) -> Result<Measured, Lost> {
        if self.braking {
            self.brake(dt_s);
            return Ok(self.measured());
        }
        let command = std::mem::replace(&mut self.on_the_way, *velocity);
        // Exact solution of the loop over one period, so that long periods stay stable.
        let share = 1.0 - (-dt_s / self.setup.lag_s).exp();
        for i in 0..command.len() {
            let stick = self.setup.stick_speed[i];
            let wanted = if command[i].abs() < stick { 0.0 } else { command[i] };
            let most = self.setup.acceleration[i] * dt_s;
            let before = self.velocity[i];
            let mut after = before + ((wanted - before) * share).clamp(-most, most);
            if wanted == 0.0 && after.abs() < stick {
                after = 0.0;
            }
            self.go(i, after, dt_s);
        }
        Ok(self.measured())
    }

    fn make_safe(&mut self) {
        self.on_the_way = Joints::zeros();
        self.braking = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1e-3;

    fn exact() -> Simulation {
        Simulation { acceleration: per_kind(1e9, 1e9), quantum: Joints::zeros(), ..Simulation::default() }
    }

    fn run(drive: &mut SimulatedDrive, velocity: &Joints, cycles: usize) -> Measured {
        let mut last = drive.measured();
        for _ in 0..cycles {
            last = drive.cycle(velocity, DT).expect("the simulation loses no joint");
        }
        last
    }

    #[test]
    fn a_velocity_step_follows_the_first_order_lag_after_one_period_of_delay() {
        let mut drive = SimulatedDrive::new(exact(), Joints::zeros());
        let v = per_kind(0.01, 0.1);
        assert_eq!(
            run(&mut drive, &v, 1).velocity,
            Joints::zeros(),
            "the first period only carries the command"
        );
        let after_lag = run(&mut drive, &v, 8).velocity;
        for i in 0..5 {
            assert!(
                (after_lag[i] / v[i] - (1.0 - (-1f64).exp())).abs() < 1e-12,
                "joint {i}: {}",
                after_lag[i]
            );
        }
    }

    #[test]
    fn the_acceleration_never_exceeds_its_limit() {
        let mut drive = SimulatedDrive::new(Simulation::default(), Joints::zeros());
        let (mut before, limit) = (Joints::zeros(), Simulation::default().acceleration);
        for n in 0..100 {
            let v = if n < 50 { per_kind(0.01, 0.12) } else { per_kind(-0.01, -0.12) };
            let now = run(&mut drive, &v, 1).velocity;
            for i in 0..5 {
                let a = (now[i] - before[i]).abs() / DT;
                assert!(a <= limit[i] * (1.0 + 1e-9), "joint {i} cycle {n}: {a}");
            }
            before = now;
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_motion_and_another_seed_other_encoder_steps() {
        let [a, b, c] = [1, 1, 2].map(|seed| {
            let mut drive =
                SimulatedDrive::new(Simulation { seed, ..Simulation::default() }, Joints::zeros());
            run(&mut drive, &per_kind(0.003, 0.02), 137)
        });
        assert_eq!(a, b);
        assert_ne!(a.position, c.position);
        assert_eq!(a.velocity, c.velocity);
    }

    #[test]
    fn encoders_err_by_at_most_half_a_step() {
        let mut drive = SimulatedDrive::new(Simulation::default(), Joints::zeros());
        for n in 0..1000 {
            let measured = run(&mut drive, &per_kind(0.0011, 0.013), 1).position;
            for i in 0..5 {
                let off = (measured[i] - drive.position[i]).abs();
                assert!(off <= drive.setup.quantum[i] * 0.500_001, "joint {i} cycle {n}: {off:e}");
            }
        }
    }

    #[test]
    fn commands_below_the_friction_do_not_move_a_standing_joint() {
        let mut drive = SimulatedDrive::new(exact(), Joints::zeros());
        let crept = run(&mut drive, &per_kind(1.9e-6, 35e-6), 1000);
        assert_eq!(crept, Measured { position: Joints::zeros(), velocity: Joints::zeros() });
    }

    #[test]
    fn with_backlash_a_joint_stands_while_the_motor_turns_back_through_the_play() {
        let play = 3e-6;
        let backlash = per_kind(play, 0.0);
        let mut drive = SimulatedDrive::new(Simulation { backlash, ..exact() }, Joints::zeros());
        run(&mut drive, &per_kind(1e-3, 0.0), 100);
        let forth = drive.position[0] - drive.truth().position[0];
        run(&mut drive, &per_kind(-1e-3, 0.0), 100);
        let back = drive.position[0] - drive.truth().position[0];
        assert!((forth - 0.5 * play).abs() < 1e-15 && (back + 0.5 * play).abs() < 1e-15, "{forth} {back}");
        assert_eq!(
            drive.truth().position[3],
            drive.position[3],
            "a joint without play is where its motor is"
        );
    }

    #[test]
    fn made_safe_it_brakes_with_its_highest_acceleration_whatever_is_commanded_and_then_takes_commands() {
        let v = per_kind(0.01, 0.1);
        let mut drive = SimulatedDrive::new(Simulation::default(), Joints::zeros());
        let mut before = run(&mut drive, &v, 100).velocity;
        let from = drive.position;
        drive.make_safe();
        let mut cycles = 0;
        while before != Joints::zeros() {
            let now = run(&mut drive, &v, 1).velocity;
            cycles += 1;
            for i in 0..5 {
                let most = Simulation::default().acceleration[i] * DT * (1.0 + 1e-9);
                assert!((now[i] - before[i]).abs() <= most && now[i].abs() <= before[i].abs(), "joint {i}");
            }
            before = now;
        }
        assert_eq!(cycles, 20, "10 mm/s at 0.5 m/s²");
        assert!((drive.position[0] - from[0] - 0.1e-3).abs() < 1e-8, "v²/2a, {}", drive.position[0]);
        assert!(run(&mut drive, &v, 30).velocity[0] > 0.008);
    }

    #[test]
    fn without_cycles_a_braking_drive_settles_where_it_would_have_come_to_rest() {
        let mut drive = SimulatedDrive::new(Simulation::default(), Joints::zeros());
        run(&mut drive, &per_kind(0.01, 0.1), 100);
        drive.make_safe();
        let mut cycled = drive.clone();
        run(&mut cycled, &Joints::zeros(), 50);
        drive.settle();
        assert_eq!((drive.truth(), drive.measured()), (cycled.truth(), cycled.measured()));
        assert_eq!(drive.truth().velocity, Joints::zeros());
    }
}
