//! Which instructions the processor has; brightness, YUYV and mosaics of colour filters with AVX2.
//!
//! Invariant: an [`Avx2`] exists only where the processor has AVX2 and POPCNT; memory is read and written
//! through references to arrays of exactly the size that is moved.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use core::arch::x86_64::*;

/// Proof that the processor has AVX2 and POPCNT. A plugin file is built for any x86-64 and chooses at run
/// time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Avx2(());

impl Avx2 {
    /// The proof, where there is one to be had.
    pub fn detect() -> Option<Avx2> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("popcnt") {
            return Some(Avx2(()));
        }
        None
    }

    /// Brightness of the pixels that fill whole vectors; says how many these are.
    #[cfg(target_arch = "x86_64")]
    pub(crate) fn luma(self, rgb: &[u8], gray: &mut [u8]) -> usize {
        // SAFETY: `self` exists only where the processor has AVX2.
        unsafe { luma_avx2(rgb, gray) }
    }

    #[cfg(not(target_arch = "x86_64"))]
    pub(crate) fn luma(self, _: &[u8], _: &mut [u8]) -> usize {
        0
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
fn load16(from: &[u8; 16]) -> __m128i {
    // SAFETY: a reference to 16 bytes may be read; the load needs no alignment.
    unsafe { _mm_loadu_si128(from.as_ptr().cast()) }
}

/// Weights are applied to pixel − 128, so that each sum fits 16 bits: 256 · (−128) … 256 · 127.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn luma_avx2(rgb: &[u8], gray: &mut [u8]) -> usize {
    // Four pixels of each half to R G R G R G R G B 0 B 0 B 0 B 0; a shuffle index with its high bit set
    // gives 0.
    let z = -128i8;
    let split = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 3, 4, 6, 7, 9, 10, 2, z, 5, z, 8, z, 11, z));
    let [r, g, b] = crate::weights::LUMA.map(|w| w as u8 as i8);
    let weights = _mm256_broadcastsi128_si256(_mm_setr_epi8(r, g, r, g, r, g, r, g, b, 0, b, 0, b, 0, b, 0));
    let sign = _mm256_set1_epi8(z);
    let half = _mm256_set1_epi16(128);
    // Reads reach 4 bytes behind the 96 of 32 pixels, so the last ones are left to the caller.
    let whole = rgb.len().saturating_sub(4) / 96;
    let whole = whole.min(gray.len() / 32);
    for n in 0..whole {
        let Some(from) = rgb.get(96 * n..).and_then(|rest| rest.first_chunk::<100>()) else { return 32 * n };
        let Some(to) = gray.get_mut(32 * n..).and_then(|rest| rest.first_chunk_mut::<32>()) else {
            return 32 * n;
        };
        let quarter = |first: usize, second: usize| {
            let at = |px: usize| {
                // Within the 100 bytes: px is at most 28.
                match from[3 * px..].first_chunk::<16>() {
                    Some(bytes) => load16(bytes),
                    None => _mm_setzero_si128(),
                }
            };
            let pixels = _mm256_xor_si256(_mm256_set_m128i(at(second), at(first)), sign);
            // The weight is 0, too, where the shuffle gives 0.
            _mm256_maddubs_epi16(weights, _mm256_shuffle_epi8(pixels, split))
        };
        let sixteen = |px: usize| {
            let (a, b) = (quarter(px, px + 8), quarter(px + 4, px + 12));
            let sum = _mm256_add_epi16(_mm256_unpacklo_epi64(a, b), _mm256_unpackhi_epi64(a, b));
            _mm256_srai_epi16::<8>(_mm256_add_epi16(sum, half))
        };
        let packed = _mm256_permute4x64_epi64::<0xD8>(_mm256_packs_epi16(sixteen(0), sixteen(16)));
        let bright = _mm256_xor_si256(packed, sign);
        // SAFETY: `to` is a reference to 32 writable bytes; the store needs no alignment.
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), bright) }
    }
    32 * whole
}

/// Makes RGB pixels (BGR when `bgr`) of YUYV ones, eight at a time, as `yuyv::pixel` does; says how many.
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
    use crate::weights::{BU, GU, GV, RV, Y};
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

/// Makes RGB pixels of a row of a sensor from column 2 on, sixteen at a time, as `debayer::row` does; says
/// how many.
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
fn bytes16(vector: __m128i) -> [u8; 16] {
    let mut bytes = [0; 16];
    // SAFETY: 16 writable bytes; the store needs no alignment.
    unsafe { _mm_storeu_si128(bytes.as_mut_ptr().cast(), vector) };
    bytes
}
