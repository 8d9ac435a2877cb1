//! Which instructions the processor has, and the brightness of 32 pixels at once with AVX2.
//!
//! Invariant: an [`Avx2`] exists only where the processor has AVX2 and POPCNT; memory is read and written through
//! references to arrays of exactly the size that is moved.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use core::arch::x86_64::*;

/// Proof that the processor has AVX2 and POPCNT. A plugin file is built for any x86-64 and chooses at run time.
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
    // Four pixels of each half to R G R G R G R G B 0 B 0 B 0 B 0; a shuffle index with its high bit set gives 0.
    let z = -128i8;
    let split = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 3, 4, 6, 7, 9, 10, 2, z, 5, z, 8, z, 11, z));
    let [r, g, b] = crate::luma::WEIGHTS.map(|w| w as u8 as i8);
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
            // Where the shuffle gives 0, the weight is 0, too.
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
