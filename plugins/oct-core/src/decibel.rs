//! Decibels of many powers at once, by a short series instead of a logarithm each, and bytes of many
//! decibels.
//!
//! Invariant: within 1e-4 dB of `10 log10` for powers from 1e-20 to 1e30; nothing is below [`SILENT_DB`]. No
//! branch and no conversion that saturates: the compiler does several side by side.

/// Value of no power at all, dB, with which a line that says nothing is filled.
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

/// A number to be added to one from 0 to 255: the sum's lowest byte is the latter, to the nearest, the even
/// one of two.
const BYTE_LOWEST: f32 = 8_388_608.0;

/// Writes the byte of each value, 0 for `low` dB and less, 255 for `high` dB and more; a value that is no
/// number is 0. As many as both have.
pub fn shades(db: &[f32], low: f32, high: f32, to: &mut [u8]) {
    let scale = 255.0 / (high - low);
    for (db, to) in db.iter().zip(to) {
        let shade = (db - low) * scale;
        // Not `clamp`, which lets through what is no number.
        let shade = if shade > 0.0 { shade } else { 0.0 };
        let shade = if shade < 255.0 { shade } else { 255.0 };
        *to = (shade + BYTE_LOWEST).to_bits() as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shade_is_the_nearest_of_256_and_all_beyond_the_range_are_black_or_white() {
        let db: Vec<f32> = (-3000..3000).map(|n| n as f32 * 0.05).collect();
        let mut bytes = vec![1; db.len()];
        shades(&db, 45.0, 95.0, &mut bytes);
        for (db, byte) in db.iter().zip(bytes) {
            let exact = (f64::from(*db) - 45.0) * 255.0 / 50.0;
            let off = exact.clamp(0.0, 255.0) - f64::from(byte);
            assert!(off.abs() <= 0.5 + 1e-4, "{db} dB is {exact}, not {byte}");
        }
        let mut bytes = [1; 5];
        shades(&[f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, SILENT_DB], 45.0, 95.0, &mut bytes);
        assert_eq!(bytes, [0, 255, 0, 255, 0]);
    }

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
