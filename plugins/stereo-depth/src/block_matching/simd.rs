//! Block matching with AVX2, 32 disparities at a time.
//!
//! Invariant: gives what `plain` gives. A difference of two absolute differences fits a signed byte, as
//! prefiltered values are at most 62.
#![allow(unsafe_code)]

use core::arch::x86_64::*;

use trocar_imaging::simd::Avx2;

use crate::rows::{BlockRow, Found};
use crate::simd::{Block, load, load_bytes, store};
use crate::wide::{Sums, pick};

/// One row over `32 * vectors` disparities; `columns` has two blocks for each pixel and
/// vector.
pub(super) fn row(_: Avx2, vectors: usize, columns: &mut [[Block; 2]], row: &BlockRow<'_>, to: &mut [Found]) {
    // SAFETY: an `Avx2` exists only where the processor has AVX2 and POPCNT.
    unsafe {
        match vectors {
            1 => row_avx2::<1>(columns, row, to),
            2 => row_avx2::<2>(columns, row, to),
            3 => row_avx2::<3>(columns, row, to),
            4 => row_avx2::<4>(columns, row, to),
            5 => row_avx2::<5>(columns, row, to),
            6 => row_avx2::<6>(columns, row, to),
            7 => row_avx2::<7>(columns, row, to),
            _ => row_avx2::<8>(columns, row, to),
        }
    }
}

/// Lets a row enter and one leave; fills `to` where windows are full. `columns` has `NV` entries for each
/// pixel.
#[target_feature(enable = "avx2,popcnt")]
fn row_avx2<const NV: usize>(columns: &mut [[Block; 2]], row: &BlockRow<'_>, to: &mut [Found]) {
    let block = row.block;
    let [new_left, new_right] = row.enters;
    let [old_left, old_right] = row.leaves;
    let width = new_left.len();
    let zero = _mm256_setzero_si256();
    let mut sums: Sums<NV> = [[zero; 2]; NV];
    for x in 0..width {
        let at = width - 1 - x;
        let (before, here) = columns.split_at_mut(x * NV);
        let left = x.checked_sub(block).and_then(|gone| before[gone * NV..].first_chunk::<NV>());
        let Some(column) = here.first_chunk_mut::<NV>() else { return };
        let new = _mm256_set1_epi8(new_left[x] as i8);
        let old = _mm256_set1_epi8(old_left[x] as i8);
        let (news, olds) = (new_right[at..].as_chunks::<32>().0, old_right[at..].as_chunks::<32>().0);
        let (news, olds) = (&news[..NV], &olds[..NV]);
        for k in 0..NV {
            let enters = difference(new, load_bytes(&news[k]));
            let leaves = difference(old, load_bytes(&olds[k]));
            let change = _mm256_sub_epi8(enters, leaves);
            let sign = _mm256_cmpgt_epi8(zero, change);
            let low = _mm256_add_epi16(load(&column[k][0]), _mm256_unpacklo_epi8(change, sign));
            let high = _mm256_add_epi16(load(&column[k][1]), _mm256_unpackhi_epi8(change, sign));
            store(&mut column[k][0], low);
            store(&mut column[k][1], high);
            sums[k] = [_mm256_add_epi16(sums[k][0], low), _mm256_add_epi16(sums[k][1], high)];
        }
        if let Some(left) = left {
            for (sums, left) in sums.iter_mut().zip(left) {
                *sums =
                    [_mm256_sub_epi16(sums[0], load(&left[0])), _mm256_sub_epi16(sums[1], load(&left[1]))];
            }
        }
        if x + 1 < block || row.textured.is_empty() {
            continue;
        }
        let centre = x - block / 2;
        to[centre] = if row.textured[centre] {
            pick::<NV>(&sums, (centre - block / 2).min(32 * NV - 1), row.uniqueness)
        } else {
            Found::NOTHING
        };
    }
}

#[target_feature(enable = "avx2")]
#[inline]
fn difference(a: __m256i, b: __m256i) -> __m256i {
    _mm256_sub_epi8(_mm256_max_epu8(a, b), _mm256_min_epu8(a, b))
}
