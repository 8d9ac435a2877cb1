//! Warnings that say the same of several components, as one line.
//!
//! Invariant: every component that is warned of is named; numbers that differ are the first one's. A digit in
//! a name is no number.

/// Folds lines `path: text` whose texts differ in their numbers only, in the order of the first of each.
pub(super) fn folded(warnings: impl IntoIterator<Item = String>) -> Vec<String> {
    let mut groups: Vec<(String, String, Vec<String>)> = Vec::new();
    for warning in warnings {
        let (path, text) = warning.split_once(": ").unwrap_or(("", &warning));
        let pattern = pattern(text);
        match groups.iter_mut().find(|(known, _, _)| !path.is_empty() && *known == pattern) {
            // One that is told of twice is named once.
            Some((_, first, others)) => {
                let is_first = first.split_once(": ").is_some_and(|(known, _)| known == path);
                if !is_first && !others.iter().any(|known| known == path) {
                    others.push(path.to_owned());
                }
            }
            None => groups.push((pattern, warning, Vec::new())),
        }
    }
    groups.into_iter().map(|(_, first, others)| line(first, &others)).collect()
}

/// The text without its numbers: words that begin with a digit.
fn pattern(text: &str) -> String {
    let word =
        |word: &str| if word.starts_with(|c: char| c.is_ascii_digit()) { "0" } else { word }.to_owned();
    text.split(' ').map(word).collect::<Vec<_>>().join(" ")
}

fn line(first: String, others: &[String]) -> String {
    if others.is_empty() { first } else { format!("{first}; likewise {}", others.join(", ")) }
}

#[cfg(test)]
mod tests {
    use super::folded;

    #[test]
    fn what_is_refused_to_many_is_one_line_that_names_them_all() {
        let refused = |of: &str, priority: u32| format!("{of}: priority {priority} was refused");
        let all = [
            refused("host/robot", 75),
            "host/a: no memory".to_owned(),
            refused("host/source", 70),
            refused("host/b", 8),
        ];
        let expected =
            ["host/robot: priority 75 was refused; likewise host/source, host/b", "host/a: no memory"];
        assert_eq!(folded(all), expected);
    }

    #[test]
    fn one_that_is_warned_of_more_than_once_is_named_once() {
        let refused = |of: &str| format!("{of}: priority 70 was refused");
        let all = ["oct/source", "oct/surface", "oct/source", "oct/surface"].map(refused);
        assert_eq!(folded(all), ["oct/source: priority 70 was refused; likewise oct/surface"]);
    }

    #[test]
    fn what_differs_in_a_name_stays_two_lines() {
        let all = ["host/a: nothing comes at in1", "host/b: nothing comes at in2"].map(str::to_owned);
        assert_eq!(folded(all.clone()), all);
    }

    #[test]
    fn lines_without_a_component_stay_as_they_are() {
        let all = ["one", "one", "host/a: 1 late"].map(str::to_owned);
        assert_eq!(folded(all.clone()), all);
    }
}
