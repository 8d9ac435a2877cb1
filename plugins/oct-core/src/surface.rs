//! The first surface in an A-scan.
//!
//! Invariant: a surface is a local maximum well above the noise of this very A-scan; without such a maximum
//! there is none.

/// Conditions for a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// First bin that is looked at: before it lies what the reference arm leaves.
    pub first_bin: usize,
    /// Standard deviations above the noise.
    pub sigmas: f32,
    /// dB above that.
    pub above_db: f32,
}

impl Default for Rule {
    fn default() -> Rule {
        Rule { first_bin: 38, sigmas: 4.0, above_db: 3.0 }
    }
}

/// Distance from the strongest echo down to its own skirts, dB: remains of interpolation between pixels over
/// tens of bins. A detector with little noise shows them.
const SKIRTS_DB: f32 = 40.0;

/// A surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Place in bins, between bins by a parabola through three values in dB.
    pub bin: f32,
    /// Height of the peak, dB.
    pub peak_db: f32,
    /// Mean of the noise, dB.
    pub noise_db: f32,
}

/// Returns the first local maximum above the noise and the skirts of what is behind it; none in silence, in
/// noise alone, and in fewer than 16 bins.
pub fn first_surface(ascan: &[f32], rule: &Rule) -> Option<Surface> {
    let (mean, sigma) = noise(ascan)?;
    let from = rule.first_bin.max(1);
    let above_noise = mean + rule.sigmas * sigma + rule.above_db;
    let threshold = above_noise.max(strongest(ascan.get(from..)?) - SKIRTS_DB);
    let last = ascan.len() - 1;
    let mut at = from;
    while at < last {
        at += first_above(ascan.get(at..last)?, threshold)?;
        let (before, peak, after) = (ascan[at - 1], ascan[at], ascan[at + 1]);
        if peak > before && peak >= after {
            let bend = before - 2.0 * peak + after;
            let shift = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
            let peak_db = peak - 0.25 * (before - after) * shift;
            return Some(Surface { bin: at as f32 + shift, peak_db, noise_db: mean });
        }
        at += 1;
    }
    None
}

/// Returns mean and standard deviation of the noise, dB: those of the quietest of the three deeper quarters,
/// which is the deepest one unless the tissue lies there. None for silence.
fn noise(ascan: &[f32]) -> Option<(f32, f32)> {
    let quarter = ascan.len() / 4;
    if quarter < 4 {
        return None;
    }
    let mut best = (f32::INFINITY, 0.0);
    for part in ascan.chunks_exact(quarter).skip(1).take(3) {
        let (mean, sigma) = moments(part);
        if mean < best.0 {
            best = (mean, sigma);
        }
    }
    // Silence has no spread, and neither has a detector that always says the same.
    (best.0.is_finite() && best.1 > 0.1).then_some(best)
}

fn moments(part: &[f32]) -> (f32, f32) {
    // Against one of its values, so that squares stay small.
    let (offset, n) = (part[0], part.len() as f32);
    let sums = fold(part, 0.0, |sum, db| sum + (db - offset));
    let squares = fold(part, 0.0, |sum, db| sum + (db - offset) * (db - offset));
    let mean = sums.iter().sum::<f32>() / n;
    let variance = squares.iter().sum::<f32>() / n - mean * mean;
    (mean + offset, variance.max(0.0).sqrt())
}

/// The largest value, dB.
fn strongest(part: &[f32]) -> f32 {
    let most = fold(part, f32::MIN, |most, db| if db > most { db } else { most });
    most.into_iter().fold(f32::MIN, f32::max)
}

/// Number of values that are folded side by side: four times four, so that an addition need not wait for the
/// one before it.
const SIDE_BY_SIDE: usize = 16;

/// Folds the values into a few, side by side. One fold at a time: with two in one loop the compiler makes
/// neither so.
fn fold(part: &[f32], first: f32, with: impl Fn(f32, f32) -> f32) -> [f32; SIDE_BY_SIDE] {
    let mut all = [first; SIDE_BY_SIDE];
    let (chunks, rest) = part.as_chunks::<SIDE_BY_SIDE>();
    for chunk in chunks {
        for (all, db) in all.iter_mut().zip(chunk) {
            *all = with(*all, *db);
        }
    }
    for (all, db) in all.iter_mut().zip(rest) {
        *all = with(*all, *db);
    }
    all
}

/// The first place at which a value is above this.
fn first_above(part: &[f32], threshold: f32) -> Option<usize> {
    let is_above = |db: &f32| *db > threshold;
    let (chunks, rest) = part.as_chunks::<SIDE_BY_SIDE>();
    // Without a branch within a chunk.
    let in_chunk = chunks.iter().position(|chunk| chunk.iter().fold(false, |any, db| any | is_above(db)));
    let from = in_chunk.unwrap_or(chunks.len()) * SIDE_BY_SIDE;
    let within = if in_chunk.is_some() { &part[from..] } else { rest };
    Some(from + within.iter().position(is_above)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise of an A-scan, dB: 10 log10 of an exponential variable.
    fn noisy(seed: u64) -> Vec<f32> {
        let mut state = seed.wrapping_mul(2).wrapping_add(1);
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 40) as f32 + 0.5) / (1u64 << 24) as f32
        };
        (0..512).map(|_| 60.0 + 10.0 * (-next().ln()).log10()).collect()
    }

    fn with_peak(mut ascan: Vec<f32>, at: f32, height_db: f32) -> Vec<f32> {
        for (i, db) in ascan.iter_mut().enumerate() {
            let off = i as f32 - at;
            *db = db.max(height_db - 3.0 * off * off);
        }
        ascan
    }

    #[test]
    fn noise_alone_has_no_surface() {
        for seed in 0..2000 {
            assert_eq!(first_surface(&noisy(seed), &Rule::default()), None, "seed {seed}");
        }
    }

    #[test]
    fn a_peak_is_found_between_bins_wherever_it_is_even_among_the_deepest() {
        for at in [50.3, 190.25, 380.0, 470.49] {
            let found = first_surface(&with_peak(noisy(1), at, 100.0), &Rule::default()).expect("a peak");
            assert!((found.bin - at).abs() < 1e-3, "{} for {at}", found.bin);
            assert!((found.peak_db - 100.0).abs() < 1e-2 && (found.noise_db - 57.5).abs() < 2.0, "{found:?}");
        }
    }

    #[test]
    fn of_two_peaks_the_first_one_counts_and_one_before_the_first_bin_does_not() {
        let two = with_peak(with_peak(noisy(1), 250.0, 110.0), 120.0, 95.0);
        assert!((first_surface(&two, &Rule::default()).expect("a peak").bin - 120.0).abs() < 0.01);
        let early = with_peak(noisy(1), 20.0, 110.0);
        assert_eq!(first_surface(&early, &Rule::default()), None);
    }

    #[test]
    fn the_skirts_of_a_strong_echo_are_no_surface_and_a_weak_one_before_it_is() {
        let clean: Vec<f32> = noisy(1).iter().map(|db| db - 40.0).collect();
        let skirt = with_peak(with_peak(clean.clone(), 142.0, 101.0), 128.0, 50.0);
        assert!((first_surface(&skirt, &Rule::default()).expect("a peak").bin - 142.0).abs() < 0.01);
        let weak = with_peak(with_peak(clean, 142.0, 101.0), 128.0, 65.0);
        assert!((first_surface(&weak, &Rule::default()).expect("a peak").bin - 128.0).abs() < 0.01);
    }

    #[test]
    fn silence_short_lines_and_numbers_that_are_none_have_no_surface() {
        assert_eq!(first_surface(&[crate::decibel::SILENT_DB; 512], &Rule::default()), None);
        assert_eq!(first_surface(&[f32::NAN; 512], &Rule::default()), None);
        for n in 0..64 {
            assert_eq!(first_surface(&vec![1.0; n], &Rule::default()), None);
        }
        let rule = Rule { first_bin: 9999, ..Rule::default() };
        assert_eq!(first_surface(&with_peak(noisy(1), 200.0, 100.0), &rule), None);
    }
}
