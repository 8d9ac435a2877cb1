//! Settings of a matcher: method, range and strictness.
//!
//! Invariant: settings that pass `check` overflow no sum of the matchers.

use std::fmt;

/// Widest range of disparities, px.
pub(crate) const MAX_DISPARITIES: usize = 256;
/// Largest window: 31 · 31 · 62 is the largest that fits 16 bits.
pub(crate) const MAX_BLOCK: usize = 31;
/// Largest penalty: costs along two paths, 2 · (24 + 103), fit a byte.
pub(crate) const MAX_P2: u8 = 103;

/// Method by which a pixel finds its partner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Sum of absolute differences over a window; fast, blind where there is no texture.
    Bm,
    /// Semi-global matching (Hirschmüller 2008) of a 5×5 census over five paths; denser and slower.
    Sgm,
}

/// Settings of a matcher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Method of the matching.
    pub method: Method,
    /// Disparities looked at: 0 to `n_disp` − 1 px. A multiple of 32, up to 256.
    pub n_disp: usize,
    /// Side of the window of `Bm`, px; odd, 5 to 31.
    pub block: usize,
    /// Penalty of `Sgm` for a step of one disparity.
    pub p1: u8,
    /// Its penalty for a larger step; at least `p1`, up to 103.
    pub p2: u8,
    /// By how much the best cost must beat every other one but its neighbours', %.
    pub uniqueness: u8,
    /// Least mean contrast in the window of `Bm`, in 1/100 of a prefiltered level per pixel.
    pub texture: u16,
    /// Most that left and right may disagree, px; negative: not compared.
    pub consistency: i16,
    /// Depth is not known where the left image is darker than this many levels, and as far around as a window
    /// reaches; 0: nowhere.
    pub dark: u8,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            method: Method::Sgm,
            n_disp: 96,
            block: 15,
            p1: 8,
            p2: 40,
            uniqueness: 10,
            texture: 5,
            consistency: 1,
            dark: 0,
        }
    }
}

impl Settings {
    /// Whether images of this size can be matched so.
    ///
    /// # Errors
    /// Names the setting, its limits and what was given.
    pub fn check(&self, width: usize, height: usize) -> Result<(), BadSettings> {
        let Settings { n_disp, block, p1, p2, uniqueness, .. } = *self;
        if n_disp == 0 || n_disp % 32 != 0 || n_disp > MAX_DISPARITIES {
            return Err(BadSettings::Disparities { n_disp });
        }
        if block % 2 == 0 || !(5..=MAX_BLOCK).contains(&block) {
            return Err(BadSettings::Block { block });
        }
        if p1 == 0 || p1 > p2 || p2 > MAX_P2 {
            return Err(BadSettings::Penalties { p1, p2 });
        }
        if uniqueness > 50 {
            return Err(BadSettings::Uniqueness { uniqueness });
        }
        if width < block || height < block || width > 16_384 || height > 16_384 {
            return Err(BadSettings::Size { width, height, block });
        }
        Ok(())
    }
}

/// Why settings are refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadSettings {
    /// Not a whole number of vectors.
    Disparities {
        /// px.
        n_disp: usize,
    },
    /// No middle, or outside of the limits.
    Block {
        /// px.
        block: usize,
    },
    /// In the wrong order or outside of the limits.
    Penalties {
        /// For one step.
        p1: u8,
        /// For more.
        p2: u8,
    },
    /// Above half.
    Uniqueness {
        /// %.
        uniqueness: u8,
    },
    /// Images smaller than the window, or beyond what a header may say.
    Size {
        /// px.
        width: usize,
        /// px.
        height: usize,
        /// px.
        block: usize,
    },
}

impl fmt::Display for BadSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            BadSettings::Disparities { n_disp } => {
                write!(f, "n_disp: {n_disp} is not a multiple of 32 from 32 to {MAX_DISPARITIES} px")?;
                let near = n_disp.clamp(32, MAX_DISPARITIES).next_multiple_of(32);
                write!(f, ": take {near}")
            }
            BadSettings::Block { block } => {
                write!(f, "block: {block} px is not an odd number from 5 to {MAX_BLOCK}")
            }
            BadSettings::Penalties { p1, p2 } => {
                write!(f, "p1: {p1} and p2: {p2} are not 1 ≤ p1 ≤ p2 ≤ {MAX_P2}")
            }
            BadSettings::Uniqueness { uniqueness } => write!(f, "uniqueness: {uniqueness} % is above 50 %"),
            BadSettings::Size { width, height, block } => {
                write!(f, "images of {width} × {height} px: a side must have {block} (the block) to 16384 px")
            }
        }
    }
}

impl std::error::Error for BadSettings {}
