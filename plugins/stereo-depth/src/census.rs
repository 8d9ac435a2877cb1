//! The 5×5 census: for each pixel 24 bits, one for each neighbour that is darker.
//!
//! Invariant: the three bytes of a pixel lie in three planes, bits in a fixed order of the neighbours; a
//! mirrored image with `mirrored` set gives the same bits mirrored.

/// Pixels that a census reaches to each side.
pub(crate) const REACH: usize = 2;

/// The census of one row into three planes of as many pixels. `rows` are those two above to two below, each
/// [`REACH`] pixels longer to both sides than the planes.
#[inline(always)]
pub(crate) fn census_row(rows: [&[u8]; 5], mirrored: bool, planes: [&mut [u8]; 3]) {
    let width = planes[0].len();
    let centre = &rows[REACH][REACH..][..width];
    for (plane, to) in planes.into_iter().enumerate() {
        let neighbours: [&[u8]; 8] = core::array::from_fn(|bit| {
            // 0 to 23 without the centre, which would be 12.
            let n = 8 * plane + bit;
            let n = n + usize::from(n >= 12);
            let (dy, dx) = (n / 5, n % 5);
            &rows[dy][if mirrored { 4 - dx } else { dx }..][..width]
        });
        let to = &mut to[..width];
        for x in 0..width {
            let mut bits = 0;
            for (bit, row) in neighbours.iter().enumerate() {
                bits |= u8::from(row[x] < centre[x]) << bit;
            }
            to[x] = bits;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn census(image: &[[u8; 5]; 5], mirrored: bool) -> [u8; 3] {
        let mut planes = [[0; 1]; 3];
        let [a, b, c] = &mut planes;
        census_row(core::array::from_fn(|y| &image[y][..]), mirrored, [a, b, c]);
        planes.map(|[p]| p)
    }

    #[test]
    fn every_darker_neighbour_has_its_own_bit() {
        let mut seen = 0u32;
        for n in (0..25).filter(|&n| n != 12) {
            let mut image = [[9; 5]; 5];
            image[n / 5][n % 5] = 8;
            let [a, b, c] = census(&image, false);
            let bits = u32::from_le_bytes([a, b, c, 0]);
            assert_eq!(bits.count_ones(), 1, "neighbour {n}");
            assert_eq!(seen & bits, 0, "neighbour {n} has a bit of its own");
            seen |= bits;
        }
        assert_eq!(seen, 0xff_ffff);
        assert_eq!(census(&[[9; 5]; 5], false), [0; 3], "equal is not darker");
    }

    #[test]
    fn a_mirrored_image_gives_the_same_bits() {
        let mut image = [[0u8; 5]; 5];
        image.iter_mut().flatten().enumerate().for_each(|(n, p)| *p = (n * 37 % 101) as u8);
        let mut mirrored = image;
        mirrored.iter_mut().for_each(|row| row.reverse());
        assert_eq!(census(&image, false), census(&mirrored, true));
    }
}
