//! Payloads of the OCT components that no other device has.
//!
//! Invariant: plain numbers; whether they make sense is for the command that takes them.

use trocar_sdk::prelude::*;

/// Dispersion to take out: `φ = a2 x² + a3 x³`, x from −1 at the smallest wavenumber to 1 at the largest.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct DispersionTerms {
    #[unit("rad")]
    pub a2: f64,
    #[unit("rad")]
    pub a3: f64,
}

/// Result of a search for the dispersion.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct DispersionFound {
    #[unit("rad")]
    pub a2: f64,
    #[unit("rad")]
    pub a3: f64,
    /// Mean over the lines of the sum of |A|⁴ over the squared sum of |A|²: 1 = all light in one bin.
    pub sharpness: f64,
    /// False: the lines showed nothing that could be sharp, or it lies at the edge, and the dispersion stays
    /// as it was.
    pub taken: Flag,
    /// The sharpest lies at the end of what is looked at, ±60 rad for a2 and ±20 rad for a3: the true one may
    /// be beyond.
    pub at_edge: Flag,
    pub reserved: [u8; 6],
}

/// Levels of black and white in an A-scan of bytes, dB re one count squared.
#[derive(Payload, Clone, Copy, Default, Debug, PartialEq)]
#[repr(C)]
pub struct RangeDb {
    pub low: f64,
    pub high: f64,
}
