//! The component `cooperative`: lets a hand lead a robot, behind a plane that keeps the tip off the retina.
//!
//! Invariant: the robot follows only while this steps, and only while the robot says that a guard is in
//! force. Nothing waits, and commands that reach no robot are counted.

mod guard;

use trocar_sdk::data::{Distance, FixtureKind, Pose, VirtualFixture, Wrench};
use trocar_sdk::prelude::*;

use guard::{Bounds, Guard};

/// A robot that does not tell where it is for this long is not led, s.
const ROBOT_LOST_S: f64 = 0.02;

/// Nothing is measured further away, m: neither a tip from its base nor a surface from a tip.
const FURTHEST_M: f64 = 1000.0;

#[derive(Config)]
struct CooperativeConfig {
    /// The tip is not led nearer than this to the surface that the input distance tells. An eye swings: a tip
    /// that stands here comes nearer by all of its swing, 320 um in the simulated world
    #[config(live, min = 0.00015, max = 0.01, unit = "m", default = 0.0005)]
    min_distance_m: f64,
    /// While no surface was seen, or nothing is connected to the input distance, the tip is not led deeper
    /// than this z of the robot's base frame; the default is the tip's place at home
    #[config(live, min = -1.0, max = 1.0, unit = "m", default = 0.12)]
    lowest_z_m: f64,
}

/// Cooperative control: asks the robot in each cycle to follow the hand on its handle. The robot stands when
/// it is not asked, and it is asked only behind a guard: a plane that follows the retina, or a fixed one
/// while no retina was seen.
#[derive(Component)]
#[component(rate_hz = 500, models("periodic", "exec_in", "exec_out"), rates_hz(100, 8000))]
pub struct Cooperative {
    /// From the tip to the retina; its tracker should know the robot
    #[input(optional)]
    distance: In<Distance>,
    /// Follows the hand until the next one is due.
    #[required(interface = "compliance", name = "servo_cf")]
    servo_cf: Function<Wrench>,
    /// Called when this component stops.
    #[required(interface = "robot", name = "hold")]
    hold: Function,
    /// Pose of the tip.
    #[required(interface = "robot")]
    measured_cp: Function<(), Pose>,
    /// Wrench of the hand on the handle.
    #[required(interface = "hand", optional)]
    measured_cf: Function<(), Wrench>,
    /// Keeps the tip behind a plane: the robot's own fixture.
    #[required(interface = "fixture")]
    set_guard: Function<VirtualFixture>,
    /// The one in force.
    #[required(interface = "fixture", name = "guard")]
    guard_in_force: Function<(), VirtualFixture>,
    /// Cycles since Start in which the robot was asked.
    #[state]
    sent: u64,
    /// Cycles since Start in which no robot could be asked.
    #[state]
    rejected: u64,
    /// Cycles since Start in which it was not asked, since nothing guards the tip.
    #[state]
    unguarded: u64,
    /// The surface is seen.
    #[state]
    surface: Flag,
    /// From the tip to the guard, negative beyond it; 0 without one.
    #[state]
    #[unit("m")]
    room: f64,
    /// Force of the hand on the handle, at the last reading.
    #[state]
    #[unit("N")]
    force: f64,
    #[config]
    cfg: CooperativeConfig,
    guard: Guard,
}

impl Cooperative {
    /// Sends the guard of this moment. Is one in force?
    fn guard(&mut self, now: Stamp) -> bool {
        (self.surface, self.room) = (Flag::FALSE, 0.0);
        let Ok(pose) = self.measured_cp.call(()) else { return false };
        let is_somewhere = pose.position.iter().all(|p| p.abs() <= FURTHEST_M);
        if !pose.is_valid() || !is_somewhere || now.seconds_since(pose.stamp).abs() > ROBOT_LOST_S {
            return false;
        }
        self.guard.tip_at(&pose);
        if let Some(told) = self.distance.fresh() {
            self.guard.distance(&told);
        }
        self.surface = self.guard.is_seen(now).into();
        let bounds = Bounds { min_distance_m: self.cfg.min_distance_m, lowest_z_m: self.cfg.lowest_z_m };
        let Some((plane, room_m)) = self.guard.plane(now, &bounds) else { return false };
        self.room = room_m;
        let sent = self.set_guard.send(plane).is_ok();
        // A robot that has just come back knows of none yet.
        sent && self.guard_in_force.call(()).is_ok_and(|guard| guard.kind == FixtureKind::PLANE)
    }
}

impl Component for Cooperative {
    fn start(&mut self) -> Result {
        (self.sent, self.rejected, self.unguarded, self.force) = (0, 0, 0, 0.0);
        self.guard = Guard::default();
        Ok(())
    }

    fn stop(&mut self) -> Result {
        self.hold.send(());
        // A guard that is not moved any more would stand in the way of the next motion.
        self.set_guard.send(VirtualFixture::default());
        Ok(())
    }

    fn step(&mut self, tick: &Tick) -> Result {
        if !self.guard(tick.now()) {
            self.unguarded += 1;
        // A wrench of zeros adds nothing to the hand's.
        } else if self.servo_cf.send(Wrench { stamp: tick.now(), ..Wrench::default() }).is_ok() {
            self.sent += 1;
        } else {
            self.rejected += 1;
        }
        if let Ok(felt) = self.measured_cf.call(()) {
            let [x, y, z] = felt.force;
            // Unlike a root of squares, finite for any force.
            self.force = if felt.is_valid() { x.hypot(y).hypot(z).min(f64::MAX) } else { 0.0 };
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "cooperative_tests.rs"]
mod tests;
