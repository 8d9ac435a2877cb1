//! The horizontal Sobel filter that makes block matching blind to brightness.
//!
//! Invariant: results are 0 to `2 * CAP`, `CAP` being no slope; outside of the image everything is like its
//! rim.

/// Largest slope that counts.
pub(crate) const CAP: i16 = 31;

/// Filters one row of `rows` (above, itself, below) into `to`. Slopes are negated when `mirrored`, so that a
/// mirrored image gives the mirrored result.
#[inline(always)]
pub(crate) fn sobel_row(rows: [&[u8]; 3], mirrored: bool, to: &mut [u8]) {
    let width = to.len();
    let [above, row, below] = rows.map(|r| &r[..width]);
    to[0] = CAP as u8;
    to[width - 1] = CAP as u8;
    if width < 3 {
        return;
    }
    let sign: i16 = if mirrored { -1 } else { 1 };
    let n = width - 2;
    let (al, ar) = (&above[..n], &above[2..][..n]);
    let (rl, rr) = (&row[..n], &row[2..][..n]);
    let (bl, br) = (&below[..n], &below[2..][..n]);
    for (x, to) in to[1..][..n].iter_mut().enumerate() {
        let side = |r: &[u8], l: &[u8]| i16::from(r[x]) - i16::from(l[x]);
        let slope = side(ar, al) + 2 * side(rr, rl) + side(br, bl);
        *to = ((sign * slope).clamp(-CAP, CAP) + CAP) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_row_has_no_slope_and_an_edge_is_cut_at_the_cap() {
        let (flat, edge) = ([9; 5], [0, 0, 0, 255, 255]);
        let mut to = [0; 5];
        sobel_row([&flat, &flat, &flat], false, &mut to);
        assert_eq!(to, [31; 5]);
        sobel_row([&edge, &edge, &edge], false, &mut to);
        assert_eq!(to, [31, 31, 62, 62, 31]);
        sobel_row([&flat, &[1, 1, 3, 2, 2], &flat], false, &mut to);
        assert_eq!(to, [31, 35, 33, 29, 31]);
    }

    #[test]
    fn a_mirrored_image_gives_the_mirrored_result() {
        let row = [3, 50, 7, 7, 90, 100, 255];
        let mirrored: Vec<u8> = row.iter().rev().copied().collect();
        let (mut one, mut other) = ([0; 7], [0; 7]);
        sobel_row([&row, &row, &row], false, &mut one);
        sobel_row([&mirrored, &mirrored, &mirrored], true, &mut other);
        other.reverse();
        assert_eq!(one, other);
    }
}
