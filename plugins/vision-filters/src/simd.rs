//! Remapping, YUYV and Bayer sensors with AVX2.
//!
//! Invariant: an [`Avx2`] proves that the processor has the instructions; memory is read through checked slices only.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use core::arch::x86_64::*;

pub(crate) use trocar_imaging::simd::Avx2;

use crate::remap::Tap;

/// Makes RGB pixels of `taps`, all of them inside of `bytes`, rows of which begin every `stride` bytes. Says how many
/// were made: whole fours, and none where a tap is not inside after all.
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
    // Of two pixels above and two below: all four reds, greens, blues; each left above, right above, left below, …
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

/// Makes RGB pixels (BGR when `bgr`) of YUYV ones, eight at a time, as `color::yuv` does; says how many.
#[cfg(target_arch = "x86_64")]
pub(crate) fn yuyv(_: Avx2, src: &[u8], bgr: bool, dst: &mut [u8]) -> usize {
    // SAFETY: an `Avx2` exists only where the processor has AVX2.
    unsafe { yuyv_avx2(src, bgr, dst) }
}

#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn yuyv(_: Avx2, _: &[u8], _: bool, _: &mut [u8]) -> usize {
    0
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn yuyv_avx2(src: &[u8], bgr: bool, dst: &mut [u8]) -> usize {
    use crate::color::{BU, GU, GV, RV, Y};
    let z = -1i8;
    let bright = _mm_setr_epi8(0, 2, 4, 6, 8, 10, 12, 14, z, z, z, z, z, z, z, z);
    let blueish = _mm_setr_epi8(1, 1, 5, 5, 9, 9, 13, 13, z, z, z, z, z, z, z, z);
    let reddish = _mm_setr_epi8(3, 3, 7, 7, 11, 11, 15, 15, z, z, z, z, z, z, z, z);
    // Four reds, greens, blues to four pixels.
    let order = if bgr {
        _mm_setr_epi8(8, 4, 0, 9, 5, 1, 10, 6, 2, 11, 7, 3, z, z, z, z)
    } else {
        _mm_setr_epi8(0, 4, 8, 1, 5, 9, 2, 6, 10, 3, 7, 11, z, z, z, z)
    };
    let order = _mm256_broadcastsi128_si256(order);
    let times = |v: __m256i, factor: i32| _mm256_mullo_epi32(v, _mm256_set1_epi32(factor));
    let mut done = 0;
    for (from, to) in src.as_chunks::<16>().0.iter().zip(dst.as_chunks_mut::<24>().0) {
        let from = load16(from);
        let at = |places: __m128i, less: i32| {
            _mm256_sub_epi32(_mm256_cvtepu8_epi32(_mm_shuffle_epi8(from, places)), _mm256_set1_epi32(less))
        };
        let light = times(_mm256_max_epi32(at(bright, 16), _mm256_setzero_si256()), Y);
        let light = _mm256_add_epi32(light, _mm256_set1_epi32(1 << 19));
        let (u, v) = (at(blueish, 128), at(reddish, 128));
        let level = |tint: __m256i| _mm256_srai_epi32::<20>(_mm256_add_epi32(light, tint));
        let red = level(times(v, RV));
        let green = level(_mm256_add_epi32(times(v, GV), times(u, GU)));
        let blue = level(times(u, BU));
        let words = _mm256_packus_epi16(_mm256_packs_epi32(red, green), _mm256_packs_epi32(blue, blue));
        let pixels = _mm256_shuffle_epi8(words, order);
        let (first, second) = to.split_at_mut(12);
        first.copy_from_slice(&bytes16(_mm256_castsi256_si128(pixels))[..12]);
        second.copy_from_slice(&bytes16(_mm256_extracti128_si256::<1>(pixels))[..12]);
        done += 8;
    }
    done
}

/// Makes RGB pixels of a row of a sensor from column 2 on, sixteen at a time, as `debayer::row` does; says how many.
#[cfg(target_arch = "x86_64")]
pub(crate) fn debayer(_: Avx2, rows: [&[u8]; 3], odd: bool, to: &mut [[u8; 3]]) -> usize {
    // SAFETY: an `Avx2` exists only where the processor has AVX2.
    unsafe { debayer_avx2(rows, odd, to) }
}

#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn debayer(_: Avx2, _: [&[u8]; 3], _: bool, _: &mut [[u8; 3]]) -> usize {
    0
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn debayer_avx2(rows: [&[u8]; 3], odd: bool, to: &mut [[u8; 3]]) -> usize {
    let z = -1i8;
    let both = |pattern: __m128i| _mm256_broadcastsi128_si256(pattern);
    // Eight reds and eight greens to their places in eight pixels, 16 bytes and 8; blues likewise.
    let red_green = both(_mm_setr_epi8(0, 8, z, 1, 9, z, 2, 10, z, 3, 11, z, 4, 12, z, 5));
    let red_green_end = both(_mm_setr_epi8(13, z, 6, 14, z, 7, 15, z, z, z, z, z, z, z, z, z));
    let blue_only = both(_mm_setr_epi8(z, z, 0, z, z, 1, z, z, 2, z, z, 3, z, z, 4, z));
    let blue_end = both(_mm_setr_epi8(z, 5, z, z, 6, z, z, 7, z, z, z, z, z, z, z, z));
    let one = _mm256_set1_epi16(1);
    let two = _mm256_set1_epi16(2);
    let mut done = 0;
    for to in to.as_chunks_mut::<16>().0 {
        let first = 2 + done;
        let words = |row: usize, from: usize| {
            let bytes = rows[row].get(from..)?.first_chunk::<16>()?;
            Some(_mm256_cvtepu8_epi16(load16(bytes)))
        };
        let three = |row: usize| Some([words(row, first - 1)?, words(row, first)?, words(row, first + 1)?]);
        let (Some(above), Some(here), Some(below)) = (three(0), three(1), three(2)) else { return done };
        let add = |a: __m256i, b: __m256i| _mm256_add_epi16(a, b);
        let side_sum = add(here[0], here[2]);
        let end_sum = add(above[1], below[1]);
        let corner_sum = add(add(above[0], above[2]), add(below[0], below[2]));
        let sides = _mm256_srli_epi16::<1>(add(side_sum, one));
        let ends = _mm256_srli_epi16::<1>(add(end_sum, one));
        let cross = _mm256_srli_epi16::<2>(add(add(side_sum, end_sum), two));
        let corners = _mm256_srli_epi16::<2>(add(corner_sum, two));
        // The first pixel is in an even column.
        let turns = |even: __m256i, odd: __m256i| _mm256_blend_epi16::<0xAA>(even, odd);
        let own = here[1];
        let [red, green, blue] = if odd {
            [turns(ends, corners), turns(own, cross), turns(sides, own)]
        } else {
            [turns(own, sides), turns(cross, own), turns(corners, ends)]
        };
        let rg = _mm256_packus_epi16(red, green);
        let b = _mm256_packus_epi16(blue, blue);
        let begin = _mm256_or_si256(_mm256_shuffle_epi8(rg, red_green), _mm256_shuffle_epi8(b, blue_only));
        let end = _mm256_or_si256(_mm256_shuffle_epi8(rg, red_green_end), _mm256_shuffle_epi8(b, blue_end));
        let to = to.as_flattened_mut();
        let halves = [
            (_mm256_castsi256_si128(begin), _mm256_castsi256_si128(end)),
            (_mm256_extracti128_si256::<1>(begin), _mm256_extracti128_si256::<1>(end)),
        ];
        for (to, (begin, end)) in to.chunks_exact_mut(24).zip(halves) {
            to[..16].copy_from_slice(&bytes16(begin));
            to[16..].copy_from_slice(&bytes16(end)[..8]);
        }
        done += 16;
    }
    done
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn load16(from: &[u8; 16]) -> __m128i {
    // SAFETY: a reference to 16 readable bytes; the load needs no alignment.
    unsafe { _mm_loadu_si128(from.as_ptr().cast()) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn bytes16(vector: __m128i) -> [u8; 16] {
    let mut bytes = [0; 16];
    // SAFETY: 16 writable bytes; the store needs no alignment.
    unsafe { _mm_storeu_si128(bytes.as_mut_ptr().cast(), vector) };
    bytes
}
