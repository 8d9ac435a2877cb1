//! Decibels of many powers at once, by a short series instead of a logarithm each.
//!
//! Invariant: within 1e-4 dB of `10 log10` for powers from 1e-20 to 1e30; nothing is below [`SILENT_DB`].

/// What no power at all gives, dB, and what a line is filled with that says nothing.
pub const SILENT_DB: f32 = -200.0;

/// 10 log10 of a power of two.
const PER_OCTAVE: f32 = 3.010_3;
/// 20 / ln 10: 10 log10(m) = PER_SERIES · artanh((m − 1) / (m + 1)).
const PER_SERIES: f32 = 8.685_89;

/// `10 log10(power)`, dB.
#[inline]
pub fn decibel(power: f32) -> f32 {
    // Exponent such that the rest lies in [0.75, 1.5), where the series is short.
    let bits = power.max(1e-20).to_bits().cast_signed();
    let octave = (bits - 0x3f40_0000) >> 23;
    let rest = f32::from_bits((bits - (octave << 23)).cast_unsigned());
    let s = (rest - 1.0) / (rest + 1.0);
    let s2 = s * s;
    let series = s * (1.0 + s2 * (1.0 / 3.0 + s2 * (1.0 / 5.0 + s2 * (1.0 / 7.0))));
    octave as f32 * PER_OCTAVE + PER_SERIES * series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_is_the_logarithm() {
        let mut power = 1e-19f32;
        while power < 1e30 {
            let exact = 10.0 * f64::from(power).log10();
            assert!(
                (f64::from(decibel(power)) - exact).abs() < 1e-4,
                "{power}: {} for {exact}",
                decibel(power)
            );
            power *= 1.003_7;
        }
    }

    #[test]
    fn no_power_is_silence() {
        for power in [0.0, -1.0, f32::MIN_POSITIVE, f32::NAN] {
            assert!((decibel(power) - SILENT_DB).abs() < 1e-3, "{power}");
        }
    }
}
