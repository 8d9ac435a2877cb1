//! The door to AVX2: memory moved in vectors, and the calls of functions that need it.
//!
//! Invariant: an [`Avx2`] proves that the processor has the instructions; memory is read and written through
//! references to exactly the bytes that are moved.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
use core::arch::x86_64::*;

use trocar_imaging::simd::Avx2;

use crate::{census, prefilter};

/// The bytes of one vector.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct Block(pub(crate) [u8; 32]);

impl Block {
    pub(crate) const ZERO: Block = Block([0; 32]);
}

/// Reads a vector.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
pub(crate) fn load(from: &Block) -> __m256i {
    // SAFETY: a reference to 32 readable bytes, aligned to 32.
    unsafe { _mm256_load_si256((&raw const *from).cast()) }
}

/// Writes a vector.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
pub(crate) fn store(to: &mut Block, vector: __m256i) {
    // SAFETY: a reference to 32 writable bytes, aligned to 32.
    unsafe { _mm256_store_si256((&raw mut *to).cast(), vector) }
}

/// Reads a vector from anywhere.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
#[inline]
pub(crate) fn load_bytes(from: &[u8; 32]) -> __m256i {
    // SAFETY: a reference to 32 readable bytes; the load needs no alignment.
    unsafe { _mm256_loadu_si256(from.as_ptr().cast()) }
}

/// [`prefilter::sobel_row`] with what the processor has.
pub(crate) fn sobel_row(lanes: Option<Avx2>, rows: [&[u8]; 3], mirrored: bool, to: &mut [u8]) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn wide(rows: [&[u8]; 3], mirrored: bool, to: &mut [u8]) {
            prefilter::sobel_row(rows, mirrored, to);
        }
        if lanes.is_some() {
            // SAFETY: an `Avx2` exists only where the processor has AVX2.
            return unsafe { wide(rows, mirrored, to) };
        }
    }
    let _ = lanes;
    prefilter::sobel_row(rows, mirrored, to);
}

/// [`census::census_row`] with what the processor has.
pub(crate) fn census_row(lanes: Option<Avx2>, rows: [&[u8]; 5], mirrored: bool, planes: [&mut [u8]; 3]) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn wide(rows: [&[u8]; 5], mirrored: bool, planes: [&mut [u8]; 3]) {
            census::census_row(rows, mirrored, planes);
        }
        if lanes.is_some() {
            // SAFETY: an `Avx2` exists only where the processor has AVX2.
            return unsafe { wide(rows, mirrored, planes) };
        }
    }
    let _ = lanes;
    census::census_row(rows, mirrored, planes);
}

/// Copies a row, mirrored when asked, with what the processor has.
pub(crate) fn copy_row(lanes: Option<Avx2>, from: &[u8], mirrored: bool, to: &mut [u8]) {
    #[inline(always)]
    fn mirror(from: &[u8], to: &mut [u8]) {
        to.iter_mut().zip(from.iter().rev()).for_each(|(to, from)| *to = *from);
    }
    if !mirrored {
        to.copy_from_slice(from);
        return;
    }
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn wide(from: &[u8], to: &mut [u8]) {
            mirror(from, to);
        }
        if lanes.is_some() {
            // SAFETY: an `Avx2` exists only where the processor has AVX2.
            return unsafe { wide(from, to) };
        }
    }
    let _ = lanes;
    mirror(from, to);
}
