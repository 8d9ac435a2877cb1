//! Ports and interfaces that exist once for each name of a list which the component sets itself.
//!
//! Invariant: a list changes only in `bind`, for all of its ports at once. Until then positions, ids and
//! slots mean what the host was told before, so a command never reaches the neighbour of the arm it was meant
//! for. `lease::Layout` counts them, not these fields, which an author may exchange.

use crate::any::Any;
use crate::component::Result;
use crate::dynamic::AnyType;
use crate::lease::Tie;
use crate::ports::{Flow, Out};
use core::ops::{Index, IndexMut};

/// Longest name, bytes; as in a host's paths.
const MAX_NAME: usize = 63;
/// Largest sample of a port, bytes; as in a host.
const MAX_SAMPLE: usize = 64 * 1024;

/// The names of repeated interfaces: a `#[names]` field. Set it in `configure`, or later followed by
/// [`Host::ports_changed`]; it changes when the host has taken it over (see
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

    /// The type that the port of this position of [`Names::wanted`] gets, where it gets one of its own.
    pub(crate) fn made_type(&self, at: usize) -> Option<&AnyType> {
        self.types.get(at)
    }

    /// Returns the number of names now; this and all that follows is about the list the host has taken over.
    pub fn len(&self) -> usize {
        self.bound.len()
    }

    pub fn is_empty(&self) -> bool {
        self.bound.is_empty()
    }

    pub fn iter(&self) -> impl ExactSizeIterator<Item = &str> {
        self.bound.iter().map(String::as_str)
    }

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

/// A port that exists once per name: `Many<In<JointState>>`, also of outputs, functions and events.
///
/// ```
/// use trocar_sdk::prelude::*;
///
/// /// Adds up what any number of sources measure.
/// #[derive(Component)]
/// struct Sum {
///     #[input]
///     terms: Many<In<f64>>,
///     #[output]
///     sum: Out<f64>,
///     #[config]
///     cfg: Cfg,
/// }
///
/// #[derive(Config)]
/// struct Cfg {
///     /// Names of the inputs.
///     #[config(default = ["a", "b"])]
///     terms: Vec<String>,
/// }
///
/// impl Component for Sum {
///     fn configure(&mut self) -> Result {
///         self.terms.set(&self.cfg.terms)
///     }
///     fn step(&mut self, _: &Tick) -> Result {
///         self.sum.write(&self.terms.ports_mut().filter_map(|term| term.latest()).sum());
///         Ok(())
///     }
/// }
/// ```
/// A repeated interface takes repeated ports:
/// ```compile_fail
/// use trocar_sdk::prelude::*;
/// #[derive(Component)]
/// struct Arms {
///     #[event("arm_{}")]
///     reached: Event<f64>,
///     #[names]
///     arms: Names,
/// }
/// impl Component for Arms {}
/// ```
/// and each command of it is told which one is meant:
/// ```compile_fail
/// use trocar_sdk::prelude::*;
/// #[derive(Component)]
/// #[component(provides("arm_{}"))]
/// struct Arms {
///     #[names]
///     arms: Names,
/// }
/// #[provides("arm_{}")]
/// impl Arms {
///     #[command]
///     fn stop(&mut self) {}
/// }
/// impl Component for Arms {}
/// ```
pub struct Many<P> {
    names: Names,
    /// One for each bound name.
    ports: Vec<P>,
}

impl<P> Default for Many<P> {
    fn default() -> Self {
        Many { names: Names::default(), ports: Vec::new() }
    }
}

impl<P> Many<P> {
    /// Sets the ports that are to exist. After `configure` the host asks by itself; later, call
    /// [`Host::ports_changed`]. A port whose name stays keeps its connection. Ports of a repeated interface
    /// follow its `#[names]` list instead.
    ///
    /// # Errors
    /// As [`Names::set`].
    pub fn set<S: AsRef<str>>(&mut self, names: impl IntoIterator<Item = S>) -> Result {
        self.names.set(names)
    }

    pub fn names(&self) -> &Names {
        &self.names
    }

    pub fn len(&self) -> usize {
        self.ports.len()
    }

    pub fn is_empty(&self) -> bool {
        self.ports.is_empty()
    }

    pub fn get(&self, at: usize) -> Option<&P> {
        self.ports.get(at)
    }

    pub fn get_mut(&mut self, at: usize) -> Option<&mut P> {
        self.ports.get_mut(at)
    }

    /// The port of this name.
    pub fn named(&self, name: &str) -> Option<&P> {
        self.ports.get(self.names.position(name)?)
    }

    pub fn named_mut(&mut self, name: &str) -> Option<&mut P> {
        self.ports.get_mut(self.names.position(name)?)
    }

    /// Names and ports, in the order of the list.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&str, &P)> {
        self.names.iter().zip(&self.ports)
    }

    pub fn iter_mut(&mut self) -> impl ExactSizeIterator<Item = (&str, &mut P)> {
        self.names.iter().zip(&mut self.ports)
    }

    pub fn ports(&self) -> impl ExactSizeIterator<Item = &P> {
        self.ports.iter()
    }

    pub fn ports_mut(&mut self) -> impl ExactSizeIterator<Item = &mut P> {
        self.ports.iter_mut()
    }
}

impl Many<Out<Any>> {
    /// Sets the ports as [`Many::set`] does, with a type for each, of which [`crate::AnyOut::write_bytes`]
    /// takes bytes: for outputs whose payload depends on the configuration. Connect compares the types,
    /// viewers and recorders know the fields. A port whose type changes loses its connections.
    ///
    /// # Errors
    /// As [`Names::set`], and a type that is larger than a sample may be. Two different structs of one name
    /// are refused after `configure`.
    ///
    /// ```
    /// use trocar_sdk::{AnyType, data::Scalar, prelude::*, testing::Bench};
    ///
    /// /// Writes 1 to outputs that are made while running.
    /// #[derive(Component)]
    /// struct Ones {
    ///     #[output]
    ///     ones: Many<AnyOut>,
    /// }
    /// impl Component for Ones {
    ///     fn configure(&mut self) -> Result {
    ///         let scalar = [("stamp", AnyType::of::<Stamp>(), ""), ("value", AnyType::of::<f64>(), "")];
    ///         let scalar = AnyType::structure("Scalar", scalar)?;
    ///         self.ones.set_typed([("a", scalar), ("b", AnyType::of::<f64>())])
    ///     }
    ///     fn step(&mut self, tick: &Tick) -> Result {
    ///         let mut bytes = [0; 16];
    ///         bytes[8..].copy_from_slice(&1f64.to_le_bytes());
    ///         self.ones[0].write_bytes(&bytes, tick.now());
    ///         self.ones[1].write_bytes(&bytes[8..], tick.now());
    ///         Ok(())
    ///     }
    /// }
    /// let mut bench = Bench::<Ones>::new("{}");
    /// bench.step(1);
    /// assert_eq!(bench.outputs::<Scalar>("a")[0].value, 1.0);
    /// assert_eq!(bench.outputs::<f64>("b"), [1.0]);
    /// ```
    pub fn set_typed<S: AsRef<str>>(&mut self, ports: impl IntoIterator<Item = (S, AnyType)>) -> Result {
        let (names, types): (Vec<S>, Vec<AnyType>) = ports.into_iter().unzip();
        if let Some((name, ty)) = names.iter().zip(&types).find(|(_, ty)| ty.size() > MAX_SAMPLE) {
            let (name, size) = (name.as_ref(), ty.size());
            return Err(format!("`{name}`: a sample of {size} B is above {MAX_SAMPLE} B").into());
        }
        self.names.set(names)?;
        self.names.types = types;
        Ok(())
    }
}

impl<P: Flow + Default> Many<P> {
    /// Makes the list that the host was told the present one and ties each port to the slot of its position.
    ///
    /// # Safety
    /// `slot` gives, for each position of `told`, a slot as [`Flow::attach`] demands it.
    pub(crate) unsafe fn tie(&mut self, tie: &Tie, told: &[String], slot: impl Fn(usize) -> *const P::Slot) {
        let mut old: Vec<(String, P)> = self.names.bound.drain(..).zip(self.ports.drain(..)).collect();
        self.names.adopt(told);
        for (at, name) in self.names.bound.iter().enumerate() {
            let known = old.iter().position(|(n, _)| n == name);
            let mut port = known.map(|i| old.swap_remove(i).1).unwrap_or_default();
            // SAFETY: the caller vouches for positions of the list.
            unsafe { port.attach(slot(at), tie) };
            self.ports.push(port);
        }
    }
}

impl<P> Index<usize> for Many<P> {
    type Output = P;
    /// # Panics
    /// There are not so many names.
    fn index(&self, at: usize) -> &P {
        &self.ports[at]
    }
}

impl<P> IndexMut<usize> for Many<P> {
    fn index_mut(&mut self, at: usize) -> &mut P {
        &mut self.ports[at]
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::ports::In;

    #[test]
    fn a_bad_or_double_name_is_refused_and_the_old_list_stays() {
        let mut many = Many::<In<f64>>::default();
        many.set(["psm1", "psm2"]).unwrap();
        for bad in ["", "1st", "a/b", "ä"] {
            assert!(many.set([bad]).unwrap_err().to_string().contains("is no name"), "{bad}");
        }
        assert!(many.set(["a".repeat(64)]).is_err());
        assert!(many.set(["a", "b", "a"]).unwrap_err().to_string().contains("`a` is given twice"));
        assert_eq!(many.names().wanted(), ["psm1", "psm2"]);
        assert!(many.is_empty(), "the host has not taken them over");
    }
}
