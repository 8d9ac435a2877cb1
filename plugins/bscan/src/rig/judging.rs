//! Criteria of a run: the true tip, the true surface, and what the robot keeps.
//!
//! Invariant: none of these values reaches the judged component.

use nalgebra::{Point3, Vector3};
use trocar_sdk::data::{Retreat, VirtualFixture};

use super::{Rig, STEP_NS, Truth};

impl Rig {
    /// Returns root mean square and largest deviation from the offset during the scan, and the smallest
    /// distance ever, m.
    pub(crate) fn errors(&self) -> (f64, f64, f64) {
        let errors: Vec<f64> =
            self.truth.iter().filter(|t| t.scanning).map(|t| t.distance_m - self.setup.offset_m).collect();
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let largest = errors.iter().fold(0.0, |a: f64, e| a.max(e.abs()));
        let nearest = self.truth.iter().map(|t| t.nearest_m).fold(f64::INFINITY, f64::min);
        (rms, largest, nearest)
    }

    /// The same root mean square for a tip that goes along the line at the height where it set off.
    pub(crate) fn without_control(&self) -> f64 {
        let scan: Vec<&Truth> = self.truth.iter().filter(|t| t.scanning).collect();
        let z = scan[0].tip_z_m;
        let surface = |t: &Truth| self.setup.world.surface_z(t.x_m, 0.0, t.ns as f64 * 1e-9);
        let squares = scan.iter().map(|t| (surface(t) - z - self.setup.offset_m).powi(2)).sum::<f64>();
        (squares / scan.len() as f64).sqrt()
    }

    /// In the next tenth of a second the true tip moves by less than a step of the encoders.
    pub(crate) fn stands(&mut self) -> bool {
        let from = self.true_tip().pose.position;
        self.steps(100);
        let to = self.true_tip().pose.position;
        (0..3).all(|i| (to[i] - from[i]).abs() < 0.5e-6)
    }

    /// Lets the robot go on alone for so many periods, without any command: returns the distance of its true
    /// tip from the first surface, m, after each of them, along the tool or straight down, whichever is less.
    pub(crate) fn watch(&mut self, periods: usize) -> Vec<f64> {
        let step = |_| {
            self.robot.step(1);
            let pose = self.true_tip().pose.isometry().expect("a pose");
            let t_s = self.robot.now().ns() as f64 * 1e-9;
            let tip = Point3::from(pose.translation.vector);
            let below = self.setup.world.below(&tip, &(pose.rotation * Vector3::z_axis()), t_s);
            below.expect("over the retina").distance_m.min(self.straight_down(&tip, t_s))
        };
        let distances = (0..periods).map(step).collect();
        self.bench.advance(periods as u64 * STEP_NS);
        distances
    }

    /// Velocity of the true tip, m/s.
    pub(crate) fn true_speed_m_s(&self) -> f64 {
        Vector3::from(self.true_tip().twist.linear).norm()
    }

    /// The guard that the robot keeps.
    pub(crate) fn guard(&self) -> VirtualFixture {
        self.robot.read("virtual_fixture/guard", ()).expect("a read")
    }

    /// Returns the way back that the robot takes without further commands.
    pub(crate) fn retreat(&self) -> Retreat {
        self.robot.read("axis/retreat", ()).expect("a read")
    }

    /// Scans that ended well.
    pub(crate) fn bench_done(mut self) -> usize {
        self.bench.events::<crate::ScanDone>("scan/bscan_done").len()
    }
}
