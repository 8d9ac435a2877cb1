//! The matrix: every kind of command × sent and called × everything it may come to.
//!
//! Invariant: [`fate`] says for each situation what each of the twelve ways to ask comes to, exactly; what no
//! situation brings about has its reason in [`NEVER`]. A case plays each situation, and [`holes`] finds what
//! has neither.

mod fate;
mod kinds;
mod never;
mod play;
mod situation;

pub use fate::fate;
pub use kinds::{Fate, Kind, Mode};
pub use never::{NEVER, holes};
pub use play::cases;
pub use situation::Situation;
