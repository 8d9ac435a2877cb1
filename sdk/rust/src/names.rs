//! The list of names behind repeated ports and interfaces, as an author sets it.
//!
//! Invariant: a list that was set is in force only once the host has taken it over, in `bind`.

use crate::dynamic::AnyType;
use crate::error::Result;

/// Longest name, bytes; as in a host's paths.
const MAX_NAME: usize = 63;

/// The names of repeated interfaces: a `#[names]` field. Set it in `configure`, or later followed by
/// [`crate::Host::ports_changed`]; it changes when the host has taken it over (see
/// [`crate::Component::ports_changed`]).
///
/// Reads know no instance and so no list: the repeated provided interfaces that have some share one, the
/// first.
/// ```
/// # use trocar_sdk::prelude::*;
/// #[derive(Component)]
/// #[component(provides("arm_{}", "arm_{}_tip"))]
/// struct Arms { #[names("arm_{}", "arm_{}_tip")] arms: Names }
/// #[provides("arm_{}_tip")]
/// impl Arms { #[read] fn force(_: &ArmsState, arm: usize) -> f64 { arm as f64 } }
/// # impl Component for Arms {}
/// ```
/// ```compile_fail,E0080
/// # use trocar_sdk::prelude::*;
/// #[derive(Component)]
/// #[component(provides("arm_{}", "tool_{}"))]
/// struct Arms { #[names("arm_{}")] arms: Names, #[names("tool_{}")] tools: Names }
/// #[provides("tool_{}")]
/// impl Arms { #[read] fn force(_: &ArmsState, tool: usize) -> f64 { tool as f64 } }
/// # impl Component for Arms {}
/// ```
#[derive(Clone, Default, Debug)]
pub struct Names {
    wanted: Vec<String>,
    bound: Vec<String>,
    /// One for each wanted name, if the ports are untyped ones that get a type of their own.
    types: Vec<AnyType>,
}

impl Names {
    /// Sets the names that are to exist. A name that stays keeps its connections, at any position.
    ///
    /// # Errors
    /// A text that is no name (a letter or `_`, then letters, digits, `_ . -`, at most 63) or a name that
    /// comes twice; the old list stays.
    pub fn set<S: AsRef<str>>(&mut self, names: impl IntoIterator<Item = S>) -> Result {
        let names: Vec<String> = names.into_iter().map(|n| n.as_ref().to_string()).collect();
        for (i, name) in names.iter().enumerate() {
            check_name(name)?;
            if names[..i].contains(name) {
                return Err(format!("the name `{name}` is given twice").into());
            }
        }
        self.wanted = names;
        self.types.clear();
        Ok(())
    }

    /// Sets the names as [`Names::set`] does, with a type for the port of each.
    pub(crate) fn set_typed<S: AsRef<str>>(
        &mut self,
        names: impl IntoIterator<Item = S>,
        types: Vec<AnyType>,
    ) -> Result {
        self.set(names)?;
        self.types = types;
        Ok(())
    }

    /// The type that the port of this position of [`Names::wanted`] gets, where it gets one of its own.
    pub(crate) fn made_type(&self, at: usize) -> Option<&AnyType> {
        self.types.get(at)
    }

    /// Returns the number of names now; this and all that follows is about the list the host has taken over.
    pub fn len(&self) -> usize {
        self.bound.len()
    }

    /// True when no name is in force.
    pub fn is_empty(&self) -> bool {
        self.bound.is_empty()
    }

    /// The names in force, in the order of the list.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &str> {
        self.bound.iter().map(String::as_str)
    }

    /// The name at a position; none beyond the list.
    pub fn get(&self, at: usize) -> Option<&str> {
        self.bound.get(at).map(String::as_str)
    }

    /// Returns the position of `name`.
    pub fn position(&self, name: &str) -> Option<usize> {
        self.bound.iter().position(|n| n == name)
    }

    /// Returns the list that was set last.
    pub fn wanted(&self) -> &[String] {
        &self.wanted
    }

    /// Itself: generated code asks lists and ports alike.
    #[doc(hidden)]
    pub fn names(&self) -> &Names {
        self
    }

    /// `bind` comes with the slots of what the host was told.
    #[doc(hidden)]
    pub fn adopt(&mut self, told: &[String]) {
        told.clone_into(&mut self.bound);
    }
}

fn check_name(name: &str) -> Result {
    let begins = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    let good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '.' | '-');
    if begins && name.chars().all(good) && name.len() <= MAX_NAME {
        return Ok(());
    }
    let rule = "a name begins with a letter or _ and holds letters, digits, _ . -, at most 63 of them";
    Err(format!("`{name}` is no name: {rule}").into())
}
