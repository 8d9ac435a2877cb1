//! Supervision of the components of this process: entries that do not return, cycles that are late, peers
//! that are gone.
//!
//! Invariant: the watchdog runs no component code and shares no lock with a thread that does.

mod charge;
mod descriptors;
mod hygiene;
mod last;
mod roster;
mod safe;
mod strangers;
mod watch;
mod watchdog;

pub(super) use charge::LEAVE_NS;
pub use descriptors::{keep as keep_descriptors, let_go as let_go_of_descriptors};
pub use hygiene::own_process;
pub(super) use hygiene::{Manners, Suspicion};
pub(super) use last::cannot_go_on;
pub use last::ends_by;
pub(super) use roster::{Roster, Ward};
pub(super) use safe::give_up;
pub(super) use strangers::{Moment, Strangers};
pub(super) use watch::{Entry, Misdeed, Watch};
pub(super) use watchdog::Watchdog;
