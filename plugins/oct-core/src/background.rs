//! Signal of the reference arm alone: subtracted from each line, so that only interference is left.
//!
//! Invariant: no fringe of a surface gets into it. The part that is followed during operation is smoothed
//! over a sixteenth of the line three times, which takes every fringe of more than 40 periods down below
//! 1/300. While a nearer surface is there, nothing is followed.

/// Each so many lines the drift is looked at.
const EVERY: u32 = 64;
/// One look is four pieces of work that lie so many lines apart: done at once, it would take as long as three
/// lines.
const APART: u32 = EVERY / 4;
/// Part that one look has.
const SHARE: f32 = 1.0 / 64.0;

/// Mean spectrum of the reference arm.
#[derive(Clone, Debug, Default)]
pub struct Background {
    /// Values that are subtracted, counts.
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
    /// Pieces of the running look that are done; 0 = none runs.
    looked: u32,
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

    /// Returns the values to be subtracted from the next line, counts.
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
        if frozen {
            self.looked = 0;
        }
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
        } else if self.lines.is_multiple_of(APART) && !self.frozen && !done {
            self.look(line);
        }
        self.lines = self.lines.wrapping_add(1);
        done
    }

    /// Does the next piece of a look: three means over the line that was there when it began, then their
    /// result.
    fn look(&mut self, line: &[f32]) {
        let reach = reach(line);
        let [a, b] = &mut self.work;
        match self.looked {
            0 if !self.lines.is_multiple_of(EVERY) => return,
            0 => mean_over(line, reach, a),
            1 => mean_over(a, reach, b),
            2 => mean_over(b, reach, a),
            _ => {
                let (now, smooth_now) = (self.now.iter_mut(), self.smooth_now.iter_mut());
                let then = self.captured.iter().zip(&self.smooth_then);
                for (((now, smooth), new), (captured, then)) in now.zip(smooth_now).zip(a).zip(then) {
                    *smooth += SHARE * (*new - *smooth);
                    *now = captured + (*smooth - then);
                }
            }
        }
        self.looked = (self.looked + 1) % 4;
    }

    /// Takes the captured line as background; of a line with a surface in it only the smooth part.
    fn begin(&mut self, smoothed: bool) {
        smooth(&self.captured, &mut self.work);
        if smoothed {
            self.captured.copy_from_slice(&self.work[0]);
        }
        self.smooth_then.copy_from_slice(&self.work[0]);
        self.smooth_now.copy_from_slice(&self.work[0]);
        self.now.copy_from_slice(&self.captured);
        (self.known, self.lines, self.looked) = (true, 1, 0);
    }
}

/// Values to both sides that a mean is over: a sixteenth of the line in all.
fn reach(line: &[f32]) -> usize {
    line.len() / 32
}

/// Three means, into `work[0]`.
fn smooth(line: &[f32], work: &mut [Vec<f32>; 2]) {
    let reach = reach(line);
    let [a, b] = work;
    mean_over(line, reach, a);
    mean_over(a, reach, b);
    mean_over(b, reach, a);
}

/// Mean over `reach` to both sides, fewer at the ends; `reach` is less than half of the length.
fn mean_over(from: &[f32], reach: usize, to: &mut [f32]) {
    let (n, all) = (from.len(), 2 * reach + 1);
    if n < all || to.len() != n {
        return;
    }
    let mut sum: f64 = from[..reach].iter().map(|x| f64::from(*x)).sum();
    for (i, to) in to[..=reach].iter_mut().enumerate() {
        sum += f64::from(from[i + reach]);
        *to = (sum / (i + reach + 1) as f64) as f32;
    }
    // A product for a quotient, and one sum that waits for the one before: this is most of the line.
    let share = 1.0 / all as f64;
    for ((enters, leaves), to) in from[all..].iter().zip(from).zip(&mut to[reach + 1..]) {
        sum += f64::from(*enters) - f64::from(*leaves);
        *to = (sum * share) as f32;
    }
    for i in n - reach..n {
        sum -= f64::from(from[i - reach - 1]);
        to[i] = (sum / (n - i + reach) as f64) as f32;
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
            // The smoothing's effect on the bell itself is slow along the line.
            let next = background.counts()[i + 1] - bell(i + 1);
            assert!(off.abs() < 40.0 && (off - next).abs() < 1.5, "{i}: {off}, {next}");
        }
    }

    #[test]
    fn a_look_is_taken_in_pieces_and_dropped_when_a_surface_comes_near_meanwhile() {
        let line: Vec<f32> = (0..1024).map(bell).collect();
        let brighter: Vec<f32> = line.iter().map(|x| 1.5 * x).collect();
        for comes_near in [false, true] {
            let mut background = Background::new(1024);
            background.capture(1);
            background.see(&line);
            while !background.is_due() {
                background.see(&line);
            }
            // The look begins with this line, and what is seen while it lasts does not count.
            background.see(&brighter);
            for n in 1..EVERY {
                assert!((background.counts()[512] - line[512]).abs() < 0.1, "{n} lines behind it");
                if n == 3 * APART {
                    break;
                }
                if comes_near && n == APART + 1 {
                    background.freeze(true);
                    background.freeze(false);
                }
                background.see(&line);
            }
            background.see(&line);
            let followed = background.counts()[512] - line[512];
            let wanted = if comes_near { 0.0 } else { 0.5 * line[512] * SHARE };
            assert!((followed - wanted).abs() < 0.1 * line[512] * SHARE, "{followed} for {wanted}");
        }
    }

    #[test]
    fn a_mean_is_that_of_its_neighbours_and_of_fewer_at_the_ends() {
        let from: Vec<f32> = (0..100).map(|i| ((i * 37) % 101) as f32).collect();
        for reach in [0, 1, 3, 49] {
            let mut to = vec![0.0; 100];
            mean_over(&from, reach, &mut to);
            for (i, to) in to.iter().enumerate() {
                let near = &from[i.saturating_sub(reach)..(i + reach + 1).min(100)];
                let mean = near.iter().sum::<f32>() / near.len() as f32;
                assert!((to - mean).abs() < 1e-4, "{i} over {reach}: {to} for {mean}");
            }
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
