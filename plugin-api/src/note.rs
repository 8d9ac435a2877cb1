//! The ELF note that carries a plugin's manifest.
//!
//! Invariant: readers find it by section `.note.trocar` or by PT_NOTE, name `TROCAR\0`, type 1; the text is
//! JSON.

/// Section of the note.
pub const SECTION: &str = ".note.trocar";
/// Owner name, with its terminating zero.
pub const OWNER: &[u8; 7] = b"TROCAR\0";
/// Note type of a manifest.
pub const TYPE_MANIFEST: u32 = 1;

/// The note as it lies in the file; `N` is the length of the manifest rounded up to 4 (padded with spaces).
#[repr(C, align(4))]
pub struct Note<const N: usize> {
    /// Bytes of the name, its zero included.
    pub name_size: u32,
    /// Bytes of the manifest with its padding.
    pub desc_size: u32,
    /// [`TYPE_MANIFEST`].
    pub kind: u32,
    /// [`OWNER`], padded to a multiple of 4.
    pub name: [u8; 8],
    /// The manifest, JSON.
    pub desc: [u8; N],
}

impl<const N: usize> Note<N> {
    /// Makes the note of a manifest.
    ///
    /// # Panics
    /// `N` is not a multiple of 4.
    pub const fn new(desc: [u8; N]) -> Self {
        assert!(N.is_multiple_of(4), "pad the manifest to a multiple of 4 bytes");
        Note {
            name_size: OWNER.len() as u32,
            desc_size: N as u32,
            kind: TYPE_MANIFEST,
            name: *b"TROCAR\0\0",
            desc,
        }
    }
}
