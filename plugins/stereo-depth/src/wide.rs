//! Choosing the best disparity from vectors of sums, with AVX2.
//!
//! Invariant: sums lie as `unpack` of bytes leaves them: of each 32 disparities the first vector has 0–7 and
//! 16–23, the second 8–15 and 24–31; `packs` puts them in order again. Results are those of `rows::pick`.

use core::arch::x86_64::*;
use core::hint::select_unpredictable;

use crate::rows::{Found, found, rival_limit};
use crate::simd::{Block, store};

/// Sums of all disparities of a pixel.
pub(crate) type Sums<const NV: usize> = [[__m256i; 2]; NV];

/// Place of the sum of a disparity: vector, half and lane.
#[inline(always)]
fn place(d: usize) -> (usize, usize, usize) {
    (d / 32, (d >> 3) & 1, ((d >> 4) & 1) * 8 + (d & 7))
}

/// The disparity of every place.
#[target_feature(enable = "avx2")]
#[inline]
fn disparities<const NV: usize>() -> Sums<NV> {
    core::array::from_fn(|k| {
        core::array::from_fn(|half| {
            let first = (32 * k + 8 * half) as i16;
            let low = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23);
            _mm256_add_epi16(low, _mm256_set1_epi16(first))
        })
    })
}

/// The best disparity up to `most`; see `rows::pick`.
#[target_feature(enable = "avx2,popcnt")]
#[inline]
pub(crate) fn pick<const NV: usize>(sums: &Sums<NV>, most: usize, uniqueness: u8) -> Found {
    let mut sums = *sums;
    if most < 32 * NV - 1 {
        let last = _mm256_set1_epi16(most as i16);
        let d = disparities::<NV>();
        for k in 0..NV {
            for half in 0..2 {
                let beyond = _mm256_cmpgt_epi16(d[k][half], last);
                sums[k][half] = _mm256_or_si256(sums[k][half], beyond);
            }
        }
    }
    let mut low = _mm256_min_epu16(sums[0][0], sums[0][1]);
    for [a, b] in &sums[1..] {
        low = _mm256_min_epu16(low, _mm256_min_epu16(*a, *b));
    }
    let halves = _mm_min_epu16(_mm256_castsi256_si128(low), _mm256_extracti128_si256::<1>(low));
    let least = _mm_minpos_epu16(halves);
    let least_all = _mm256_broadcastw_epi16(least);
    let least = _mm_cvtsi128_si32(least) as u16;

    // `packs` leaves a zero where a sum is the limit or less: every other 16-bit number becomes one that is
    // not.
    let zero = _mm256_setzero_si256();
    let zeros = |a: __m256i, b: __m256i| {
        _mm256_movemask_epi8(_mm256_cmpeq_epi8(_mm256_packs_epi16(a, b), zero)) as u32
    };
    let mut best = 0;
    for (k, [a, b]) in sums.iter().enumerate().rev() {
        let bits = zeros(_mm256_sub_epi16(*a, least_all), _mm256_sub_epi16(*b, least_all));
        // Which vector has the best one cannot be foretold: no branch.
        best = select_unpredictable(bits != 0, 32 * k + bits.trailing_zeros() as usize, best);
    }

    let mut memory = [[Block::ZERO; 2]; NV];
    for k in 0..NV {
        store(&mut memory[k][0], sums[k][0]);
        store(&mut memory[k][1], sums[k][1]);
    }
    let sum = |d: usize| {
        let (k, half, lane) = place(d);
        let bytes = &memory[k][half].0;
        u16::from_le_bytes([bytes[2 * lane], bytes[2 * lane + 1]])
    };
    let below = (best > 0).then(|| sum(best - 1));
    let above = (best < most.min(32 * NV - 1)).then(|| sum(best + 1));

    let found = found(best, least, below, above);
    if uniqueness == 0 {
        return found;
    }
    let limit = rival_limit(least, uniqueness);
    let limit_all = _mm256_set1_epi16(limit as i16);
    let mut near = 0;
    for [a, b] in &sums {
        near += zeros(_mm256_subs_epu16(*a, limit_all), _mm256_subs_epu16(*b, limit_all)).count_ones();
    }
    let own = |sum: Option<u16>| u32::from(sum.is_some_and(|sum| sum <= limit));
    select_unpredictable(near > 1 + own(below) + own(above), Found::NOTHING, found)
}
