//! The lists of names behind the repeated ports and interfaces of a class: as the component has them, and as
//! the host knows them.
//!
//! Invariant: ids and slots are counted by [`Layout`], which changes only in `describe` and `bind`.

use crate::names::Names;

/// The lists of a class, one per repeated port or interface of its description.
pub struct Lists<'a> {
    /// Lists of repeated inputs.
    pub inputs: Vec<&'a Names>,
    /// Lists of repeated outputs.
    pub outputs: Vec<&'a Names>,
    /// Lists of repeated required interfaces.
    pub required: Vec<&'a Names>,
    /// Lists of repeated provided interfaces.
    pub provided: Vec<&'a Names>,
}

/// The lists of names as the host knows them, kept apart from the fields, which an author may exchange at any
/// time: ids and slots are counted by these.
#[derive(Clone, Default)]
pub struct Layout {
    /// Names of each repeated input.
    pub inputs: Vec<Vec<String>>,
    /// Names of each repeated output.
    pub outputs: Vec<Vec<String>>,
    /// Names of each repeated required interface.
    pub required: Vec<Vec<String>>,
    /// Names of each repeated provided interface.
    pub provided: Vec<Vec<String>>,
}

impl Layout {
    pub(crate) fn wanted(lists: &Lists<'_>) -> Layout {
        let names = |lists: &[&Names]| lists.iter().map(|names| names.wanted().to_vec()).collect();
        Layout {
            inputs: names(&lists.inputs),
            outputs: names(&lists.outputs),
            required: names(&lists.required),
            provided: names(&lists.provided),
        }
    }
}

/// The names of one list; none before the first description.
#[inline]
pub fn names(lists: &[Vec<String>], at: usize) -> &[String] {
    lists.get(at).map_or(&[], Vec::as_slice)
}
