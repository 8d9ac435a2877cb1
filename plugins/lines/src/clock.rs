//! A device's own time as stamps of the host's clock.
//!
//! Invariant: stamps rise, and none lies behind the arrival of its line. The line that was on its way for the
//! shortest time, of the last half minute or so, decides the offset between the clocks: what others took
//! longer is jitter.

/// An offset counts for one to two of these, ns: clocks drift.
const WINDOW_NS: i128 = 15_000_000_000;
/// A line that came so much later than its time says is of a clock that was set, ns.
const SET_NS: i128 = 5_000_000_000;

/// Times beyond this are none, ns: some 146 years to either side.
const FARTHEST_NS: i128 = 1 << 62;

/// Whether a device's time may be one.
pub(crate) fn is_time(device_s: f64) -> bool {
    (device_s * 1e9).abs() <= FARTHEST_NS as f64
}

#[derive(Default)]
pub(crate) struct Clock {
    /// The least of arrival minus device's time, ns: of the window before, and of this one.
    least: [Option<i128>; 2],
    window_ns: i128,
    /// The device's time of the line before, ns, and its stamp.
    last: Option<(i128, u64)>,
    /// Times that the device's clock went back or was set.
    pub(crate) resets: u64,
}

impl Clock {
    /// The stamp of a line that came at `arrival_ns`, and that the device sent at `device_s` of its own
    /// clock.
    pub(crate) fn stamp(&mut self, device_s: f64, arrival_ns: u64) -> u64 {
        let device = ((device_s * 1e9) as i128).clamp(-FARTHEST_NS, FARTHEST_NS);
        let arrival = i128::from(arrival_ns);
        let offset = arrival - device;
        let went_back = self.last.is_some_and(|(before, _)| device < before);
        if went_back || self.offset().is_some_and(|least| offset - least > SET_NS) {
            self.least = [None; 2];
            self.resets += 1;
        }
        if self.least[1].is_none() || arrival - self.window_ns > WINDOW_NS {
            self.least = [self.least[1], None];
            self.window_ns = arrival;
        }
        self.least[1] = Some(self.least[1].map_or(offset, |least| least.min(offset)));
        let stamp = self.offset().map_or(arrival, |least| (device + least).min(arrival));
        let least = self.last.map_or(1, |(_, before)| i128::from(before) + 1);
        // Never 0, which says that there is no time.
        let stamp = u64::try_from(stamp.max(least)).unwrap_or(arrival_ns);
        self.last = Some((device, stamp));
        stamp
    }

    /// Another clock from here on, such as that of a program that was run again; stamps still rise.
    pub(crate) fn anew(&mut self) {
        self.least = [None; 2];
        self.last = self.last.map(|(_, stamp)| (i128::MIN, stamp));
    }

    fn offset(&self) -> Option<i128> {
        self.least.iter().flatten().min().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn jitter_of_the_way_is_taken_out_and_stamps_rise() {
        let mut clock = Clock::default();
        let begin = 1_000_000 * MS;
        let mut stamps = Vec::new();
        for (i, late_ms) in [3, 1, 5, 1, 9].into_iter().enumerate() {
            stamps.push(clock.stamp(0.010 * i as f64, begin + 10 * MS * i as u64 + late_ms * MS));
        }
        let gaps: Vec<u64> = stamps.windows(2).map(|w| (w[1] - w[0]).div_ceil(MS)).collect();
        assert_eq!(gaps, [8, 10, 10, 10], "from the second line on the shortest way is known");
        assert_eq!(clock.resets, 0);
    }

    #[test]
    fn a_device_that_begins_anew_or_sets_its_clock_is_followed_and_counted() {
        let mut clock = Clock::default();
        let first = clock.stamp(100.0, 50_000 * MS);
        let second = clock.stamp(0.0, 50_010 * MS);
        assert_eq!((first, second, clock.resets), (50_000 * MS, 50_010 * MS, 1));
        // Ahead: the line would be from the future, so the offset is that of its arrival.
        assert_eq!(clock.stamp(3600.0, 50_020 * MS), 50_020 * MS);
        for odd in [-1e300, f64::MAX, -1e300, 0.0, f64::NAN, f64::MAX, 0.0] {
            let stamp = clock.stamp(odd, 50_030 * MS);
            assert!(stamp > 50_020 * MS, "{odd}: {stamp}");
        }
    }

    #[test]
    fn another_clock_has_an_offset_of_its_own_and_no_earlier_stamps() {
        let mut clock = Clock::default();
        clock.stamp(0.0, 50_000 * MS);
        clock.anew();
        assert_eq!(clock.stamp(0.0, 51_000 * MS), 51_000 * MS);
        clock.anew();
        assert_eq!(clock.stamp(-1.0, 51_000 * MS), 51_000 * MS + 1);
        assert_eq!(clock.resets, 0);
    }

    #[test]
    fn a_clock_that_drifts_is_followed() {
        let mut clock = Clock::default();
        let mut stamp = 0;
        let mut arrival = 0;
        // 100 ppm slow, for ten minutes.
        for i in 0..60_000u64 {
            arrival = 1_000 * MS + i * 10 * MS;
            stamp = clock.stamp(i as f64 * 0.01 * 0.9999, arrival);
        }
        assert!(arrival - stamp < 4 * MS, "{} ns behind", arrival - stamp);
    }
}
