//! Patterns over `process/component/port`, as they are typed at `trocar record` and `trocar export --topic`.
//!
//! Invariant: `*` stands for any part of one name, `**` for any number of names; what names a process or a component stands for
//! everything in it.

/// Whether a path is meant by a pattern.
pub(super) fn matches(pattern: &str, path: &str) -> bool {
    let split = |text: &str| -> Vec<String> {
        text.split('/').filter(|part| !part.is_empty()).map(str::to_owned).collect()
    };
    let (pattern, path) = (split(pattern), split(path));
    if pattern.is_empty() || pattern.len() > 64 {
        return false;
    }
    let whole = parts(&pattern, &path);
    let mut inside = pattern.clone();
    inside.push("**".to_owned());
    whole || parts(&inside, &path)
}

/// Whether a topic is what a recorder tells of itself: `/recorder/NAME`. What is recorded has a name of three parts, in a process
/// that is called `recorder`, too.
pub(super) fn is_recorders(topic: &str) -> bool {
    topic.strip_prefix("/recorder/").is_some_and(|name| !name.contains('/'))
}

fn parts(pattern: &[String], path: &[String]) -> bool {
    match pattern.split_first() {
        None => path.is_empty(),
        Some((first, rest)) if first == "**" => (0..=path.len()).any(|skip| parts(rest, &path[skip..])),
        Some((first, rest)) => path
            .split_first()
            .is_some_and(|(name, others)| one(first.as_bytes(), name.as_bytes()) && parts(rest, others)),
    }
}

/// `*` within a name; no recursion, so a hostile pattern costs its length times the name's.
fn one(pattern: &[u8], name: &[u8]) -> bool {
    let (mut p, mut n) = (0, 0);
    let mut star = None;
    while n < name.len() {
        if p < pattern.len() && pattern[p] == b'*' {
            star = Some((p, n));
            p += 1;
        } else if p < pattern.len() && (pattern[p] == name[n] || pattern[p] == b'?') {
            (p, n) = (p + 1, n + 1);
        } else if let Some((at, from)) = star {
            star = Some((at, from + 1));
            (p, n) = (at + 1, from + 1);
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|c| *c == b'*')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_called_recorder_is_recorded_like_any_other() {
        assert!(is_recorders("/recorder/graph") && is_recorders("/recorder/note_operator"));
        assert!(!is_recorders("/recorder/robot/tip") && !is_recorders("/host/recorder"));
    }

    #[test]
    fn a_pattern_means_what_it_shows() {
        for (pattern, path, wanted) in [
            ("robot/**", "robot/robot/tip", true),
            ("robot/**", "host/robot/tip", false),
            ("robot", "robot/robot/tip", true),
            ("host/sine", "host/sine/value", true),
            ("host/sin", "host/sine/value", false),
            ("oct/ascan/ascan", "oct/ascan/ascan", true),
            ("/oct/ascan/ascan", "oct/ascan/ascan", true),
            ("**/tip", "robot/robot/tip", true),
            ("*/*/t*p", "robot/robot/tip", true),
            ("*/t*p", "robot/robot/tip", false),
            ("**", "a/b/c", true),
            ("", "a/b/c", false),
            ("*/camera_?/image", "host/camera_2/image", true),
        ] {
            assert_eq!(matches(pattern, path), wanted, "{pattern} {path}");
        }
    }
}
