//! Remapping with AVX2.
//!
//! Invariant: an [`Avx2`] proves that the processor has the instructions; memory is read through checked
//! slices only.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use core::arch::x86_64::*;

pub(crate) use trocar_imaging::simd::Avx2;

use crate::tap::Tap;

/// Makes RGB pixels of `taps`, all of them inside of `bytes`, rows of which begin every `stride` bytes. Says
/// how many were made: whole fours, and none where a tap is not inside after all.
#[cfg(target_arch = "x86_64")]
pub(crate) fn remap_rgb(_: Avx2, bytes: &[u8], stride: usize, taps: &[Tap], to: &mut [u8]) -> usize {
    // SAFETY: an `Avx2` exists only where the processor has AVX2.
    unsafe { remap_rgb_avx2(bytes, stride, taps, to) }
}

#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn remap_rgb(_: Avx2, _: &[u8], _: usize, _: &[Tap], _: &mut [u8]) -> usize {
    0
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn remap_rgb_avx2(bytes: &[u8], stride: usize, taps: &[Tap], to: &mut [u8]) -> usize {
    // All four reds, greens, blues of two pixels above and two below; each left above, right above, left
    // below, …
    let z = -1i8;
    let gather =
        _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 3, 8, 11, 1, 4, 9, 12, 2, 5, 10, 13, z, z, z, z));
    // Red, green, blue and a gap of two pixels, to two pixels.
    let close = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 2, 4, 5, 6, z, z, z, z, z, z, z, z, z, z));
    let half = _mm256_set1_epi32(512);
    let place_x = _mm256_set_m128i(_mm_set1_epi8(2), _mm_set1_epi8(0));
    let place_y = _mm256_set_m128i(_mm_set1_epi16(-256 + 3), _mm_set1_epi16(-256 + 1));
    let (turn, whole) = (_mm256_set1_epi16(0x01FF), _mm256_set1_epi16(32));
    let (turn_words, whole_words) = (_mm256_set1_epi32(0x0001_FFFF), _mm256_set1_epi32(32));
    let mut done = 0;
    for (taps, to) in taps.as_chunks::<4>().0.iter().zip(to.as_chunks_mut::<12>().0) {
        let four = |tap: &Tap| {
            let at = tap.y as usize * stride + 3 * tap.x as usize;
            let above = bytes.get(at..)?.first_chunk::<8>()?;
            let below = bytes.get(at + stride..)?.first_chunk::<8>()?;
            Some(_mm_set_epi64x(i64::from_le_bytes(*below), i64::from_le_bytes(*above)))
        };
        let two = |one: &Tap, other: &Tap| {
            let pixels = _mm256_shuffle_epi8(_mm256_set_m128i(four(other)?, four(one)?), gather);
            // fx and fy of both, each in its half.
            let part = |tap: &Tap| i32::from(tap.fx) | i32::from(tap.fy) << 8;
            let parts = _mm_cvtsi32_si128(part(one) | part(other) << 16);
            let parts = _mm256_broadcastd_epi32(parts);
            // 32 − fx beside fx, as bytes; 32 − fy beside fy, as words.
            let across = _mm256_sign_epi8(_mm256_shuffle_epi8(parts, place_x), turn);
            let down = _mm256_sign_epi16(_mm256_shuffle_epi8(parts, place_y), turn_words);
            let rows = _mm256_maddubs_epi16(pixels, _mm256_add_epi8(across, whole));
            let sums = _mm256_madd_epi16(rows, _mm256_add_epi16(down, whole_words));
            Some(_mm256_srai_epi32::<10>(_mm256_add_epi32(sums, half)))
        };
        let (Some(even), Some(odd)) = (two(&taps[0], &taps[2]), two(&taps[1], &taps[3])) else { return done };
        let words = _mm256_packs_epi32(even, odd);
        let packed = _mm256_shuffle_epi8(_mm256_packus_epi16(words, words), close);
        let first = _mm_cvtsi128_si64(_mm256_castsi256_si128(packed)) as u64;
        let second = _mm_cvtsi128_si64(_mm256_extracti128_si256::<1>(packed)) as u64;
        let pixels = u128::from(first) | u128::from(second) << 48;
        to.copy_from_slice(&pixels.to_le_bytes()[..12]);
        done += 4;
    }
    done
}
