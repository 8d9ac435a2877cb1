//! Entries that look after their own manners, as the watchdog sees them.

use trocar_model::Health;

use super::roster::Ward;

/// Entries that check their own manners.
pub(super) enum Minding<'a> {
    Nobody,
    /// At least one of them will come to it.
    Looks,
    /// These components look themselves, and none of them returns.
    Hang(Vec<&'a Ward>),
}

/// Counters of these components' own looks, for [`minding`].
pub(super) fn minded(wards: &[&Ward]) -> Vec<u64> {
    wards.iter().map(|w| w.instance.watch.minded()).collect()
}

/// Tells which components look for themselves, or did since `before` was taken.
pub(super) fn minding<'a>(wards: &[&'a Ward], before: &[u64]) -> Minding<'a> {
    let now = minded(wards);
    let inside: Vec<&Ward> =
        wards.iter().zip(&now).filter(|(_, word)| *word % 2 == 1).map(|(w, _)| *w).collect();
    if now != before || inside.iter().any(|w| w.instance.watch.health() != Health::Unresponsive) {
        Minding::Looks
    } else if inside.is_empty() {
        Minding::Nobody
    } else {
        Minding::Hang(inside)
    }
}
