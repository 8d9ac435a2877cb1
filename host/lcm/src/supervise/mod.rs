//! Supervision of the components of this process: entries that do not return, cycles that are late, peers
//! that are gone.
//!
//! Invariant: the watchdog runs no component code and shares no lock with a thread that does.

mod descriptors;
mod home;
mod household;
mod hygiene;
mod last;
mod lateness;
mod minding;
mod moment;
mod observed;
mod roster;
mod safe;
mod strangers;
mod suspicion;
mod watchdog;

pub use descriptors::{keep as keep_descriptors, let_go as let_go_of_descriptors};
pub use household::own_process;
pub(super) use hygiene::Manners;
pub(super) use last::cannot_go_on;
pub use last::ends_by;
pub(super) use moment::Moment;
pub(super) use observed::LEAVE_NS;
pub(super) use roster::{Guarded, Roster};
pub(super) use safe::give_up;
pub(super) use strangers::Strangers;
pub(super) use suspicion::Suspicion;
pub(super) use watchdog::Watchdog;
