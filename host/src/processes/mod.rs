//! Supervision of processes: spawned as children, tied to this process's life, restarted by policy, given up
//! above its limits.
//!
//! Invariant: no child outlives this process. Each child holds one end of a socket pair as its standard
//! input; the kernel closes the other end however this process ends, and the child then ends by itself,
//! devices safe first.

mod child;
mod door;
mod exit;
mod keeper;
mod offspring;
mod policy;
mod status;
mod supervisor;

pub use child::Program;
pub use door::{Answer, Door};
pub use exit::Exit;
pub use keeper::keep_short;
pub(crate) use offspring::is_kept;
pub use policy::{Limits, Policy, Unheard};
pub use status::{Phase, Status};
pub use supervisor::Supervisor;
