//! Semi-global matching with AVX2, 32 disparities at a time.
//!
//! Invariant: gives what `plain` gives. Costs along two paths fit a byte together (`settings::MAX_P2`).
#![allow(unsafe_code)]

use core::arch::x86_64::*;

use trocar_imaging::simd::Avx2;

use crate::rows::{CensusRow, Found};
use crate::simd::{Block, load, load_bytes, store};
use crate::wide::{Sums, pick};

/// Costs of all disparities of a pixel.
type Costs<const NV: usize> = [__m256i; NV];

/// Costs along the paths, and what one row needs.
pub(crate) struct Wide {
    vectors: usize,
    /// Along the three paths from above, pixel after pixel, with one of zeros at both ends; the row above and
    /// this one.
    rows: [Vec<Block>; 2],
    /// The least of each of them.
    least: [Vec<[u8; 3]>; 2],
    costs: Vec<Block>,
    sums: Vec<[Block; 2]>,
}

impl Wide {
    pub(crate) fn new(width: usize, vectors: usize) -> Self {
        Wide {
            vectors,
            rows: core::array::from_fn(|_| vec![Block::ZERO; 3 * vectors * (width + 2)]),
            least: core::array::from_fn(|_| vec![[0; 3]; width + 2]),
            costs: vec![Block::ZERO; vectors * width],
            sums: vec![[Block::ZERO; 2]; vectors * width],
        }
    }

    pub(crate) fn reset(&mut self) {
        self.rows[0].fill(Block::ZERO);
        self.least[0].fill([0; 3]);
    }
}

/// Works on one row over `32 * vectors` disparities.
pub(super) fn row(_: Avx2, vectors: usize, state: &mut Wide, row: &CensusRow<'_>, to: &mut [Found]) {
    // SAFETY: an `Avx2` exists only where the processor has AVX2 and POPCNT.
    unsafe {
        match vectors {
            1 => row_avx2::<1>(state, row, to),
            2 => row_avx2::<2>(state, row, to),
            3 => row_avx2::<3>(state, row, to),
            4 => row_avx2::<4>(state, row, to),
            5 => row_avx2::<5>(state, row, to),
            6 => row_avx2::<6>(state, row, to),
            7 => row_avx2::<7>(state, row, to),
            _ => row_avx2::<8>(state, row, to),
        }
    }
}

#[target_feature(enable = "avx2,popcnt")]
fn row_avx2<const NV: usize>(state: &mut Wide, row: &CensusRow<'_>, to: &mut [Found]) {
    debug_assert_eq!(state.vectors, NV);
    let width = to.len();
    let zero = _mm256_setzero_si256();
    let (p1, p2) = (_mm256_set1_epi8(row.p1 as i8), _mm256_set1_epi8(row.p2 as i8));
    let Wide { rows: [above, here], least: [above_least, here_least], costs, sums, .. } = &mut *state;

    let mut along: Costs<NV> = [zero; NV];
    let mut least = zero;
    for x in 0..width {
        let cost = costs_of::<NV>(row, width, x);
        put(&cost, &mut costs[x * NV..]);
        (along, least) = step(&along, least, &cost, p1, p2);
        let mut path = [[zero; NV]; 3];
        for n in 0..3 {
            // From the left above, straight above, the right above: columns are one further on for the zeros.
            let from = x + n;
            let before = get::<NV>(&above[(3 * from + n) * NV..]);
            let before_least = _mm256_set1_epi8(above_least[from][n] as i8);
            let (now, now_least) = step(&before, before_least, &cost, p1, p2);
            put(&now, &mut here[(3 * (x + 1) + n) * NV..]);
            here_least[x + 1][n] = _mm256_extract_epi8::<0>(now_least) as u8;
            path[n] = now;
        }
        for (k, sum) in sums[x * NV..][..NV].iter_mut().enumerate() {
            let one = _mm256_add_epi8(along[k], path[0][k]);
            let other = _mm256_add_epi8(path[1][k], path[2][k]);
            let [a, b] = [one, other].map(|v| [_mm256_unpacklo_epi8(v, zero), _mm256_unpackhi_epi8(v, zero)]);
            store(&mut sum[0], _mm256_add_epi16(a[0], b[0]));
            store(&mut sum[1], _mm256_add_epi16(a[1], b[1]));
        }
    }

    (along, least) = ([zero; NV], zero);
    for x in (0..width).rev() {
        (along, least) = step(&along, least, &get::<NV>(&costs[x * NV..]), p1, p2);
        let mut all: Sums<NV> = [[zero; 2]; NV];
        for (k, sum) in sums[x * NV..][..NV].iter().enumerate() {
            all[k] = [
                _mm256_add_epi16(load(&sum[0]), _mm256_unpacklo_epi8(along[k], zero)),
                _mm256_add_epi16(load(&sum[1]), _mm256_unpackhi_epi8(along[k], zero)),
            ];
        }
        to[x] = pick::<NV>(&all, x.min(32 * NV - 1), row.uniqueness);
    }
    state.rows.swap(0, 1);
    state.least.swap(0, 1);
}

/// Census distances of a pixel.
#[target_feature(enable = "avx2")]
#[inline]
fn costs_of<const NV: usize>(row: &CensusRow<'_>, width: usize, x: usize) -> Costs<NV> {
    let at = width - 1 - x;
    let mut costs = [_mm256_setzero_si256(); NV];
    for plane in 0..3 {
        let own = _mm256_set1_epi8(row.left[plane][x] as i8);
        let others = &row.right[plane][at..].as_chunks::<32>().0[..NV];
        for k in 0..NV {
            let differ = _mm256_xor_si256(own, load_bytes(&others[k]));
            costs[k] = _mm256_add_epi8(costs[k], ones(differ));
        }
    }
    costs
}

/// Counts the bits of each byte that are set.
#[target_feature(enable = "avx2")]
#[inline]
fn ones(v: __m256i) -> __m256i {
    let table = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4));
    let nibble = _mm256_set1_epi8(15);
    let low = _mm256_shuffle_epi8(table, _mm256_and_si256(v, nibble));
    let high = _mm256_shuffle_epi8(table, _mm256_and_si256(_mm256_srli_epi16::<4>(v), nibble));
    _mm256_add_epi8(low, high)
}

/// One step of a path (equation 13 of the paper), and the least of what comes out in every byte.
#[target_feature(enable = "avx2")]
#[inline]
fn step<const NV: usize>(
    before: &Costs<NV>,
    least: __m256i,
    costs: &Costs<NV>,
    p1: __m256i,
    p2: __m256i,
) -> (Costs<NV>, __m256i) {
    let none = _mm256_set1_epi8(-1);
    let far = _mm256_add_epi8(least, p2);
    let mut to = [none; NV];
    let mut all = none;
    for k in 0..NV {
        let lower = if k > 0 { before[k - 1] } else { none };
        let upper = if k + 1 < NV { before[k + 1] } else { none };
        // The costs one disparity below and one above, across the middle of the vector and its ends.
        let under = _mm256_permute2x128_si256::<0x21>(lower, before[k]);
        let over = _mm256_permute2x128_si256::<0x21>(before[k], upper);
        let below = _mm256_alignr_epi8::<15>(before[k], under);
        let above = _mm256_alignr_epi8::<1>(over, before[k]);
        let near = _mm256_adds_epu8(_mm256_min_epu8(below, above), p1);
        let best = _mm256_min_epu8(_mm256_min_epu8(before[k], near), far);
        to[k] = _mm256_add_epi8(costs[k], _mm256_subs_epu8(best, least));
        all = _mm256_min_epu8(all, to[k]);
    }
    let half = _mm_min_epu8(_mm256_castsi256_si128(all), _mm256_extracti128_si256::<1>(all));
    let pairs = _mm_min_epu8(half, _mm_srli_epi16::<8>(half));
    // The upper byte of each pair is 0 now, so the least pair is the least byte.
    (to, _mm256_broadcastb_epi8(_mm_minpos_epu16(pairs)))
}

#[target_feature(enable = "avx2")]
#[inline]
fn get<const NV: usize>(from: &[Block]) -> Costs<NV> {
    let mut costs = [_mm256_setzero_si256(); NV];
    let from = &from[..NV];
    for k in 0..NV {
        costs[k] = load(&from[k]);
    }
    costs
}

#[target_feature(enable = "avx2")]
#[inline]
fn put<const NV: usize>(costs: &Costs<NV>, to: &mut [Block]) {
    let to = &mut to[..NV];
    for k in 0..NV {
        store(&mut to[k], costs[k]);
    }
}
