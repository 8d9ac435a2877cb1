//! Ports that exist once for each name of a list which the component sets itself.
//!
//! Invariant: a list changes only in `bind`, for all of its ports at once. Until then positions, ids and
//! slots mean what the host was told before, so a command never reaches the neighbour of the arm it was meant
//! for. `lists::Layout` counts them, not these fields, which an author may exchange.

use crate::any::Any;
use crate::dynamic::AnyType;
use crate::error::Result;
use crate::flow::Flow;
use crate::lease::Tie;
use crate::names::Names;
use crate::ports::Out;
use core::ops::{Index, IndexMut};

/// Largest sample of a port, bytes; as in a host.
const MAX_SAMPLE: usize = 64 * 1024;

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
    /// [`crate::Host::ports_changed`]. A port whose name stays keeps its connection. Ports of a repeated
    /// interface follow its `#[names]` list instead.
    ///
    /// # Errors
    /// As [`Names::set`].
    pub fn set<S: AsRef<str>>(&mut self, names: impl IntoIterator<Item = S>) -> Result {
        self.names.set(names)
    }

    /// The list of names behind the ports.
    pub fn names(&self) -> &Names {
        &self.names
    }

    /// Number of ports.
    pub fn len(&self) -> usize {
        self.ports.len()
    }

    /// True when there is no port.
    pub fn is_empty(&self) -> bool {
        self.ports.is_empty()
    }

    /// The port at a position of the list; none beyond it.
    pub fn get(&self, at: usize) -> Option<&P> {
        self.ports.get(at)
    }

    /// The port at a position of the list, to be used; none beyond it.
    pub fn get_mut(&mut self, at: usize) -> Option<&mut P> {
        self.ports.get_mut(at)
    }

    /// The port of this name.
    pub fn named(&self, name: &str) -> Option<&P> {
        self.ports.get(self.names.position(name)?)
    }

    /// The port of this name, to be used.
    pub fn named_mut(&mut self, name: &str) -> Option<&mut P> {
        self.ports.get_mut(self.names.position(name)?)
    }

    /// Names and ports, in the order of the list.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&str, &P)> {
        self.names.iter().zip(&self.ports)
    }

    /// Names and ports to be used, in the order of the list.
    pub fn iter_mut(&mut self) -> impl ExactSizeIterator<Item = (&str, &mut P)> {
        self.names.iter().zip(&mut self.ports)
    }

    /// The ports alone, in the order of the list.
    pub fn ports(&self) -> impl ExactSizeIterator<Item = &P> {
        self.ports.iter()
    }

    /// The ports alone, to be used, in the order of the list.
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
        self.names.set_typed(names, types)
    }
}

impl<P: Flow + Default> Many<P> {
    /// Makes the list that the host was told the present one and ties each port to the slot of its position.
    ///
    /// # Safety
    /// `slot` gives, for each position of `told`, a slot as [`Flow::attach`] demands it.
    pub(crate) unsafe fn tie(&mut self, tie: &Tie, told: &[String], slot: impl Fn(usize) -> *const P::Slot) {
        let mut old: Vec<(String, P)> =
            self.names.iter().map(str::to_string).zip(self.ports.drain(..)).collect();
        self.names.adopt(told);
        for (at, name) in told.iter().enumerate() {
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
