//! "Did you mean": the known name closest to a mistyped one.
//!
//! Invariant: deterministic; equal distances go to the first in the given order.

/// Returns the closest of `known`, or nothing when none is close enough to be a typing error.
pub fn nearest<'a>(wanted: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let lower = wanted.to_lowercase();
    let mut best: Option<(usize, &str)> = None;
    for name in known {
        let distance = strsim::damerau_levenshtein(&lower, &name.to_lowercase());
        let limit = (wanted.chars().count().max(name.chars().count()) / 3).max(1);
        if distance <= limit && best.is_none_or(|(d, _)| distance < d) {
            best = Some((distance, name));
        }
    }
    best.map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::nearest;

    #[test]
    fn a_slip_of_the_fingers_finds_the_name() {
        assert_eq!(nearest("eyerobt", ["sine", "eyerobot"]), Some("eyerobot"));
        assert_eq!(nearest("HOST", ["gcm", "host"]), Some("host"), "case is a slip too");
        assert_eq!(nearest("hots", ["gcm", "host"]), Some("host"), "swapped letters are one slip");
    }

    #[test]
    fn an_unrelated_name_suggests_nothing() {
        assert_eq!(nearest("recorder", ["sine", "eyerobot"]), None);
        assert_eq!(nearest("x", []), None);
    }

    #[test]
    fn the_first_of_two_equally_near_names_wins() {
        assert_eq!(nearest("cat", ["bat", "rat"]), Some("bat"));
    }
}
