//! The memory of a number over time, and the points of it that a picture needs.
//!
//! Invariant: room is made once, the oldest gives way; thinned points keep every peak that a pixel column
//! holds.

/// A number at a time; one that is not finite is a gap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    pub(crate) at_ns: u64,
    pub(crate) value: f64,
}

/// The last points of one number.
#[derive(Debug, Default)]
pub(crate) struct Trace {
    ring: Vec<Point>,
    /// Points that ever came.
    came: usize,
}

impl Trace {
    /// Room for `keep` points.
    pub(crate) fn new(keep: usize) -> Trace {
        Trace { ring: vec![Point { at_ns: 0, value: 0.0 }; keep.max(1)], came: 0 }
    }

    /// Adds a point; one that is not later than the last is left out. Tells whether it was taken.
    pub(crate) fn push(&mut self, point: Point) -> bool {
        if self.newest().is_some_and(|last| last.at_ns >= point.at_ns) {
            return false;
        }
        let at = self.came % self.ring.len();
        self.ring[at] = point;
        self.came += 1;
        true
    }

    pub(crate) fn clear(&mut self) {
        self.came = 0;
    }

    /// Whether it has room for just so many points.
    pub(crate) fn keeps(&self, keep: usize) -> bool {
        self.ring.len() == keep
    }

    pub(crate) fn newest(&self) -> Option<Point> {
        self.came.checked_sub(1).map(|last| self.ring[last % self.ring.len()])
    }

    /// Oldest first.
    pub(crate) fn iter(&self) -> impl Iterator<Item = Point> {
        let first = self.came.saturating_sub(self.ring.len());
        (first..self.came).map(|n| self.ring[n % self.ring.len()])
    }
}

/// Keeps the first, the lowest, the highest and the last point of each of `columns` equal spans of time, in
/// their order; all points where they are few. Gaps stay.
pub(crate) fn thinned(points: &[(f64, f64)], columns: usize) -> Vec<(f64, f64)> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    let span = last.0 - first.0;
    if points.len() <= 4 * columns || span <= 0.0 {
        return points.to_vec();
    }
    let column = |point: &(f64, f64)| ((point.0 - first.0) / span * columns as f64) as usize;
    let mut kept = Vec::with_capacity(4 * columns + 4);
    for group in points.chunk_by(|a, b| column(a) == column(b) && a.1.is_finite() == b.1.is_finite()) {
        let by = |a: &usize, b: &usize| group[*a].1.total_cmp(&group[*b].1);
        let lowest = (0..group.len()).min_by(by).unwrap_or(0);
        let highest = (0..group.len()).max_by(by).unwrap_or(0);
        let mut picks = [0, lowest.min(highest), lowest.max(highest), group.len() - 1].to_vec();
        picks.dedup();
        kept.extend(picks.into_iter().map(|n| group[n]));
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_gives_way_and_time_never_goes_back() {
        let mut trace = Trace::new(3);
        for n in 1..=5u64 {
            assert!(trace.push(Point { at_ns: n, value: n as f64 }));
        }
        assert!(!trace.push(Point { at_ns: 5, value: 9.0 }));
        assert_eq!(trace.iter().map(|p| p.at_ns).collect::<Vec<_>>(), [3, 4, 5]);
        assert_eq!(trace.newest().map(|p| p.value), Some(5.0));
        trace.clear();
        assert_eq!((trace.iter().count(), trace.newest()), (0, None));
        assert!(trace.push(Point { at_ns: 2, value: 1.0 }));
    }

    #[test]
    fn thinned_points_keep_peaks_ends_and_gaps() {
        let mut points: Vec<(f64, f64)> =
            (0..100_000).map(|n| (f64::from(n), (f64::from(n) * 0.01).sin())).collect();
        points[31_234].1 = 50.0;
        points[31_236].1 = -70.0;
        points[77_777].1 = f64::NAN;
        let kept = thinned(&points, 500);
        assert!(kept.len() <= 4 * 503, "{}", kept.len());
        assert!(kept.windows(2).all(|w| w[0].0 < w[1].0), "in their order, none twice");
        assert_eq!((kept[0], kept[kept.len() - 1]), (points[0], points[99_999]));
        assert!(kept.contains(&points[31_234]) && kept.contains(&points[31_236]));
        assert!(kept.iter().any(|p| p.1.is_nan()));
        assert_eq!(thinned(&points[..100], 500), points[..100]);
        assert_eq!(thinned(&[], 500), []);
    }
}
