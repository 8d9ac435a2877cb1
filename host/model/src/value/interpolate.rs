//! A value between two rows of one type.
//!
//! Invariant: every result is a value of the type whenever both rows are; at 0 it is exactly the first row,
//! at 1 exactly the second.
//!
//! | kind | between |
//! |---|---|
//! | f64, f32 | linear; nearest where one of the two is not finite |
//! | stamp | linear; nearest where one of the two is invalid (0) |
//! | integers, flags, enums, bool, text | nearest |
//! | array, struct | item by item, field by field |
//! | list | item by item where both have the same length, else nearest |
//! | `orientation` or `quaternion`, four floats without unit | along the shorter arc, if both have length 1 |

use super::{At, BEYOND, Res, checked_size};
use crate::{Field, Prim, StructType, Type};

/// Largest difference of the length of a unit quaternion from 1.
const UNIT: f64 = 1e-3;
/// Cosine of an angle so small that a straight line is the arc.
const STRAIGHT: f64 = 0.9995;

/// The row at `fraction` of the way from `a` to `b`, 0 to 1.
///
/// # Errors
/// A row that is not one `ty` long, a fraction outside 0 to 1, a description that reaches beyond its own
/// size.
pub fn interpolate(ty: &Type, a: &[u8], b: &[u8], fraction: f64) -> Res<Vec<u8>> {
    let size = checked_size(ty)?;
    for row in [a, b] {
        if row.len() != size {
            return At::Top.err(format!("{} bytes are not a {}, which has {size}", row.len(), ty.title()));
        }
    }
    if !(0.0..=1.0).contains(&fraction) {
        return At::Top.err(format!("{fraction} is not a fraction from 0 to 1"));
    }
    // Bytes that no field covers, and values that are not blended, are those of the nearer row.
    let mut out = if fraction < 0.5 { a.to_vec() } else { b.to_vec() };
    if fraction > 0.0 && fraction < 1.0 {
        blend(ty, &Rows { a, b, fraction }, &mut out)?;
    }
    Ok(out)
}

#[derive(Clone, Copy)]
struct Rows<'a> {
    a: &'a [u8],
    b: &'a [u8],
    fraction: f64,
}

impl<'a> Rows<'a> {
    fn part(&self, at: usize, len: usize) -> Option<Rows<'a>> {
        let end = at.checked_add(len)?;
        Some(Rows { a: self.a.get(at..end)?, b: self.b.get(at..end)?, fraction: self.fraction })
    }
}

/// `out` holds the nearer row when it comes in.
fn blend(ty: &Type, rows: &Rows<'_>, out: &mut [u8]) -> Res<()> {
    match ty {
        Type::Prim(p) => {
            prim(*p, rows, out);
            Ok(())
        }
        Type::Struct(s) => structure(s, rows, out),
        Type::Array { item, n } => items(item, *n, 0, rows, out),
        Type::List { item, n } => match (length(rows.a), length(rows.b)) {
            (Some(x), Some(y)) if x == y && x <= *n => items(item, x, 8, rows, out),
            _ => Ok(()),
        },
        Type::Text { .. } | Type::Enum(_) => Ok(()),
    }
}

fn length(row: &[u8]) -> Option<usize> {
    usize::try_from(u64::from_le_bytes(row.get(..8)?.try_into().ok()?)).ok()
}

fn items(item: &Type, n: usize, from: usize, rows: &Rows<'_>, out: &mut [u8]) -> Res<()> {
    let size = item.size();
    if size == 0 {
        return Ok(());
    }
    for i in 0..n {
        part(item, from.saturating_add(i.saturating_mul(size)), rows, out)?;
    }
    Ok(())
}

fn part(ty: &Type, at: usize, rows: &Rows<'_>, out: &mut [u8]) -> Res<()> {
    let len = ty.size();
    let room = at.checked_add(len).and_then(|end| out.get_mut(at..end));
    match (rows.part(at, len), room) {
        (Some(rows), Some(room)) => blend(ty, &rows, room),
        _ => At::Top.err(BEYOND),
    }
}

fn structure(s: &StructType, rows: &Rows<'_>, out: &mut [u8]) -> Res<()> {
    for f in &s.fields {
        part(&f.ty, f.at, rows, out)?;
        if let (Some(p), Some(rows)) = (quaternion(f), rows.part(f.at, f.ty.size()))
            && let Some(turned) = slerp(read(p, rows.a), read(p, rows.b), rows.fraction)
        {
            for (i, q) in turned.into_iter().enumerate() {
                let at = f.at + i * p.size();
                write(p, q, out.get_mut(at..at + p.size()).unwrap_or_default());
            }
        }
    }
    Ok(())
}

fn prim(p: Prim, rows: &Rows<'_>, out: &mut [u8]) {
    let (near, far) = (1.0 - rows.fraction, rows.fraction);
    match p {
        Prim::F32 | Prim::F64 => {
            let (x, y) = (float(p, rows.a), float(p, rows.b));
            // Weighted, not by the difference, which may overflow where both are finite.
            if x.is_finite() && y.is_finite() {
                write(p, if x == y { x } else { x * near + y * far }, out);
            }
        }
        Prim::Stamp => {
            let stamp = |row: &[u8]| row.try_into().map(u64::from_le_bytes).unwrap_or(0);
            let (x, y) = (stamp(rows.a), stamp(rows.b));
            if x != 0 && y != 0 {
                // Relative to the earlier one: an absolute count of ns has more digits than a double.
                let way = (x.abs_diff(y) as f64 * far).round() as u64;
                let at = if y >= x { x.saturating_add(way) } else { x.saturating_sub(way) };
                out.copy_from_slice(&at.to_le_bytes());
            }
        }
        _ => {}
    }
}

fn float(p: Prim, row: &[u8]) -> f64 {
    match p {
        Prim::F32 => row.try_into().map(f32::from_le_bytes).map_or(f64::NAN, f64::from),
        _ => row.try_into().map_or(f64::NAN, f64::from_le_bytes),
    }
}

fn write(p: Prim, value: f64, out: &mut [u8]) {
    match p {
        Prim::F32 if out.len() == 4 => out.copy_from_slice(&(value as f32).to_le_bytes()),
        Prim::F64 if out.len() == 8 => out.copy_from_slice(&value.to_le_bytes()),
        _ => {}
    }
}

/// The float of a field that is an orientation by its name, type and lack of a unit.
fn quaternion(f: &Field) -> Option<Prim> {
    let Type::Array { item, n: 4 } = &f.ty else { return None };
    match **item {
        Type::Prim(p @ (Prim::F32 | Prim::F64)) => {
            (matches!(f.name.as_str(), "orientation" | "quaternion") && f.unit.is_empty()).then_some(p)
        }
        _ => None,
    }
}

fn read(p: Prim, row: &[u8]) -> [f64; 4] {
    std::array::from_fn(|i| row.get(i * p.size()..(i + 1) * p.size()).map_or(f64::NAN, |item| float(p, item)))
}

/// Along the shorter arc (Shoemake, Animating Rotation with Quaternion Curves, 1985); nothing where one is no
/// unit quaternion.
fn slerp(a: [f64; 4], b: [f64; 4], fraction: f64) -> Option<[f64; 4]> {
    let dot = |x: &[f64; 4], y: &[f64; 4]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let is_unit = |q: &[f64; 4]| (dot(q, q).sqrt() - 1.0).abs() <= UNIT;
    if !is_unit(&a) || !is_unit(&b) {
        return None;
    }
    let cos = dot(&a, &b);
    // q and -q are the same orientation.
    let (cos, sign) = if cos < 0.0 { (-cos, -1.0) } else { (cos, 1.0) };
    let (near, far) = if cos > STRAIGHT {
        (1.0 - fraction, fraction)
    } else {
        let angle = cos.min(1.0).acos();
        (((1.0 - fraction) * angle).sin() / angle.sin(), (fraction * angle).sin() / angle.sin())
    };
    let mut q: [f64; 4] = std::array::from_fn(|i| near * a[i] + sign * far * b[i]);
    let length = dot(&q, &q).sqrt();
    q.iter_mut().for_each(|x| *x /= length);
    Some(q)
}
