//! Pages: an answer of List, or news of Watch, in parts of a size the caller chose.
//!
//! Invariant: a page begins behind the last name of the previous one, so that everything that exists all the
//! time is on one of them, also when the graph changes between two pages.

use std::collections::BTreeSet;
use std::collections::hash_map::DefaultHasher;
use std::fmt::Write;
use std::hash::{Hash, Hasher};
use std::ops::Bound::{Excluded, Unbounded};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use trocar_model::{ClassInfo, Refusal, SystemGraph};
use trocar_proto::v1;

/// All listed things, in their order.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
enum Place {
    Process(String),
    Component(String),
    Connection(u64),
    Class(String, String),
}

/// The part of a List's question that its pages share.
pub(super) struct Pages {
    size: usize,
    after: Option<Place>,
    /// Hash of the request.
    of: u64,
}

impl Pages {
    /// # Errors
    /// The size is negative, or the token is not of an answer to this question.
    pub(super) fn of(request: &v1::ListRequest) -> Result<Pages, Refusal> {
        let refused = |why: &str, field: &str| Refusal::ArgumentInvalid {
            what: "List".into(),
            why: why.into(),
            field: field.into(),
        };
        let size = usize::try_from(request.page_size)
            .map_err(|_| refused("it is negative; 0 means everything in one answer", "page_size"))?;
        let mut hasher = DefaultHasher::new();
        (&request.path, request.classes).hash(&mut hasher);
        let of = hasher.finish();
        if request.page_token.is_empty() {
            return Ok(Pages { size, after: None, of });
        }
        if !request.unless_etag.is_empty() {
            let why =
                "it goes on with an answer, and unless_etag waits for another one: leave one of them out";
            return Err(refused(why, "page_token"));
        }
        match read(&request.page_token) {
            Some((whose, after)) if whose == of => Ok(Pages { size, after: Some(after), of }),
            Some(_) => Err(refused(
                "it belongs to an answer about another path, or with other classes: ask as you asked for the first page",
                "page_token",
            )),
            None => Err(refused(
                "it is none: give the next_page_token of an answer, or none for the first page",
                "page_token",
            )),
        }
    }

    /// Leaves this page of `part` and `classes`; the token of the next one, empty after the last.
    pub(super) fn cut(&self, part: &mut SystemGraph, classes: &mut Vec<Arc<ClassInfo>>) -> String {
        if self.size == 0 && self.after.is_none() {
            return String::new();
        }
        let all: BTreeSet<Place> = (part.processes.keys().map(|name| Place::Process(name.to_string())))
            .chain(part.components.keys().map(|id| Place::Component(id.to_string())))
            .chain(part.connections.keys().map(|id| Place::Connection(id.0)))
            .chain(classes.iter().map(|class| of_class(class)))
            .collect();
        let after = self.after.as_ref().map_or(Unbounded, Excluded);
        let mut rest = all.range((after, Unbounded));
        let size = if self.size == 0 { usize::MAX } else { self.size };
        let page: BTreeSet<&Place> = rest.by_ref().take(size).collect();
        part.processes.retain(|name, _| page.contains(&Place::Process(name.to_string())));
        part.components.retain(|id, _| page.contains(&Place::Component(id.to_string())));
        part.connections.retain(|id, _| page.contains(&Place::Connection(id.0)));
        classes.retain(|class| page.contains(&of_class(class)));
        match (rest.next(), page.last()) {
            (Some(_), Some(last)) => token(self.of, last),
            _ => String::new(),
        }
    }
}

fn of_class(class: &ClassInfo) -> Place {
    Place::Class(class.full_name(), class.hash.clone())
}

/// Spells the place in letters that need no quotes.
fn token(of: u64, last: &Place) -> String {
    // Plain data always has a JSON.
    let json = serde_json::to_vec(&(of, last)).unwrap_or_default();
    json.iter().fold(String::with_capacity(2 * json.len()), |mut hex, byte| {
        let _ = write!(hex, "{byte:02x}");
        hex
    })
}

fn read(token: &str) -> Option<(u64, Place)> {
    let pairs = token.as_bytes().chunks(2).map(|pair| {
        let digits = str::from_utf8(pair).ok().filter(|d| d.len() == 2)?;
        u8::from_str_radix(digits, 16).ok()
    });
    serde_json::from_slice(&pairs.collect::<Option<Vec<u8>>>()?).ok()
}

/// The whole graph in snapshots of so many items; 0 = in one.
pub(super) fn snapshots(whole: v1::Snapshot, size: usize) -> Vec<v1::Snapshot> {
    let cut = |whole: &mut v1::Snapshot, room: &mut usize| v1::Snapshot {
        processes: take(&mut whole.processes, room),
        components: take(&mut whole.components, room),
        connections: take(&mut whole.connections, room),
        more: false,
    };
    paged(whole, size, cut, |page| &mut page.more)
}

/// The difference in deltas of so many items; 0 = in one.
pub(super) fn deltas(whole: v1::Delta, size: usize) -> Vec<v1::Delta> {
    let cut = |whole: &mut v1::Delta, room: &mut usize| v1::Delta {
        processes: take(&mut whole.processes, room),
        components: take(&mut whole.components, room),
        connections: take(&mut whole.connections, room),
        removed_connections: take(&mut whole.removed_connections, room),
        removed_components: take(&mut whole.removed_components, room),
        removed_processes: take(&mut whole.removed_processes, room),
        more: false,
    };
    paged(whole, size, cut, |page| &mut page.more)
}

/// Pages that `cut` takes out of the whole; all but the last one say that more come. There is always one.
fn paged<T: Default + PartialEq>(
    mut whole: T,
    size: usize,
    cut: impl Fn(&mut T, &mut usize) -> T,
    more: impl Fn(&mut T) -> &mut bool,
) -> Vec<T> {
    let mut pages = Vec::new();
    loop {
        let mut room = if size == 0 { usize::MAX } else { size };
        let mut page = cut(&mut whole, &mut room);
        let is_last = whole == T::default();
        *more(&mut page) = !is_last;
        pages.push(page);
        if is_last {
            return pages;
        }
    }
}

fn take<T>(from: &mut Vec<T>, room: &mut usize) -> Vec<T> {
    let rest = from.split_off(from.len().min(*room));
    *room -= from.len();
    std::mem::replace(from, rest)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn a_token_that_is_none_is_refused_whatever_its_bytes() {
        for token in ["x", "0", "zz", "5b5d", "ffff", "é", "7b7d", &"0".repeat(100_000)] {
            let request = v1::ListRequest { page_token: token.into(), ..v1::ListRequest::default() };
            let Err(Refusal::ArgumentInvalid { field, .. }) = Pages::of(&request) else { panic!("{token}") };
            assert_eq!(field, "page_token");
        }
    }

    #[test]
    fn a_delta_is_told_in_pages_of_which_the_last_alone_says_so() {
        let names = |n: usize| (0..n).map(|i| format!("p{i}")).collect::<Vec<_>>();
        let whole = v1::Delta {
            removed_components: names(5),
            removed_processes: names(2),
            removed_connections: vec![7, 8],
            ..v1::Delta::default()
        };
        let pages = deltas(whole.clone(), 4);
        let more: Vec<bool> = pages.iter().map(|page| page.more).collect();
        assert_eq!(more, [true, true, false]);
        let mut all = v1::Delta::default();
        for page in pages {
            all.removed_connections.extend(page.removed_connections);
            all.removed_components.extend(page.removed_components);
            all.removed_processes.extend(page.removed_processes);
        }
        assert_eq!(all, whole);
        assert_eq!(deltas(whole.clone(), 0), [whole]);
        assert_eq!(
            deltas(v1::Delta::default(), 4),
            [v1::Delta::default()],
            "a change of the revision alone is told"
        );
        let whole = v1::Snapshot::default();
        assert_eq!(snapshots(whole.clone(), 1), [whole], "a system without anything is told, too");
    }
}
