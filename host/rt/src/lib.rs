//! The real-time core: everything that is lock-free in trocar, and the few system calls it rests on.
//!
//! Nothing on the step path allocates, locks, logs, or loops without a bound, and the only system calls made
//! there are the futex wake, and the sleep of an executor and of a team that waits for its last slice.
//! Ordering is by acquire/release operations, never by a fence.

#![allow(unexpected_cfgs, reason = "cfg(loom) is set by hand, to run the models")]

mod buf;
pub mod cell;
pub mod exclusive;
pub mod executor;
pub mod house;
pub mod left;
pub mod mailbox;
mod mapping;
pub mod mark;
pub mod os;
pub mod pool;
pub mod pulse;
pub mod region;
pub mod reply;
#[cfg(not(loom))]
pub mod robust_words;
pub mod segment;
mod seq;
pub mod state;
pub mod stream;
mod sync;
pub mod team;
pub mod threads;
pub mod timing;
pub mod turn;
pub mod wake;

#[cfg(all(test, loom))]
mod loom_models;

#[cfg(not(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64"))))]
compile_error!("trocar runs on Linux, x86-64 and aarch64 only");

pub use cell::BindingCell;
pub use exclusive::TryCell;
pub use executor::{Clock, Cycle, Pace, Pacer};
pub use mailbox::{EntryHead, Mailbox, MailboxStats, Overflow, Push};
pub use os::now_ns;
pub use pool::{Frame, FrameMut, FramePool, PoolStats};
pub use reply::{Reply, ReplyPool, Running, Ticket};
pub use state::{Around, Miss, RowInfo, StateReader, StateWriter, state_table};
pub use stream::{
    DropPolicy, Meta, Payload, Pushed, Queue, Sample, StreamReader, StreamStats, StreamWriter, stream_link,
};
pub use team::Team;
pub use timing::{CycleSnapshot, CycleStats, Grid, Histogram};
pub use wake::{WakeList, Waker};
