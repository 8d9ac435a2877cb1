//! Numbers with their units, and durations as people type them.
//!
//! Invariant: every figure the program prints for people comes from here, so none is without its unit.

/// A time, from ns to s, with three digits.
pub(super) fn time(ns: u64) -> String {
    let n = ns as f64;
    match ns {
        0..=999 => format!("{ns} ns"),
        1_000..=999_999 => format!("{} µs", three(n / 1e3)),
        1_000_000..=999_999_999 => format!("{} ms", three(n / 1e6)),
        _ => format!("{} s", three(n / 1e9)),
    }
}

/// A figure that only exists once something was measured: 0 is shown as "-".
pub(super) fn measured(ns: u64) -> String {
    if ns == 0 { "-".to_owned() } else { time(ns) }
}

/// A rate.
pub(super) fn rate(hz: f64) -> String {
    format!("{} Hz", three(hz))
}

/// Bytes in a second.
pub(super) fn bytes_per_s(bytes: f64) -> String {
    match bytes {
        b if b < 1e3 => format!("{} B/s", three(b)),
        b if b < 1e6 => format!("{} kB/s", three(b / 1e3)),
        b if b < 1e9 => format!("{} MB/s", three(b / 1e6)),
        b => format!("{} GB/s", three(b / 1e9)),
    }
}

/// A rate of a period in ns.
pub(super) fn rate_of_period(period_ns: u64) -> String {
    if period_ns == 0 { "-".to_owned() } else { rate(1e9 / period_ns as f64) }
}

/// Counts something that is called by a regular word: "1 output", "2 outputs".
pub(super) fn count(n: u64, one: &str) -> String {
    let more = if one.ends_with('s') { "es" } else { "s" };
    format!("{n} {one}{}", if n == 1 { "" } else { more })
}

/// A part of one.
pub(super) fn percent(part: f64) -> String {
    format!("{:.1} %", part * 100.0)
}

/// Three significant digits, whole numbers stay whole.
fn three(n: f64) -> String {
    let rounded = match n.abs() {
        a if a >= 100.0 => format!("{n:.0}"),
        a if a >= 10.0 => format!("{n:.1}"),
        _ => format!("{n:.2}"),
    };
    match rounded.split_once('.') {
        Some((whole, zeros)) if zeros.bytes().all(|b| b == b'0') => whole.to_owned(),
        _ => rounded,
    }
}

/// Reads "1s", "20ms", "1.5 s", "250us", "1min" as ns.
///
/// # Errors
/// No number, no unit, or not above 0.
pub(super) fn parse_time(text: &str) -> Result<u64, String> {
    match parse_time_or_zero(text) {
        Ok(0) => Err("it must be above 0 and below 292 years".to_owned()),
        read => read,
    }
}

/// The same, and 0 as "0s" or "0".
///
/// # Errors
/// No number, no unit, or negative.
pub(super) fn parse_time_or_zero(text: &str) -> Result<u64, String> {
    let text = text.trim();
    if text == "0" {
        return Ok(0);
    }
    let unit_at =
        text.find(|c: char| !(c.is_ascii_digit() || c == '.')).ok_or("a unit is missing: 1s, 20ms, 250us")?;
    let (number, unit) = text.split_at(unit_at);
    let factor = match unit.trim() {
        "ns" => 1,
        "us" | "µs" => 1_000,
        "ms" => 1_000_000,
        "s" => 1_000_000_000,
        "min" => 60_000_000_000,
        other => {
            return Err(format!("{:?} is not a unit of time; write ns, us, ms, s or min", cut(other, 20)));
        }
    };
    let begins = || format!("{:?} does not begin with a number", cut(text, 20));
    let beyond = || "it must be above 0 and below 292 years".to_owned();
    // Whole numbers exactly: a stamp has more digits than a double.
    let ns = match number.parse::<u64>() {
        Ok(whole) => whole.checked_mul(factor).ok_or_else(beyond)?,
        Err(_) => {
            let part: f64 = number.parse().map_err(|_| begins())?;
            (part * factor as f64).round() as u64
        }
    };
    if ns < 9_000_000_000_000_000_000 { Ok(ns) } else { Err(beyond()) }
}

/// Reads a rate above 0 in Hz.
///
/// # Errors
/// Not a number above 0.
pub(super) fn parse_rate(text: &str) -> Result<f64, String> {
    match text.trim_end_matches("Hz").trim().parse::<f64>() {
        Ok(hz) if hz > 0.0 && hz.is_finite() => Ok(hz),
        Ok(_) => {
            Err("a rate is a number above 0, in Hz; --model none or on_signal is without one".to_owned())
        }
        Err(_) => Err("a rate is a number above 0, in Hz, e.g. 1000".to_owned()),
    }
}

/// Returns at most `most` characters, with the number of those left out.
pub(super) fn cut(text: &str, most: usize) -> String {
    let all = text.chars().count();
    if all <= most {
        return text.to_owned();
    }
    let head: String = text.chars().take(most).collect();
    format!("{head}… ({} more characters)", all - most)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn times_carry_the_unit_that_fits() {
        let shown: Vec<String> = [0, 999, 1_000, 12_345, 1_200_000, 2_500_000_000].map(time).into();
        assert_eq!(shown, ["0 ns", "999 ns", "1 µs", "12.3 µs", "1.20 ms", "2.50 s"]);
        assert_eq!(rate_of_period(1_000_000), "1000 Hz");
        assert_eq!(rate(29.97), "30 Hz");
    }

    #[test]
    fn one_and_several_have_words_of_their_own() {
        let said = [(0, "line"), (1, "class"), (2, "class"), (1, "output")].map(|(n, one)| count(n, one));
        assert_eq!(said, ["0 lines", "1 class", "2 classes", "1 output"]);
    }

    #[test]
    fn typed_times_are_read_with_their_unit() {
        let read: Vec<u64> = ["1s", "20ms", "1.5 s", "250us", "1min"].map(|t| parse_time(t).unwrap()).into();
        assert_eq!(read, [1_000_000_000, 20_000_000, 1_500_000_000, 250_000, 60_000_000_000]);
    }

    #[test]
    fn a_time_without_a_unit_is_refused() {
        assert!(parse_time("5").unwrap_err().contains("unit is missing"));
        assert!(parse_time("5 parsec").unwrap_err().contains("not a unit"));
        assert!(parse_time("0s").unwrap_err().contains("above 0"));
        assert!(parse_time("s").unwrap_err().contains("begin with a number"));
        assert!(parse_time("-5ms").is_err() && parse_time("99999999999min").is_err());
        assert_eq!(parse_time_or_zero("0"), Ok(0));
    }

    #[test]
    fn a_stamp_is_read_to_the_ns() {
        assert_eq!(parse_time("9007199254740993ns"), Ok(9_007_199_254_740_993));
    }

    #[test]
    fn what_is_too_long_is_cut_and_says_so() {
        assert_eq!(cut("short", 5), "short");
        assert_eq!(cut("µµµµ", 2), "µµ… (2 more characters)");
    }
}
