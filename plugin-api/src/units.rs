//! Units of measurement as plugins write them: the grammar, and which symbols there are.
//!
//! Invariant: accepts exactly what the host's reader accepts (a test of the SDK compares them), so a unit
//! that compiles is read. Whether two units are the same is the host's business.
//!
//! A unit is symbols with a prefix and a power, joined by `*` (or `.` or `·`), then divided by `/`: `mm`,
//! `rad/s^2`, `N.m`, `1/m`. Alternatives are separated by `|`: `m|rad`. "" and `1` are no unit.

/// Longest text, bytes.
const MAX_LEN: usize = 64;
/// Largest power of a symbol.
const MAX_POWER: i32 = 9;

/// u and both letters that look like µ are micro.
const PREFIXES: [&str; 14] = ["T", "G", "M", "k", "h", "d", "c", "m", "u", "µ", "μ", "n", "p", "f"];

/// Symbols that take a prefix.
const PREFIXED: [&str; 33] = [
    "m", "g", "s", "A", "K", "mol", "cd", "rad", "sr", "Hz", "N", "Nm", "Pa", "bar", "J", "eV", "W", "V",
    "C", "F", "H", "T", "Wb", "Ohm", "Ω", "S", "lm", "lx", "L", "B", "bit", "Bd", "px",
];

/// Symbols that stand alone.
const PLAIN: [&str; 22] = [
    "deg", "°", "rev", "mmHg", "degC", "°C", "D", "min", "h", "d", "rpm", "voxel", "count", "sample",
    "frame", "line", "step", "cycle", "%", "ppm", "dB", "dBm",
];

/// Common spellings that are no symbols, each with its symbol.
const HABITS: [(&str, &str); 26] = [
    ("meter", "m"),
    ("metre", "m"),
    ("millimeter", "mm"),
    ("micron", "µm"),
    ("kilogram", "kg"),
    ("sec", "s"),
    ("second", "s"),
    ("msec", "ms"),
    ("minute", "min"),
    ("hour", "h"),
    ("radian", "rad"),
    ("degree", "deg"),
    ("hertz", "Hz"),
    ("fps", "Hz"),
    ("newton", "N"),
    ("pascal", "Pa"),
    ("volt", "V"),
    ("amp", "A"),
    ("watt", "W"),
    ("joule", "J"),
    ("kelvin", "K"),
    ("celsius", "degC"),
    ("liter", "L"),
    ("byte", "B"),
    ("pixel", "px"),
    ("percent", "%"),
];

/// Whether `text` is a unit.
///
/// # Errors
/// "`newton` is no unit; did you mean `N`?"
pub fn check(text: &str) -> Result<(), String> {
    if text.len() > MAX_LEN {
        return Err(format!("a unit is at most {MAX_LEN} bytes long"));
    }
    if text.is_empty() {
        return Ok(());
    }
    text.split('|').try_for_each(product)
}

fn product(text: &str) -> Result<(), String> {
    let (mut rest, mut divided) = (text, false);
    loop {
        let end = rest.find(['*', '.', '·', '/']).unwrap_or(rest.len());
        factor(&rest[..end])?;
        let Some(sign) = rest[end..].chars().next() else { return Ok(()) };
        if divided && sign != '/' {
            return Err(format!("`{text}` is ambiguous after the first `/`: write products before it"));
        }
        divided = sign == '/';
        rest = &rest[end + sign.len_utf8()..];
    }
}

fn factor(text: &str) -> Result<(), String> {
    let (name, power) = match text.split_once('^') {
        Some((name, power)) => (name, power.trim_start_matches('(').trim_end_matches(')').to_string()),
        None => {
            let end = text.find(['⁻', '¹', '²', '³']).unwrap_or(text.len());
            let raised = if end < text.len() { &text[end..] } else { "1" };
            (&text[..end], raised.chars().map(lowered).collect())
        }
    };
    if !power.parse::<i32>().is_ok_and(|p| p != 0 && p.abs() <= MAX_POWER) {
        return Err(format!("`{power}` is no power: write a whole number up to {MAX_POWER}, as in `s^2`"));
    }
    match name {
        "" => Err("a symbol is missing".to_string()),
        name if known(name) => Ok(()),
        name => Err(format!("`{name}` is no unit{}", suggestion(name))),
    }
}

fn lowered(c: char) -> char {
    match c {
        '⁻' => '-',
        '¹' => '1',
        '²' => '2',
        '³' => '3',
        other => other,
    }
}

fn known(name: &str) -> bool {
    let prefixed = |p: &str| name.strip_prefix(p).is_some_and(|rest| PREFIXED.contains(&rest));
    name == "1" || PLAIN.contains(&name) || PREFIXED.contains(&name) || PREFIXES.iter().any(|p| prefixed(p))
}

fn suggestion(name: &str) -> String {
    let lower = name.to_lowercase();
    let singular = lower.strip_suffix('s').unwrap_or(&lower);
    let habit = HABITS.iter().find(|(habit, _)| *habit == lower || *habit == singular);
    let same = PREFIXED.iter().chain(&PLAIN).find(|s| s.to_lowercase() == lower);
    let bare = name.trim_end_matches(|c: char| c.is_ascii_digit());
    // A letter too often: `mmm`.
    let once = name.chars().next().filter(|first| name.chars().skip(1).all(|c| c == *first));
    let shorter = once.and_then(|c| name.strip_suffix(c)).filter(|shorter| known(shorter));
    // Two units side by side: `Nmm`.
    let split = name.char_indices().skip(1).map(|(at, _)| name.split_at(at));
    let product = split.filter(|(a, b)| known(a) && known(b)).map(|(a, b)| format!("{a}.{b}")).next();
    let meant = match (habit, same) {
        (Some((_, unit)), _) => Some((*unit).to_string()),
        (None, Some(unit)) => Some((*unit).to_string()),
        _ if bare != name && known(bare) => Some(format!("{bare}^{}", &name[bare.len()..])),
        _ => shorter.map(str::to_string).or(product),
    };
    match meant {
        Some(unit) => format!("; did you mean `{unit}`?"),
        None => "; known are SI units with prefixes, deg, min, px, B, count, % and a few more".to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::check;

    #[test]
    fn what_the_tree_writes_is_a_unit() {
        for unit in [
            "", "1", "N", "mm", "µm", "rad/s^2", "m/s²", "N.m", "N|N.m", "m|rad", "1/m", "px", "s^-2",
            "kg*m/s/s",
        ] {
            assert_eq!(check(unit), Ok(()), "{unit}");
        }
    }

    #[test]
    fn a_wrong_unit_is_answered_with_what_was_meant() {
        for (wrong, meant) in [
            ("newton", "`N`"),
            ("Newtons", "`N`"),
            ("Nmm", "`N.mm`"),
            ("mmm", "`mm`"),
            ("mm2", "`mm^2`"),
            ("hz", "`Hz`"),
            ("furlong", "known are"),
            ("m/s*2", "ambiguous"),
            ("m^0", "no power"),
            ("m|", "missing"),
            ("/s", "missing"),
        ] {
            let why = check(wrong).unwrap_err();
            assert!(why.contains(meant), "{wrong}: {why}");
        }
        assert!(check(&"m.".repeat(40)).is_err());
    }
}
