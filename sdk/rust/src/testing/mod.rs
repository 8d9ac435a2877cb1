//! A bench for one component in a plain unit test: virtual clock, pushed inputs, recorded outputs, fake peers, no host.
//!
//! Invariant: the bench drives the component through its C table and real slots, so what passes here passes the boundary.
//!
//! ```
//! use trocar_sdk::{prelude::*, testing::Bench};
//!
//! #[derive(Component)]
//! #[component(rate_hz = 100)]
//! struct Double {
//!     #[input]
//!     x: In<f64>,
//!     #[output]
//!     y: Out<f64>,
//! }
//! impl Component for Double {
//!     fn step(&mut self, _: &Tick) -> Result {
//!         if let Some(x) = self.x.fresh() {
//!             self.y.write(&(2.0 * x));
//!         }
//!         Ok(())
//!     }
//! }
//!
//! let mut bench = Bench::<Double>::new("{}");
//! bench.push("x", 21.0);
//! bench.step(3);
//! assert_eq!(bench.outputs::<f64>("y"), [42.0]);
//! ```

mod bench;
mod cells;
mod fake_host;
mod lookup;

pub use bench::{Bench, Failure};
