//! The line a scan goes along, and the way from it to the speed across the tool.
//!
//! Invariant: a line that exists lies across the tool, has a length and finite numbers; a request that cannot
//! be one is refused with the number that is wrong and what it may be.

use std::fmt;

use trocar_oct_core::tip::along;

use crate::payloads::ScanRequest;

/// Longest line, m.
pub const LONGEST_M: f64 = 0.02;
/// Shortest line, m.
pub const SHORTEST_M: f64 = 10e-6;
/// Highest speed along a line, m/s.
pub const FASTEST_M_S: f64 = 5e-3;
/// Largest distance from tip to surface, m: what an A-scan shows.
pub const FARTHEST_M: f64 = 1.2e-3;
/// The tip keeps at least this much further away than the forbidden region begins, m.
pub const MARGIN_M: f64 = 50e-6;

/// Acceleration along the line, m/s².
const ACCELERATION_M_S2: f64 = 0.02;
/// Speed per distance from the line, 1/s.
const ACROSS_PER_S: f64 = 10.0;
/// Highest speed of that, m/s: a tip that is far off comes back slowly.
const CORRECTION_M_S: f64 = 1e-3;
/// Highest speed on the way to the begin, m/s.
const COMING_M_S: f64 = 2e-3;
/// A tip so near to the place where the scan sets off is there, m.
const AT_START_M: f64 = 15e-6;
/// Distance of that place before the line's begin, m: a tip that counts as there has not passed the first
/// column.
const RUN_UP_M: f64 = AT_START_M;
/// A scan takes at most so many times its way over its speed, and so much more, s.
const SLOWEST: f64 = 1.5;
const LATEST_S: f64 = 2.0;

/// A line across the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    start_m: [f64; 3],
    direction: [f64; 3],
    axis: [f64; 3],
    pub length_m: f64,
    pub speed_m_s: f64,
    pub offset_m: f64,
    pub pitch_m: f64,
    pub columns: usize,
}

impl Line {
    /// The line of a request, for a tip at `tip_m` with the tool along `axis`.
    ///
    /// # Errors
    /// A number that is not finite or not within its limits.
    pub fn of(
        request: &ScanRequest,
        tip_m: [f64; 3],
        axis: [f64; 3],
        min_distance_m: f64,
        max_columns: usize,
    ) -> Result<Line, BadLine> {
        let ScanRequest { from, to, width, angle, speed, offset, pitch } = *request;
        within("width", width, 0.0, LONGEST_M)?;
        within("angle", angle, -10.0, 10.0)?;
        within("speed", speed, 1e-6, FASTEST_M_S)?;
        // To whole nanometres, so that a refusal reads well.
        let nearest_m = ((min_distance_m + MARGIN_M) * 1e9).round() / 1e9;
        within("offset", offset, nearest_m, FARTHEST_M)?;
        within("pitch", pitch, 0.1e-6, 1e-3)?;
        let (from, to) = if width > 0.0 {
            let half = [0.5 * width * angle.cos(), 0.5 * width * angle.sin(), 0.0];
            ([0, 1, 2].map(|i| tip_m[i] - half[i]), [0, 1, 2].map(|i| tip_m[i] + half[i]))
        } else {
            for (name, place) in [("from", from), ("to", to)] {
                for value in place {
                    within(name, value, -1.0, 1.0)?;
                }
            }
            (from, to)
        };
        let way = across(&[0, 1, 2].map(|i| to[i] - from[i]), &axis);
        let length_m = along(&way, &way).sqrt();
        within("the line's length", length_m, SHORTEST_M, LONGEST_M)?;
        let columns = (length_m / pitch).round().max(1.0) as usize;
        if columns > max_columns {
            return Err(BadLine::TooManyColumns { columns, max: max_columns });
        }
        let direction = way.map(|w| w / length_m);
        let pitch_m = length_m / columns as f64;
        Ok(Line {
            start_m: from,
            direction,
            axis,
            length_m,
            speed_m_s: speed,
            offset_m: offset,
            pitch_m,
            columns,
        })
    }

    /// Returns the way of a tip along the line, m.
    pub fn along_m(&self, tip_m: &[f64; 3]) -> f64 {
        along(&[0, 1, 2].map(|i| tip_m[i] - self.start_m[i]), &self.direction)
    }

    /// Returns the velocity across the tool that brings a tip to where the scan sets off, m/s, and whether it
    /// is near enough to do so.
    pub fn to_start(&self, tip_m: &[f64; 3]) -> ([f64; 3], bool) {
        let start_m = [0, 1, 2].map(|i| self.start_m[i] - RUN_UP_M * self.direction[i]);
        let left = across(&[0, 1, 2].map(|i| start_m[i] - tip_m[i]), &self.axis);
        let distance_m = along(&left, &left).sqrt();
        let speed = (ACROSS_PER_S * distance_m).min(COMING_M_S);
        let velocity = left.map(|l| if distance_m > 0.0 { l / distance_m * speed } else { 0.0 });
        (velocity, distance_m < AT_START_M)
    }

    /// Speed along the line, `since_s` after the tip set off, m/s.
    pub fn pace_m_s(&self, since_s: f64) -> f64 {
        self.speed_m_s.min(ACCELERATION_M_S2 * since_s)
    }

    /// Returns the longest time in which a tip that set off comes to the end, s.
    pub fn latest_s(&self) -> f64 {
        SLOWEST * (AT_START_M + RUN_UP_M + self.length_m) / self.speed_m_s + LATEST_S
    }

    /// Velocity across the tool that keeps a tip on the line that goes along it at `speed_m_s`, m/s.
    pub fn follow(&self, tip_m: &[f64; 3], speed_m_s: f64) -> [f64; 3] {
        let beside = self.beside(tip_m);
        let off_m = along(&beside, &beside).sqrt();
        let back_per_s = if off_m > 0.0 { ACROSS_PER_S.min(CORRECTION_M_S / off_m) } else { 0.0 };
        [0, 1, 2].map(|i| self.direction[i] * speed_m_s - back_per_s * beside[i])
    }

    /// Returns the distance of a tip from its planned place on the line, `planned_m` after its begin, m.
    pub fn lag_m(&self, tip_m: &[f64; 3], planned_m: f64) -> f64 {
        let beside = self.beside(tip_m);
        along(&beside, &beside).sqrt().hypot(planned_m - self.along_m(tip_m))
    }

    /// From the line's nearest place to a tip, m.
    fn beside(&self, tip_m: &[f64; 3]) -> [f64; 3] {
        let from_start = across(&[0, 1, 2].map(|i| tip_m[i] - self.start_m[i]), &self.axis);
        let gone = along(&from_start, &self.direction);
        [0, 1, 2].map(|i| from_start[i] - gone * self.direction[i])
    }
}

/// The part of `v` that is not along `axis`.
fn across(v: &[f64; 3], axis: &[f64; 3]) -> [f64; 3] {
    let part = along(v, axis);
    [0, 1, 2].map(|i| v[i] - part * axis[i])
}

fn within(name: &'static str, value: f64, min: f64, max: f64) -> Result<(), BadLine> {
    if value >= min && value <= max { Ok(()) } else { Err(BadLine::Limit { name, value, min, max }) }
}

/// Why there is no line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BadLine {
    /// Not within its limits, in SI units.
    Limit { name: &'static str, value: f64, min: f64, max: f64 },
    /// The image would be too wide.
    TooManyColumns { columns: usize, max: usize },
}

impl fmt::Display for BadLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            BadLine::Limit { name, value, min, max } => {
                write!(f, "{name}: {value} is not from {min} to {max} (SI units)")
            }
            BadLine::TooManyColumns { columns, max } => write!(
                f,
                "pitch: the line would have {columns} columns, and max_columns is {max}: give a longer pitch or a shorter line"
            ),
        }
    }
}

impl std::error::Error for BadLine {}

#[cfg(test)]
mod tests {
    use super::*;

    const DOWN: [f64; 3] = [0.0, 0.0, 1.0];

    fn request() -> ScanRequest {
        ScanRequest { width: 3e-3, speed: 0.5e-3, offset: 500e-6, pitch: 6e-6, ..ScanRequest::default() }
    }

    #[test]
    fn a_width_lies_across_the_tool_half_to_each_side() {
        let line = Line::of(&request(), [1e-3, 2e-3, 0.05], DOWN, 150e-6, 4096).expect("a line");
        assert_eq!(line.columns, 500);
        assert!((line.length_m - 3e-3).abs() < 1e-12);
        assert!((line.along_m(&[1e-3, 2e-3, 0.1]) - 1.5e-3).abs() < 1e-12);
        let (velocity, at_start) = line.to_start(&[1e-3, 2e-3, 0.05]);
        assert!(!at_start && (velocity[0] + 2e-3).abs() < 1e-12 && velocity[2] == 0.0);
        let follow = line.follow(&[0.0, 2.1e-3, 0.0], 0.5e-3);
        assert!((follow[0] - 0.5e-3).abs() < 1e-12 && (follow[1] + 1e-3).abs() < 1e-9, "{follow:?}");
    }

    #[test]
    fn a_tip_beside_the_line_is_brought_back_at_a_millimetre_per_second_at_most() {
        let line = Line::of(&request(), [0.0; 3], DOWN, 150e-6, 4096).expect("a line");
        for off_m in [1e-6, 1e-4, 1e-3, 0.5, 1e6] {
            let [x, y, z] = line.follow(&[0.0, off_m, 0.0], 0.5e-3);
            assert!((x - 0.5e-3).abs() < 1e-12 && z == 0.0);
            let wanted = (10.0 * off_m).min(1e-3);
            assert!((y + wanted).abs() < 1e-12, "{y} m/s at {off_m} m");
        }
        assert_eq!(line.follow(&[0.0; 3], 0.5e-3)[1], 0.0);
    }

    #[test]
    fn a_scan_sets_off_before_its_first_column_and_no_further_before_it_than_the_run_up_and_as_much_again() {
        let line = Line::of(&request(), [0.0; 3], DOWN, 150e-6, 4096).expect("a line");
        let at = |gone_m: f64| [-1.5e-3 + gone_m, 0.0, 0.05];
        for gone_m in [0.1e-6, 1e-3, -30.1e-6] {
            assert!(!line.to_start(&at(gone_m)).1, "{gone_m} m along the line");
        }
        for gone_m in [-0.1e-6, -15e-6, -29.9e-6] {
            assert!(line.to_start(&at(gone_m)).1, "{gone_m} m along the line");
        }
        assert!(!line.to_start(&[-1.515e-3, 15.1e-6, 0.0]).1, "beside it");
        // The shortest and slowest line there is has the time for that, too.
        let line = Line { length_m: SHORTEST_M, speed_m_s: 1e-6, ..line };
        assert!(line.latest_s() > (30e-6 + SHORTEST_M) / 1e-6);
    }

    #[test]
    fn the_lag_counts_along_the_line_and_beside_it() {
        let line = Line::of(&request(), [0.0; 3], DOWN, 150e-6, 4096).expect("a line");
        let at = [-1.5e-3 + 0.3e-3, 0.4e-3, 0.7];
        assert!((line.lag_m(&at, 0.6e-3) - 0.5e-3).abs() < 1e-12, "{}", line.lag_m(&at, 0.6e-3));
    }

    #[test]
    fn what_is_no_line_is_refused_with_its_limits() {
        let refused = |r: ScanRequest| {
            Line::of(&r, [0.0; 3], DOWN, 150e-6, 1000).err().map(|e| e.to_string()).unwrap_or_default()
        };
        assert!(
            refused(ScanRequest { speed: 0.01, ..request() })
                .starts_with("speed: 0.01 is not from 0.000001 to 0.005")
        );
        assert!(refused(ScanRequest { speed: f64::NAN, ..request() }).starts_with("speed: NaN"));
        assert!(
            refused(ScanRequest { offset: 180e-6, ..request() })
                .starts_with("offset: 0.00018 is not from 0.0002 ")
        );
        assert!(refused(ScanRequest { width: 0.0, ..request() }).starts_with("the line's length: 0 is not"));
        assert!(
            refused(ScanRequest { width: 0.0, to: [0.0, 0.0, 1e-3], ..request() })
                .starts_with("the line's length: 0")
        );
        assert!(
            refused(ScanRequest { width: 0.0, to: [f64::INFINITY, 0.0, 0.0], ..request() })
                .starts_with("to: inf")
        );
        assert!(
            refused(ScanRequest { pitch: 1e-6, ..request() })
                .starts_with("pitch: the line would have 3000 columns")
        );
    }
}
