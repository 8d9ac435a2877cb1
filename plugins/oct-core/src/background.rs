//! What the reference arm alone gives: subtracted from each line, so that only interference is left.
//!
//! Invariant: no fringe of a surface gets into it. What is followed while it runs is smoothed over a sixteenth of the line
//! three times, which takes every fringe of more than 40 periods down below 1/300; while a nearer surface is there, nothing is
//! followed.

/// Each so many lines the drift is looked at.
const EVERY: u32 = 64;
/// Part that one look has.
const SHARE: f32 = 1.0 / 64.0;

/// Mean spectrum of the reference arm.
#[derive(Clone, Debug, Default)]
pub struct Background {
    /// What is subtracted, counts.
    now: Vec<f32>,
    /// The mean as captured, or the first line smoothed.
    captured: Vec<f32>,
    /// `captured`, smoothed.
    smooth_then: Vec<f32>,
    /// Lines since then, smoothed.
    smooth_now: Vec<f32>,
    /// Lines summed up by a capture.
    sum: Vec<f64>,
    wanted: u32,
    taken: u32,
    known: bool,
    frozen: bool,
    lines: u32,
    work: [Vec<f32>; 2],
}

impl Background {
    /// Unknown, for lines of `samples`.
    pub fn new(samples: usize) -> Background {
        let zeros = || vec![0.0; samples];
        Background {
            now: zeros(),
            captured: zeros(),
            smooth_then: zeros(),
            smooth_now: zeros(),
            sum: vec![0.0; samples],
            work: [zeros(), zeros()],
            ..Background::default()
        }
    }

    /// What is to be subtracted from the next line, counts.
    pub fn counts(&self) -> &[f32] {
        &self.now
    }

    /// Takes the mean of the next `lines` lines, which have to show the reference arm alone.
    pub fn capture(&mut self, lines: u32) {
        self.sum.fill(0.0);
        (self.wanted, self.taken) = (lines, 0);
    }

    /// Lines that a running capture still waits for.
    pub fn missing(&self) -> u32 {
        self.wanted - self.taken
    }

    /// The next line will be looked at for drift.
    pub fn is_due(&self) -> bool {
        self.lines.is_multiple_of(EVERY)
    }

    /// Follows no drift, or follows it again.
    pub fn freeze(&mut self, frozen: bool) {
        self.frozen = frozen;
    }

    /// Looks at one line of good light. True when a capture has ended with it.
    pub fn see(&mut self, line: &[f32]) -> bool {
        if line.len() != self.now.len() {
            return false;
        }
        let mut done = false;
        if self.wanted > self.taken {
            self.sum.iter_mut().zip(line).for_each(|(sum, x)| *sum += f64::from(*x));
            self.taken += 1;
            done = self.taken == self.wanted;
            if done {
                let n = f64::from(self.wanted);
                self.captured.iter_mut().zip(&self.sum).for_each(|(mean, sum)| *mean = (sum / n) as f32);
                (self.wanted, self.taken) = (0, 0);
                self.begin(false);
            }
        }
        if !self.known {
            self.captured.copy_from_slice(line);
            self.begin(true);
        } else if self.is_due() && !self.frozen && !done {
            smooth(line, &mut self.work);
            for (i, new) in self.work[0].iter().enumerate() {
                self.smooth_now[i] += SHARE * (new - self.smooth_now[i]);
                self.now[i] = self.captured[i] + (self.smooth_now[i] - self.smooth_then[i]);
            }
        }
        self.lines = self.lines.wrapping_add(1);
        done
    }

    /// From now on it is what was captured; of a line with a surface in it only what is smooth.
    fn begin(&mut self, smoothed: bool) {
        smooth(&self.captured, &mut self.work);
        if smoothed {
            self.captured.copy_from_slice(&self.work[0]);
        }
        self.smooth_then.copy_from_slice(&self.work[0]);
        self.smooth_now.copy_from_slice(&self.work[0]);
        self.now.copy_from_slice(&self.captured);
        (self.known, self.lines) = (true, 1);
    }
}

/// Three means over a sixteenth of the line, into `work[0]`.
fn smooth(line: &[f32], work: &mut [Vec<f32>; 2]) {
    let reach = line.len() / 32;
    let [a, b] = work;
    mean_over(line, reach, a);
    mean_over(a, reach, b);
    mean_over(b, reach, a);
}

/// Mean over `reach` to both sides, fewer at the ends.
fn mean_over(from: &[f32], reach: usize, to: &mut [f32]) {
    let n = from.len();
    let mut sum: f64 = from.iter().take(reach).map(|x| f64::from(*x)).sum();
    for (i, to) in to.iter_mut().enumerate().take(n) {
        if i + reach < n {
            sum += f64::from(from[i + reach]);
        }
        if i > reach {
            sum -= f64::from(from[i - reach - 1]);
        }
        let count = (i + reach).min(n - 1) - i.saturating_sub(reach) + 1;
        *to = (sum / count as f64) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bell(i: usize) -> f32 {
        let x = (i as f32 - 512.0) / 217.0;
        2000.0 * (-0.5 * x * x).exp()
    }

    #[test]
    fn a_capture_is_the_mean_of_its_lines() {
        let mut background = Background::new(1024);
        background.capture(3);
        for n in 0..3 {
            let line: Vec<f32> = (0..1024).map(|i| bell(i) + n as f32).collect();
            assert_eq!(background.missing(), 3 - n);
            assert_eq!(background.see(&line), n == 2);
        }
        for (i, counts) in background.counts().iter().enumerate() {
            assert!((counts - bell(i) - 1.0).abs() < 1e-3, "{i}: {counts}");
        }
        assert_eq!(background.missing(), 0);
    }

    #[test]
    fn fringes_of_a_surface_do_not_get_into_it() {
        let mut background = Background::new(1024);
        let line: Vec<f32> = (0..1024).map(|i| bell(i) * (1.0 + 0.1 * (i as f32 * 0.4).cos())).collect();
        for _ in 0..1000 {
            background.see(&line);
        }
        for i in 64..960 {
            let off = background.counts()[i] - bell(i);
            // What smoothing does to the bell itself is slow along the line.
            let next = background.counts()[i + 1] - bell(i + 1);
            assert!(off.abs() < 40.0 && (off - next).abs() < 1.5, "{i}: {off}, {next}");
        }
    }

    #[test]
    fn a_drifting_source_is_followed() {
        let mut background = Background::new(1024);
        background.capture(1);
        let line: Vec<f32> = (0..1024).map(bell).collect();
        background.see(&line);
        let brighter: Vec<f32> = line.iter().map(|x| 1.02 * x).collect();
        for _ in 0..40_000 {
            background.see(&brighter);
        }
        assert!((background.counts()[512] / brighter[512] - 1.0).abs() < 1e-3);
    }
}
