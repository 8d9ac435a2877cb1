//! No bytes, however damaged, make the inspection panic or take long; an allow list takes none of them.

use proptest::prelude::*;

use super::*;

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

    #[test]
    fn flipped_and_cut_libraries_never_panic(
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0u8..8), 1..8),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = probe().to_vec();
        for (at, bit) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        let _ = facts_of(&bytes);
    }

    #[test]
    fn damaged_headers_never_panic(
        words in prop::collection::vec((0usize..200, any::<u64>()), 1..6),
    ) {
        let mut bytes = probe().to_vec();
        for (word, value) in words {
            bytes[16 + word * 4..][..8].copy_from_slice(&value.to_le_bytes());
        }
        let _ = facts_of(&bytes);
    }

    #[test]
    fn a_single_flipped_bit_is_refused_under_an_allow_list(at in any::<prop::sample::Index>(), bit in 0u8..8) {
        let trust = Trust::AllowList(AllowList::new("list.json", [Hash::of(probe())]));
        let mut bytes = probe().to_vec();
        let at = at.index(bytes.len());
        bytes[at] ^= 1 << bit;
        prop_assert!(trust.judge_hash(&Hash::of(&bytes)).is_err());
    }

    #[test]
    fn any_note_text_never_panics(note in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = manifest::read(&note);
    }
}
