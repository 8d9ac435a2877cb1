//! Patterns over `process/component/port`, as they are typed at `trocar record` and `trocar export --topic`.
//!
//! Invariant: `*` stands for any part of one name, `**` for any number of names; the name of a process or a
//! component stands for everything in it.

/// Tells whether a pattern means a path.
pub(super) fn matches(pattern: &str, path: &str) -> bool {
    let (mut pattern, path) = (parts(pattern), parts(path));
    if pattern.is_empty() || pattern.len() > 64 {
        return false;
    }
    // The name of a process or component means all in it, and `**` stands for no name, too.
    pattern.push("**");
    wild(&pattern, &path, |part| *part == "**", |pattern, name| one(pattern.as_bytes(), name.as_bytes()))
}

/// Tells whether a recorder writes this topic about itself: `/recorder/NAME`. A recorded output has a name of
/// three parts, in a process that is called `recorder`, too.
pub(super) fn is_recorders(topic: &str) -> bool {
    topic.strip_prefix("/recorder/").is_some_and(|name| !name.contains('/'))
}

fn parts(path: &str) -> Vec<&str> {
    path.split('/').filter(|part| !part.is_empty()).collect()
}

/// Tells whether items match a pattern, some parts of which stand for any number of items. There is no
/// recursion: a hostile pattern costs its length times that of the items.
fn wild<T>(pattern: &[T], items: &[T], any: impl Fn(&T) -> bool, same: impl Fn(&T, &T) -> bool) -> bool {
    let (mut p, mut n) = (0, 0);
    let mut last = None;
    while n < items.len() {
        if pattern.get(p).is_some_and(&any) {
            last = Some((p, n));
            p += 1;
        } else if pattern.get(p).is_some_and(|part| same(part, &items[n])) {
            (p, n) = (p + 1, n + 1);
        } else if let Some((at, from)) = last {
            last = Some((at, from + 1));
            (p, n) = (at + 1, from + 1);
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(any)
}

/// `*` and `?` within a name.
fn one(pattern: &[u8], name: &[u8]) -> bool {
    wild(pattern, name, |c| *c == b'*', |p, c| p == c || *p == b'?')
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
            ("**/b/**/c", "a/b/b/x/c", true),
            ("**/b/**/c/d", "a/b/b/x/c", false),
        ] {
            assert_eq!(matches(pattern, path), wanted, "{pattern} {path}");
        }
    }

    #[test]
    fn a_path_of_many_parts_is_compared_without_going_back_more_than_once() {
        let path = format!("{}b", "a/".repeat(20_000));
        let pattern = "**/a/".repeat(20);
        assert!(matches(&format!("{pattern}b"), &path) && !matches(&format!("{pattern}c"), &path));
    }
}
