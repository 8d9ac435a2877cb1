//! Names of the keys of one journal.
//!
//! Invariant: keys of records and of snapshots are in the order of their numbers, and no range over them
//! reaches a key that is none.

/// Keys under one prefix.
#[derive(Clone, Debug)]
pub(super) struct Keys(String);

/// Keys from the first up to, and without, the last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Span(pub(super) Vec<u8>, pub(super) Vec<u8>);

/// Behind each key that begins with a digit.
const END: &str = ":";
/// Behind each part of one number.
const PARTS_END: &str = "0";

impl Keys {
    pub(super) fn new(prefix: &str) -> Keys {
        Keys(prefix.to_owned())
    }

    fn named(&self, name: &str) -> Vec<u8> {
        format!("{}/{name}", self.0).into_bytes()
    }

    pub(super) fn identity(&self) -> Vec<u8> {
        self.named("identity")
    }

    pub(super) fn head(&self) -> Vec<u8> {
        self.named("head")
    }

    /// Parts of the newest snapshot.
    pub(super) fn snapshot(&self) -> Vec<u8> {
        self.named("snapshot")
    }

    /// The GCM that leads; changes with each of its beats.
    pub(super) fn leader(&self) -> Vec<u8> {
        self.named("leader")
    }

    /// The last term that was given out; changes with each lead.
    pub(super) fn term(&self) -> Vec<u8> {
        self.named("term")
    }

    /// A part of a record.
    pub(super) fn record(&self, number: u64, part: usize) -> Vec<u8> {
        self.named(&format!("records/{number:020}/{part:05}"))
    }

    /// All parts of all records from that number on.
    pub(super) fn records_from(&self, number: u64) -> Span {
        Span(self.named(&format!("records/{number:020}")), self.named(&format!("records/{END}")))
    }

    /// All parts of all records before that number.
    pub(super) fn records_before(&self, number: u64) -> Span {
        Span(self.named("records/0"), self.named(&format!("records/{number:020}")))
    }

    /// Returns the number of the record that this is a part of, and the number of the part.
    pub(super) fn record_of(&self, key: &[u8]) -> Option<(u64, usize)> {
        let key = std::str::from_utf8(key).ok()?;
        let (number, part) = key.strip_prefix(self.0.as_str())?.strip_prefix("/records/")?.split_once('/')?;
        Some((number.parse().ok()?, part.parse().ok()?))
    }

    /// A part of a snapshot.
    pub(super) fn part(&self, generation: u64, part: usize) -> Vec<u8> {
        self.named(&format!("snapshots/{generation:020}/{part:05}"))
    }

    /// All parts of one snapshot.
    pub(super) fn parts(&self, generation: u64) -> Span {
        let at = |end: &str| self.named(&format!("snapshots/{generation:020}{end}"));
        Span(at("/"), at(PARTS_END))
    }

    /// All parts of the snapshots before that one.
    pub(super) fn snapshots_before(&self, generation: u64) -> Span {
        Span(self.named("snapshots/0"), self.named(&format!("snapshots/{generation:020}")))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn has(span: &Span, key: &[u8]) -> bool {
        span.0.as_slice() <= key && key < span.1.as_slice()
    }

    #[test]
    fn spans_have_what_they_name_and_nothing_else() {
        let keys = Keys::new("lab7");
        for number in [1, 9, 10, 11, u64::MAX] {
            let key = keys.record(number, 3);
            assert_eq!(keys.record_of(&key).unwrap(), (number, 3));
            assert_eq!(has(&keys.records_from(10), &key), number >= 10);
            assert_eq!(has(&keys.records_before(10), &key), number < 10);
            let part = keys.part(number, 7);
            assert_eq!(has(&keys.parts(10), &part), number == 10);
            assert_eq!(has(&keys.snapshots_before(10), &part), number < 10);
        }
        let others = [keys.identity(), keys.head(), keys.snapshot(), keys.leader(), keys.term()];
        // Another system below this one's prefix, and one with a longer name.
        let foreign = ["lab7/records", "lab7/snapshots", "lab70"].map(|prefix| Keys::new(prefix).head());
        for other in others.iter().chain(&foreign) {
            let spans =
                [keys.records_from(0), keys.records_before(u64::MAX), keys.snapshots_before(u64::MAX)];
            assert!(spans.iter().all(|span| !has(span, other)), "{}", String::from_utf8_lossy(other));
            assert_eq!(keys.record_of(other), None);
        }
    }
}
