//! Known symbols: SI, and the units that devices of the field count in.
//!
//! Invariant: sorted by what they measure; a symbol stands for powers of bases that stand only for
//! themselves.

use crate::nearest;

pub(super) struct Symbol {
    pub(super) name: &'static str,
    /// Power of ten against its bases.
    pub(super) ten: i32,
    pub(super) parts: &'static [(&'static str, i32)],
    /// Takes k, m, µ and the like.
    pub(super) prefixed: bool,
}

/// Every prefix and its power of ten; both letters that look like µ, and u for keyboards.
pub(super) const PREFIXES: [(&str, i32); 14] = [
    ("T", 12),
    ("G", 9),
    ("M", 6),
    ("k", 3),
    ("h", 2),
    ("d", -1),
    ("c", -2),
    ("m", -3),
    ("u", -6),
    ("µ", -6),
    ("μ", -6),
    ("n", -9),
    ("p", -12),
    ("f", -15),
];

const fn si(name: &'static str, parts: &'static [(&'static str, i32)]) -> Symbol {
    Symbol { name, ten: 0, parts, prefixed: true }
}

const fn plain(name: &'static str, parts: &'static [(&'static str, i32)]) -> Symbol {
    Symbol { name, ten: 0, parts, prefixed: false }
}

const SYMBOLS: &[Symbol] = &[
    // Base units.
    si("m", &[("m", 1)]),
    si("g", &[("g", 1)]),
    si("s", &[("s", 1)]),
    si("A", &[("A", 1)]),
    si("K", &[("K", 1)]),
    si("mol", &[("mol", 1)]),
    si("cd", &[("cd", 1)]),
    // Angles.
    si("rad", &[("rad", 1)]),
    si("sr", &[("sr", 1)]),
    plain("deg", &[("deg", 1)]),
    plain("°", &[("deg", 1)]),
    plain("rev", &[("rev", 1)]),
    // Derived units keep their name: a torque is no energy.
    si("Hz", &[("s", -1)]),
    si("N", &[("N", 1)]),
    si("Nm", &[("N", 1), ("m", 1)]),
    si("Pa", &[("Pa", 1)]),
    si("bar", &[("bar", 1)]),
    plain("mmHg", &[("mmHg", 1)]),
    si("J", &[("J", 1)]),
    si("eV", &[("eV", 1)]),
    si("W", &[("W", 1)]),
    si("V", &[("V", 1)]),
    si("C", &[("C", 1)]),
    si("F", &[("F", 1)]),
    si("H", &[("H", 1)]),
    si("T", &[("T", 1)]),
    si("Wb", &[("Wb", 1)]),
    si("Ohm", &[("Ohm", 1)]),
    si("Ω", &[("Ohm", 1)]),
    si("S", &[("S", 1)]),
    si("lm", &[("lm", 1)]),
    si("lx", &[("lx", 1)]),
    si("L", &[("L", 1)]),
    plain("degC", &[("degC", 1)]),
    plain("°C", &[("degC", 1)]),
    plain("D", &[("m", -1)]),
    // Time of day and turning.
    plain("min", &[("min", 1)]),
    plain("h", &[("h", 1)]),
    plain("d", &[("d", 1)]),
    plain("rpm", &[("rev", 1), ("min", -1)]),
    // Counted things.
    si("B", &[("B", 1)]),
    si("bit", &[("bit", 1)]),
    si("Bd", &[("Bd", 1)]),
    si("px", &[("px", 1)]),
    plain("voxel", &[("voxel", 1)]),
    plain("count", &[("count", 1)]),
    plain("sample", &[("sample", 1)]),
    plain("frame", &[("frame", 1)]),
    plain("line", &[("line", 1)]),
    plain("step", &[("step", 1)]),
    plain("cycle", &[("cycle", 1)]),
    // Ratios.
    Symbol { name: "%", ten: -2, parts: &[], prefixed: false },
    Symbol { name: "ppm", ten: -6, parts: &[], prefixed: false },
    plain("dB", &[("dB", 1)]),
    plain("dBm", &[("dBm", 1)]),
];

/// Common other spellings.
const HABITS: &[(&str, &str)] = &[
    ("meter", "m"),
    ("metre", "m"),
    ("millimeter", "mm"),
    ("millimetre", "mm"),
    ("micron", "µm"),
    ("inch", "mm"),
    ("kilogram", "kg"),
    ("sec", "s"),
    ("second", "s"),
    ("msec", "ms"),
    ("usec", "µs"),
    ("minute", "min"),
    ("hour", "h"),
    ("hr", "h"),
    ("radian", "rad"),
    ("degree", "deg"),
    ("hertz", "Hz"),
    ("fps", "Hz"),
    ("newton", "N"),
    ("pascal", "Pa"),
    ("volt", "V"),
    ("amp", "A"),
    ("ampere", "A"),
    ("watt", "W"),
    ("joule", "J"),
    ("kelvin", "K"),
    ("celsius", "degC"),
    ("ohm", "Ohm"),
    ("liter", "L"),
    ("litre", "L"),
    ("ml", "mL"),
    ("l", "L"),
    ("byte", "B"),
    ("pixel", "px"),
    ("pix", "px"),
    ("percent", "%"),
    ("none", "1"),
    ("mps", "m/s"),
    ("rps", "rev/s"),
];

pub(super) fn symbol(name: &str) -> Option<&'static Symbol> {
    SYMBOLS.iter().find(|s| s.name == name)
}

/// "; did you mean `N`?", or where to look.
pub(super) fn suggestion(name: &str) -> String {
    let lower = name.to_lowercase();
    let singular = lower.strip_suffix('s').unwrap_or(&lower);
    let habit = HABITS.iter().find(|(habit, _)| *habit == lower || *habit == singular).map(|(_, unit)| *unit);
    let same = SYMBOLS.iter().map(|s| s.name).find(|s| s.to_lowercase() == lower);
    // A digit behind a known symbol is a power that lacks its sign.
    let bare = name.trim_end_matches(|c: char| c.is_ascii_digit());
    if bare != name && !bare.is_empty() && super::find(bare).is_some() {
        return format!("; did you mean `{bare}^{}`?", &name[bare.len()..]);
    }
    match habit.or(same).or_else(|| nearest(name, SYMBOLS.iter().map(|s| s.name))) {
        Some(unit) => format!("; did you mean `{unit}`?"),
        None => "; known are SI units with prefixes, deg, min, px, B, count, % and a few more".to_owned(),
    }
}
