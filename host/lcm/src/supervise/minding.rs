//! Entries that look after their own manners, as the watchdog sees them.

use trocar_model::Health;

use super::roster::Guarded;

/// Entries that check their own manners.
pub(super) enum Minding<'a> {
    Nobody,
    /// At least one of them will come to it.
    Looks,
    /// These components look themselves, and none of them returns.
    Hang(Vec<&'a Guarded>),
}

/// Counters of these components' own looks, for [`minding`].
pub(super) fn minded(all_guarded: &[&Guarded]) -> Vec<u64> {
    all_guarded.iter().map(|g| g.instance.watch.minded()).collect()
}

/// Tells which components look for themselves, or did since `before` was taken.
pub(super) fn minding<'a>(all_guarded: &[&'a Guarded], before: &[u64]) -> Minding<'a> {
    let now = minded(all_guarded);
    let inside: Vec<&Guarded> =
        all_guarded.iter().zip(&now).filter(|(_, word)| *word % 2 == 1).map(|(w, _)| *w).collect();
    if now != before || inside.iter().any(|g| g.instance.watch.health() != Health::Unresponsive) {
        Minding::Looks
    } else if inside.is_empty() {
        Minding::Nobody
    } else {
        Minding::Hang(inside)
    }
}
