//! Units of measurement: valid spellings, and when two of them mean the same.
//!
//! Invariant: equal means equal numbers: `N*m`, `Nm` and `m.N` are one unit, `N` and `mN` are two, and so are
//! `rad` and `deg`. Nothing is ever converted here.
//!
//! A unit is symbols with a prefix and a power, joined by `*` (or `.` or `·`) and divided by `/`: `mm`,
//! `rad/s^2`, `N*m`, `1/m`, `m/s²`. Alternatives are separated by `|`: `m|rad` for joints of both kinds. ""
//! and `1` are no unit.

mod check;
mod symbols;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use symbols::{PREFIXES, suggestion, symbol};

/// A unit in its one canonical form.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Unit {
    /// More than one where values of several kinds lie side by side.
    alternatives: BTreeSet<Product>,
}

/// Powers of base symbols, times a power of ten.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Product {
    ten: i32,
    powers: BTreeMap<&'static str, i32>,
}

/// Why a text is no unit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnitError {
    pub text: String,
    /// "`newton` is no unit; did you mean `N`?"
    pub why: String,
}

impl fmt::Display for UnitError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "unit {:?}: {}", self.text, self.why)
    }
}

impl std::error::Error for UnitError {}

/// Longest text that is read, bytes.
const MAX_LEN: usize = 64;
/// Largest power of a symbol.
const MAX_POWER: i32 = 9;

impl Unit {
    /// # Errors
    /// The symbol that is unknown with what was probably meant, or what is wrong with the text.
    pub fn parse(text: &str) -> Result<Unit, UnitError> {
        let bad = |why: String| UnitError { text: text.chars().take(MAX_LEN).collect(), why };
        if text.len() > MAX_LEN {
            return Err(bad(format!("it is longer than {MAX_LEN} bytes")));
        }
        if text.is_empty() {
            return Ok(Unit::default());
        }
        let alternatives = text.split('|').map(|part| Product::parse(part).map_err(bad));
        let alternatives = alternatives.collect::<Result<BTreeSet<Product>, UnitError>>()?;
        let none = alternatives.len() == 1 && alternatives.contains(&Product::default());
        Ok(if none { Unit::default() } else { Unit { alternatives } })
    }

    /// Tells whether two spellings mean the same; an unreadable one is only the same as itself.
    pub fn same(a: &str, b: &str) -> bool {
        a == b || matches!((Unit::parse(a), Unit::parse(b)), (Ok(a), Ok(b)) if a == b)
    }
}

impl Product {
    fn parse(text: &str) -> Result<Product, String> {
        let mut product = Product::default();
        let (mut rest, mut divided) = (text, false);
        loop {
            let end = rest.find(['*', '.', '·', '/']).unwrap_or(rest.len());
            product.factor(&rest[..end], divided)?;
            let Some(sign) = rest[end..].chars().next() else { break };
            // Left to right it would be a factor again, which readers do not expect.
            if divided && sign != '/' {
                return Err(format!(
                    "it is ambiguous after the first `/`: write products before it (`{text}`)"
                ));
            }
            divided = sign == '/';
            rest = &rest[end + sign.len_utf8()..];
        }
        product.powers.retain(|_, power| *power != 0);
        Ok(product)
    }

    fn factor(&mut self, text: &str, divided: bool) -> Result<(), String> {
        let (name, power) = split_power(text)?;
        if name == "1" {
            return Ok(());
        }
        if name.is_empty() {
            return Err("a symbol is missing".to_owned());
        }
        let Some((ten, parts)) = find(name) else {
            return Err(format!("`{name}` is no unit{}", suggestion(name)));
        };
        let power = if divided { -power } else { power };
        self.ten += ten * power;
        for (base, of_base) in parts {
            *self.powers.entry(base).or_default() += of_base * power;
        }
        Ok(())
    }
}

/// The symbol itself, or behind a prefix: its power of ten and what it consists of.
fn find(name: &str) -> Option<(i32, &'static [(&'static str, i32)])> {
    if let Some(symbol) = symbol(name) {
        return Some((symbol.ten, symbol.parts));
    }
    PREFIXES.iter().find_map(|(prefix, ten)| {
        let symbol = symbol(name.strip_prefix(prefix)?).filter(|s| s.prefixed)?;
        Some((ten + symbol.ten, symbol.parts))
    })
}

/// `s^-2` → (`s`, -2), `m²` → (`m`, 2), `m` → (`m`, 1).
fn split_power(text: &str) -> Result<(&str, i32), String> {
    let (name, power) = match text.split_once('^') {
        Some((name, power)) => (name, power.trim_start_matches('(').trim_end_matches(')').to_owned()),
        None => {
            let end = text.find(['⁻', '¹', '²', '³']).unwrap_or(text.len());
            let plain = text[end..].chars().map(|c| match c {
                '⁻' => '-',
                '¹' => '1',
                '²' => '2',
                '³' => '3',
                other => other,
            });
            (&text[..end], if end < text.len() { plain.collect() } else { "1".to_owned() })
        }
    };
    match power.parse::<i32>() {
        Ok(power) if power != 0 && power.abs() <= MAX_POWER => Ok((name, power)),
        _ => Err(format!("`{power}` is no power: write a whole number up to {MAX_POWER}, as in `s^2`")),
    }
}

impl fmt::Display for Unit {
    /// The canonical spelling; an empty text for no unit.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, product) in self.alternatives.iter().enumerate() {
            let bar = if i > 0 { "|" } else { "" };
            write!(f, "{bar}{product}")?;
        }
        Ok(())
    }
}

impl fmt::Display for Product {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ten = (self.ten != 0).then(|| format!("10^{}", self.ten));
        let powers = self.powers.iter().map(|(base, power)| match power {
            1 => (*base).to_owned(),
            _ => format!("{base}^{power}"),
        });
        let all: Vec<String> = ten.into_iter().chain(powers).collect();
        f.write_str(if all.is_empty() { "1" } else { "" })?;
        f.write_str(&all.join("*"))
    }
}
